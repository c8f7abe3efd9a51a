"""Radiance: the inner product, hard light, and the white furnace through every step."""

from __future__ import annotations

import cases
import numpy as np
import pytest
import tolerances
from guard import guard_bands
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tolerances import assert_close

from prtcl import quadtree, reference
from prtcl.compute.device import Device
from prtcl.factors.environment import Environment, Light
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials, ViewTable, subsamples
from prtcl.transport import shade
from prtcl.transport.collapse import reduced_coefficients
from prtcl.transport.settings import Settings

SHAPES = [(keep, 3, 3, 2) for keep in range(1, 7)] + [
    (7, 3, 3, 1),
    (3, 1, 1, 2),
    (3, 1, 3, 4),
    (3, 3, 1, 4),
    (3, 3, 3, 1),
]
"""keep, channels, slice channels, slices a point. At keep 7 one slice: see `cases.ends_long_loops`."""


class Case:
    """Reduced coefficients, slices and the slices of each point; `terms` are what each sum adds."""

    def __init__(self, shape: tuple[int, int, int, int], points: int, *, whole: bool, seed: int = 0) -> None:
        self.keep, self.channels, self.slice_channels, self.n_slices = shape
        rng = np.random.default_rng([seed, *shape, points])
        size, count = 4**self.keep, 5

        def numbers(*lengths: int) -> NDArray[np.float32]:
            values = rng.integers(-3, 4, lengths) if whole else rng.normal(size=lengths)
            return values.astype(np.float32)

        self.reduced = numbers(points, self.channels, size)
        self.slices = numbers(count, self.slice_channels, size)
        self.index = rng.integers(0, count, (points, self.n_slices)).astype(np.int32)
        weight = rng.choice([0.25, 0.5, 1.0], (points, self.n_slices)) if whole else rng.uniform(
            0, 1, (points, self.n_slices)
        )  # fmt: skip
        self.weight = weight.astype(np.float32)

    def terms(self, scale: float) -> NDArray[np.float64]:
        """(points, 3, slices a point × coefficients)"""
        chosen = self.slices[self.index].astype(np.float64) * self.weight[..., None, None].astype(np.float64)
        chosen = np.broadcast_to(chosen, (*chosen.shape[:2], 3, chosen.shape[3])).transpose(0, 2, 1, 3)
        product = (
            scale * chosen * np.broadcast_to(self.reduced, (len(chosen), 3, chosen.shape[3]))[:, :, None]
        )
        return product.reshape(len(chosen), 3, -1)

    def kernels(self, device: Device) -> dict[str, object]:
        return device.kernels(
            "shade.cl", KEEP=self.keep, CHANNELS=self.channels, SLICE_CHANNELS=self.slice_channels,
            N_SLICES=self.n_slices, GROUP=64,
        )  # fmt: skip

    def run(self, device: Device, scale: float, *, plain: bool = False) -> NDArray[np.floating]:
        out = device.empty((len(self.reduced), 4))
        arguments = (
            device.array(self.reduced), device.array(self.slices), device.array(self.index, np.int32),
            device.array(self.weight), out, scale,
        )  # fmt: skip
        points = len(self.reduced)
        if plain:
            device.launch(self.kernels(device)["inner_product_plain"], points, 64, *arguments, points)
        else:
            device.launch(self.kernels(device)["inner_product"], 64, 64, *arguments, 0, y=points)
        return np.asarray(out.get())


def points_for(keep: int) -> tuple[int, ...]:
    return cases.GROUP_EDGES if keep <= 3 else (1, 9) if keep <= 5 else (3,)


@pytest.mark.parametrize("shape", SHAPES)
def test_integers_are_exact(device: Device, shape: tuple[int, int, int, int]) -> None:
    # Quarters of whole numbers, sums below 4 · 4^7 · 9: exact in float32.
    for points in points_for(shape[0]):
        case = Case(shape, points, whole=True)
        with guard_bands(device):
            got, twin = case.run(device, 0.5), case.run(device, 0.5, plain=True)
        expected = case.terms(0.5).sum(axis=-1)
        assert np.abs(expected).max() > 0
        for answer in (got, twin):
            assert (answer[:, :3] == expected).all()
            assert (answer[:, 3] == 0).all()


@pytest.mark.parametrize("shape", SHAPES)
def test_against_the_reference_and_the_plain_twin(device: Device, shape: tuple[int, int, int, int]) -> None:
    keep, n_slices = shape[0], shape[3]
    for points in points_for(keep):
        case = Case(shape, points, whole=False)
        terms = case.terms(float(np.float32(0.3)))
        got, twin = case.run(device, 0.3), case.run(device, 0.3, plain=True)
        bound = tolerances.inner_product(terms, keep, 64, n_slices, "float32")
        assert_close(got[:, :3], terms.sum(axis=-1), bound)
        assert_close(
            twin[:, :3], got[:, :3], bound + tolerances.inner_product_plain(terms, keep, n_slices, "float32")
        )


@pytest.mark.parametrize("precision", ["mixed", "float64"])
@pytest.mark.parametrize("keep", [1, 4, 7])
def test_other_precisions(make_device, precision: str, keep: int) -> None:
    device = make_device(precision)
    case = Case((keep, 3, 3, 2), 3, whole=False)
    terms = case.terms(0.25)
    bound = tolerances.inner_product(terms, keep, 64, 2, precision) + 4**keep * 2.0**-53 * np.abs(terms).sum(
        -1
    )
    assert_close(case.run(device, 0.25)[:, :3], terms.sum(axis=-1), bound)


@given(seed=st.integers(0, 2**31), points=st.integers(1, 70))
def test_every_group_size_agrees_with_the_twin(device: Device, seed: int, points: int) -> None:
    case = Case((2, 3, 1, 2), points, whole=True, seed=seed)
    expected = case.run(device, 1.0, plain=True)
    for group in (1, 4, 32, 128):
        kernel = device.kernels("shade.cl", KEEP=2, CHANNELS=3, SLICE_CHANNELS=1, N_SLICES=2, GROUP=group)[
            "inner_product"
        ]
        out = device.array(np.full((points, 4), np.nan))
        device.launch(
            kernel, group, group, device.array(case.reduced), device.array(case.slices),
            device.array(case.index, np.int32), device.array(case.weight), out, 1.0, 0, y=points,
        )  # fmt: skip
        assert (out.get() == expected).all()


def test_soft_radiance_scales_and_adds(device: Device) -> None:
    levels, keep = 5, 3
    case = Case((keep, 3, 3, 2), 7, whole=False)
    reduced, slices = device.array(case.reduced), device.array(case.slices)
    with guard_bands(device):
        got = shade.soft_radiance(device, reduced, slices, case.index, case.weight, levels).get()
    # Coefficients of a product on 4^levels samples of 2π/4^levels sr; f's are of 4^keep samples,
    # 2^(levels−keep) less.
    terms = case.terms(2 * np.pi / 4**levels * 2 ** (levels - keep))
    bound = tolerances.inner_product(terms, keep, 64, 2, "float32")
    assert_close(got[:, :3], terms.sum(axis=-1), bound)
    start = np.random.default_rng(1).normal(size=(7, 4)).astype(np.float32)
    out = device.array(start)
    again = shade.soft_radiance(device, reduced, slices, case.index, case.weight, levels, out=out)
    assert again is out
    assert (out.get() == start + got).all()


def test_two_runs_agree_bit_for_bit(device: Device) -> None:
    case = Case((6, 3, 3, 2), 3, whole=False)
    assert (case.run(device, 0.3) == case.run(device, 0.3)).all()


# --- hard light ---------------------------------------------------------------------------------------------

MATERIALS = [
    Material.parse("lambert:albedo=0.8/0.2/0.1"),
    Material.parse("ggx:alpha=0.3,f0=0.04,kd=0.5"),
    Material.parse("ggx:alpha=0.2,eta=0.2,k=3"),
]


@pytest.mark.parametrize("count", [1, 31, 32, 33])
@pytest.mark.parametrize("points", cases.GROUP_EDGES)
def test_hard_light_against_its_sum(device: Device, count: int, points: int) -> None:
    rng = np.random.default_rng([count, points])
    towards = rng.normal(size=(count, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    hard = (
        np.concatenate([towards, rng.uniform(0.1, 3, (count, 3))], axis=1)
        .astype(np.float32)
        .astype(np.float64)
    )
    light = Light(np.zeros((6, 3, 3, 4), np.float32), hard, np.eye(3), 1, 1.0)
    frames = cases.frames(points)
    material = rng.integers(0, 3, points).astype(np.int32)
    z, phi = rng.uniform(0.1, 1, points), rng.uniform(0, 6, points)
    views = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], axis=1).astype(
        np.float32
    )
    seen = rng.uniform(size=(points, count)) < 0.7
    words = np.zeros((points, (count + 31) // 32), np.uint32)
    for l in range(count):
        words[:, l // 32] |= seen[:, l].astype(np.uint32) << np.uint32(l % 32)
    start = rng.normal(size=(points, 4)).astype(np.float32)
    with guard_bands(device):
        materials = Materials(device, MATERIALS)
        out = device.array(start)
        shade.add_hard_radiance(device, materials, light, words, material, frames, views, out)
        got = out.get()
    expected, magnitude = start[:, :3].astype(np.float64), np.abs(start[:, :3]).astype(np.float64)
    for p in range(points):
        local = hard[:, :3] @ frames[p].astype(np.float64).T
        f = reference.brdf(MATERIALS[material[p]].reference(), local, views[p].astype(np.float64))
        terms = f * np.maximum(local[:, 2:], 0) * hard[:, 3:] * seen[p][:, None]
        expected[p] += terms.sum(axis=0)
        # A local direction is good to 4 u absolutely, which moves a lobe of width α by 4 u/α each way and a
        # cosine c by 4 u/c; F, D and G together have a slope of at most 16/α here (α = 0.2).
        slope = 64 / 0.2 * np.abs(f).max() * hard[:, 3:] * (local[:, 2:] > -1e-5)
        magnitude[p] += (count + 128) * terms.sum(axis=0) + slope.sum(axis=0)
    assert_close(got[:, :3], expected, 2.0**-24 * magnitude)
    assert (got[:, 3] == start[:, 3]).all()


def test_no_hard_light_changes_nothing(device: Device) -> None:
    light = Light(np.zeros((6, 3, 3, 4), np.float32), np.zeros((0, 6)), np.eye(3), 1, 0.0)
    out = device.array(np.ones((2, 4)))
    nothing = np.zeros((2, 0), np.uint32)
    material, views = np.zeros(2, np.int32), np.array([[0, 0, 1.0]] * 2)
    args = (device, Materials(device, MATERIALS), light, nothing, material, cases.frames(2), views, out)
    assert shade.add_hard_radiance(*args) is out
    assert (out.get() == 1).all()


# --- the white furnace --------------------------------------------------------------------------------------


def furnace(
    device: Device, material: Material, settings: Settings, radiance: float = 1.0
) -> tuple[NDArray[np.floating], ViewTable]:
    """Radiance of unoccluded points under a constant environment, one for each stored view."""
    light = Environment.constant(radiance).split(settings.levels)
    table = ViewTable.make(True, 5)
    count = len(table.views)
    bits = cases.pack_bits(np.ones((count, 4**settings.rays), bool))
    reduced = reduced_coefficients(device, light, bits, cases.frames(count), settings)
    slices = Materials(device, [material]).slices(table.views, settings.keep)
    index = np.stack([np.arange(count), np.zeros(count)], axis=1).astype(np.int32)
    weight = np.broadcast_to(np.array([1, 0], np.float32), (count, 2))
    rows = slices.reshape(count, -1, 4**settings.keep)
    return shade.soft_radiance(device, reduced, rows, index, weight, settings.levels).get()[:, :3], table


@pytest.mark.parametrize("method", ["pixel", "tree"])
@pytest.mark.parametrize("levels", range(1, 8))
def test_lambert_reflects_its_albedo(device: Device, levels: int, method: str) -> None:
    albedo = np.array([0.8, 0.35, 0.1])
    settings = Settings(levels=levels, rays=levels, keep=levels, method=method)
    got, _ = furnace(device, Material.parse("lambert:albedo=0.8/0.35/0.1"), settings, 2.0)
    # 1e-4 is what was asked for; what is left is rounding: the transforms and a sum of one sign.
    assert_close(got, np.broadcast_to(2 * albedo, got.shape), 2e-4)
    assert_close(
        got, np.broadcast_to(2 * albedo, got.shape), (6 * levels + 4**levels / 64 + 16) * 2.0**-24 * 2
    )


@pytest.mark.parametrize("keep", [1, 3])
@pytest.mark.parametrize("method", ["pixel", "tree"])
def test_lambert_with_fewer_levels_kept(device: Device, keep: int, method: str) -> None:
    settings = Settings(levels=4, rays=3, keep=keep, method=method)
    got, _ = furnace(device, Material.parse("lambert:albedo=0.5/0.4/0.3"), settings)
    assert_close(got, np.broadcast_to([0.5, 0.4, 0.3], got.shape), 1e-6)


@pytest.mark.parametrize(
    "spec", ["ggx:alpha=0.3,f0=1", "ggx:alpha=0.3,eta=0.2,k=3", "ggx:alpha=0.6,f0=0.04,kd=0.6"]
)
def test_ggx_against_numerical_integration(device: Device, spec: str) -> None:
    levels, m = 5, Material.parse(spec)
    got, table = furnace(device, m, Settings(levels=levels, rays=levels, keep=levels))
    depth = subsamples(m, levels)
    for row, view in zip(
        got[:-1], table.views[:-1], strict=True
    ):  # the last is grazing: f_v has no limit there
        finest = reference.slice_samples(m.reference(), view, 4, 5).mean(axis=0) * 2 * np.pi
        same = reference.slice_samples(m.reference(), view, levels, depth).mean(axis=0) * 2 * np.pi
        # The kernel's quadrature is as fine as `same`, whose distance from a finer one measures it.
        assert_close(row, finest, 2 * np.abs(same - finest) + 1e-4)
        assert (row <= 1).all()


@pytest.mark.parametrize("method", ["pixel", "tree"])
def test_half_the_sky_hidden(device: Device, method: str) -> None:
    """Lambert under half a constant sky, split through the normal: half the albedo, on every grid."""
    levels = 4
    light, frames = Environment.constant(1.0).split(levels), cases.frames(2)
    d = reference.directions(levels)
    bits = cases.pack_bits(np.stack([d[:, 0] > 0, d[:, 1] < 0]))
    settings = Settings(levels=levels, rays=levels, keep=levels, method=method)
    reduced = reduced_coefficients(device, light, bits, frames, settings)
    slices = Materials(device, [Material.parse("lambert:albedo=0.6/0.4/0.2")]).slices([[0, 0, 1.0]], levels)
    index, weight = np.zeros((2, 2), np.int32), np.full((2, 2), 0.5, np.float32)
    got = shade.soft_radiance(device, reduced, slices.reshape(1, 3, -1), index, weight, levels).get()[:, :3]
    assert_close(got, [[0.3, 0.2, 0.1]] * 2, 1e-6)
    assert quadtree.visibility_words(levels) == bits.shape[1]

"""L ⊕ V by both methods against the definition: haar(light · visibility), levels below `keep`."""

from __future__ import annotations

from collections.abc import Iterator

import cases
import numpy as np
import pytest
import tolerances
from guard import guard_bands
from numpy.typing import NDArray
from tolerances import assert_close

from prtcl import quadtree, reference
from prtcl.compute.device import Device
from prtcl.factors import environment, hemisphere
from prtcl.factors.environment import Environment, Light
from prtcl.transport import collapse
from prtcl.transport.collapse import reduced_coefficients
from prtcl.transport.settings import Settings
from prtcl.wavelet import pyramid


@pytest.fixture(scope="module", autouse=True, params=["simple", "wide"])
def form(request: pytest.FixtureRequest) -> Iterator[str]:
    """Each form of the kernels in turn."""
    with cases.forms(request.param == "wide"):
        yield request.param


GRIDS = [(1, 1, 1), (3, 3, 1), (3, 2, 2), (4, 4, 4), (5, 4, 3), (5, 3, 5), (6, 5, 5), (6, 6, 3), (7, 7, 7)]
"""levels, rays, keep"""


def light(levels: int, *, grey: bool = False) -> Light:
    """A map of high dynamic range, left whole."""
    image = np.exp(2 * np.random.default_rng(levels).normal(size=(8, 16, 3))).astype(np.float32)
    if grey:
        image[..., 1:] = image[..., :1]
    return Environment(image, rotate=20.0).split(levels, "off")


def upsampled(seen: NDArray[np.bool_], levels: int) -> NDArray[np.bool_]:
    return np.repeat(seen, 4**levels // seen.shape[1], axis=1)


@pytest.mark.parametrize("method", ["pixel", "tree"])
@pytest.mark.parametrize(
    ("levels", "rays", "keep", "channels"), [(*grid, 3) for grid in GRIDS] + [(3, 2, 2, 1), (4, 4, 4, 1)]
)
def test_against_the_reference(
    device: Device, levels: int, rays: int, keep: int, method: str, channels: int
) -> None:
    points = 65 if levels <= 3 else 5 if levels <= 6 else 2
    lit, frames = light(levels, grey=channels == 1), cases.frames(points)
    seen = cases.visibility(points, rays)
    with guard_bands(device):
        soft = environment.gather(device, lit, frames, channels=channels).get()
        settings = Settings(levels=levels, rays=rays, keep=keep, method=method)
        got = reduced_coefficients(device, lit, cases.pack_bits(seen), frames, settings, channels).get()
    assert got.shape == (points, channels, 4**keep)
    visible = upsampled(seen, levels)[:, None]
    product = soft.astype(np.float64) * visible
    expected = reference.haar(product)[..., : 4**keep]
    if method == "pixel":
        bound = tolerances.masked_average(product, levels, keep, "float32")
    else:
        # The transform of the light errs by 2 levels u ‖L‖; multiplying by 0 and 1 passes at most that on.
        own = tolerances.triple(
            reference.haar(soft), reference.haar(np.broadcast_to(visible, soft.shape)), "float32"
        )
        bound = tolerances.haar(levels, 2.0**-24, soft) + tolerances.norms(own)
    assert_close(tolerances.norms(got - expected), np.zeros((points, channels, 1)), bound, zeros=1)
    if (
        method == "pixel"
    ):  # whatever is hidden; the tree holds it where the brightest is seen (test_triple.py)
        assert (tolerances.relative_errors(got, expected) <= 2e-6).all()


def test_rays_weigh_by_their_own_cosine(device: Device) -> None:
    """Two points that differ in their grid alone, a third that sees everything: visibility times the weights."""
    levels, rays, lit = 4, 3, light(4)
    frames, seen = np.repeat(cases.frames(1), 3, axis=0), np.repeat(cases.visibility(1, rays), 3, axis=0)
    seen[2] = True
    grid = np.array([1, 6, 6], dtype=np.int32)
    settings = Settings(levels=levels, rays=rays, keep=levels)
    got = reduced_coefficients(device, lit, cases.pack_bits(seen), frames, settings, grid=grid).get()
    soft = environment.gather(device, lit, frames).get().astype(np.float64)
    weights = np.stack([hemisphere.ray_weights(rays, 1), hemisphere.ray_weights(rays, 6), np.ones(4**rays)])
    product = soft * np.repeat(seen * weights, 4 ** (levels - rays), axis=1)[:, None]
    bound = 2 * tolerances.masked_average(product, levels, levels, "float32")
    assert_close(tolerances.norms(got - reference.haar(product)), np.zeros((3, 3, 1)), bound, zeros=1)
    assert np.abs(got[0] - got[1]).max() > 0.01 * np.abs(got[0]).max()


@pytest.mark.parametrize("levels", [2, 5])
def test_float64(make_device, levels: int) -> None:
    device = make_device("float64")
    lit, frames, seen = light(levels), cases.frames(2), cases.visibility(2, levels)
    soft = environment.gather(device, lit, frames).get()
    expected = reference.haar(soft * seen[:, None])
    for method in ("pixel", "tree"):
        settings = Settings(levels=levels, rays=levels, keep=levels, method=method)
        got = reduced_coefficients(device, lit, cases.pack_bits(seen), frames, settings).get()
        assert (tolerances.relative_errors(got, expected) <= 1e-14 * levels).all()


@pytest.mark.parametrize("method", ["pixel", "tree"])
def test_all_visible_is_the_light_itself(device: Device, method: str) -> None:
    levels, lit, frames = 4, light(4), cases.frames(5)
    soft = environment.gather(device, lit, frames).get()
    everything = np.full((5, quadtree.visibility_words(levels)), 0xFFFFFFFF, dtype=np.uint32)
    settings = Settings(levels=levels, rays=levels, keep=levels, method=method)
    got = reduced_coefficients(device, lit, everything, frames, settings).get()
    bound = tolerances.haar(levels, 2.0**-24, soft)
    assert_close(tolerances.norms(got - reference.haar(soft)), np.zeros((5, 3, 1)), bound, zeros=1)
    nothing = np.zeros_like(everything)
    assert not reduced_coefficients(device, lit, nothing, frames, settings).get().any()


@pytest.mark.parametrize("method", ["pixel", "tree"])
def test_two_runs_agree_bit_for_bit(device: Device, method: str) -> None:
    lit, frames, bits = light(5), cases.frames(5), cases.pack_bits(cases.visibility(5, 5))
    settings = Settings(method=method)
    first, second = (reduced_coefficients(device, lit, bits, frames, settings).get() for _ in range(2))
    assert (first == second).all()


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("levels", "rays"), [(1, 1), (2, 2), (3, 3), (4, 2), (5, 4), (6, 6)])
def test_packed_sums_are_those_of_the_product(device: Device, levels: int, rays: int, channels: int) -> None:
    """The means of the stored product, packed: bit for bit in either form."""
    points = 9
    lit, frames = light(levels, grey=channels == 1), cases.frames(points)
    bits = cases.pack_bits(cases.visibility(points, rays))
    settings = Settings(levels=levels, rays=rays, keep=levels)
    rows = device.array(np.random.default_rng(0).permutation(points + 2)[:points], np.int32)
    scale = pyramid.scale_for(float(lit.cube[..., :3].max()))
    got, expected = (
        device.array(np.zeros((points + 2, quadtree.n_squares(levels + 1))), np.uint32) for _ in range(2)
    )
    with guard_bands(device):
        collapse.packed_sums(device, lit, bits, frames, settings, channels, rows, got, scale)
    product = collapse.product_samples(device, lit, bits, frames, settings, channels)
    pyramid.pack(device, product, rows, expected, scale)
    assert (got.get() == expected.get()).all()
    assert got.get().any()


def test_gather_gives_the_same_bits_in_every_form(device: Device) -> None:
    lit, frames = light(5), cases.frames(7)
    with environment.GATHER.trial(environment.GATHER.forms[0]):
        expected = environment.gather(device, lit, frames).get()
    with guard_bands(device):
        got = environment.gather(device, lit, frames).get()
    assert (got == expected).all()

"""a ⊕ V for V of bits: dense in every form, and in place, against haar(a · V) in float64."""

from __future__ import annotations

from collections.abc import Iterator

import cases
import numpy as np
import pytest
import tolerances
from guard import guard_bands
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tolerances import assert_close

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form
from prtcl.errors import InputError
from prtcl.wavelet import masked, triple


@pytest.fixture(scope="module", autouse=True, params=masked.DENSE.forms, ids=lambda form: form.name)
def form(request: pytest.FixtureRequest) -> Iterator[Form]:
    """Each form of the dense reduction in turn."""
    with masked.DENSE.trial(request.param), triple.REDUCTION.trial(Form("tree")):
        yield request.param


@pytest.fixture(params=masked.SPARSE.forms, ids=lambda form: str(form.size))
def group(request: pytest.FixtureRequest) -> Iterator[Form]:
    """Each form of the reduction in place."""
    with masked.SPARSE.trial(request.param):
        yield request.param


GRIDS = [(1, 1, 1), (3, 3, 3), (3, 2, 2), (4, 4, 1), (5, 4, 3), (5, 3, 5), (6, 6, 6), (6, 5, 5), (7, 7, 7)]
"""levels, rays, keep"""


def case(
    levels: int, rays: int, channels: int, points: int = 5
) -> tuple[NDArray[np.float64], NDArray[np.uint32], NDArray[np.float64]]:
    """Samples (points, channels, n), bits, and samples times visibility."""
    samples = cases.light_samples("high dynamic range", points * channels, levels).astype(np.float32)
    samples = samples.reshape(points, channels, -1).astype(np.float64)
    seen = cases.visibility(points, rays)
    return samples, cases.pack_bits(seen), samples * np.repeat(seen, 4 ** (levels - rays), axis=1)[:, None]


def shadows(points: int, levels: int) -> NDArray[np.bool_]:
    """Visibility as geometry makes it: all but caps of the hemisphere; the first point sees all, the second nothing."""
    rng = np.random.default_rng(levels)
    axes = reference.square_to_hemisphere(*rng.uniform(size=(2, points)))
    seen = axes @ reference.directions(levels).T < rng.uniform(-0.2, 0.95, (points, 1))
    seen[0] = True
    seen[1:2] = False
    return np.asarray(seen)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("levels", "rays", "keep"), GRIDS)
def test_dense_against_the_reference(
    any_device: Device, levels: int, rays: int, keep: int, channels: int
) -> None:
    device = any_device
    samples, bits, product = case(levels, rays, channels)
    expected = reference.haar(product)[..., : 4**keep]
    stored = reference.haar(samples).astype(device.dtype)
    with guard_bands(device):
        pixel = masked.reduce_samples(device, device.array(samples), bits, rays, keep).get()
        tree = masked.reduce_coefficients(device, device.array(stored), bits, rays, keep).get()
    zero, u = np.zeros((len(samples), channels, 1)), tolerances.STORED[device.precision]
    own = tolerances.masked_average(product, levels, keep, device.precision)
    own += tolerances.haar(levels, 2.0**-53, product)
    assert_close(tolerances.norms(pixel - expected), zero, own, zeros=len(zero) * channels)
    # From coefficients, rounded when they were stored: what inverting them errs by passes the mask at most whole.
    from_stored = own + tolerances.haar(levels, u, samples) + u * tolerances.norms(samples)
    everywhere = np.broadcast_to(product != 0, samples.shape).astype(np.float64)
    from_stored += tolerances.norms(tolerances.triple(stored, reference.haar(everywhere), device.precision))
    assert_close(tolerances.norms(tree - expected), zero, from_stored, zeros=len(zero) * channels)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("levels", range(1, 8))
@pytest.mark.usefixtures("group")
def test_in_place_against_the_reference(any_device: Device, levels: int, channels: int) -> None:
    device, points = any_device, 7
    samples = cases.light_samples("random", points * channels, levels).reshape(points, channels, -1)
    stored = reference.haar(samples).astype(device.dtype)
    for seen in (shadows(points, levels), cases.visibility(points, levels)):
        with guard_bands(device):
            target = device.array(stored)
            assert masked.reduce_in_place(device, target, cases.pack_bits(seen)) is target
            got = target.get()
        exact = reference.haar(reference.ihaar(stored.astype(np.float64)) * seen[:, None])
        u = tolerances.STORED[device.precision] + 2.0**-53
        bound = 2 * tolerances.haar(levels, u, stored)  # down and up again, at most all of the tree
        assert_close(
            tolerances.norms(got - exact), np.zeros((points, channels, 1)), bound, zeros=points * channels
        )
        everything = seen.all(axis=1)
        assert (got[everything] == stored[everything]).all()
        assert not got[~seen.any(axis=1)].any()


@given(seed=st.integers(0, 2**31), levels=st.integers(1, 5), share=st.floats(0, 1))
def test_in_place_equals_the_dense_one(device: Device, seed: int, levels: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    samples = rng.integers(0, 8, (3, 2, 4**levels)).astype(np.float64)
    # Whole squares of a random level, so that uniform ones occur on every level; whole numbers: exact both ways.
    coarse = rng.integers(0, levels + 1)
    seen = np.repeat(rng.random((3, 4**coarse)) < share, 4 ** (levels - coarse), axis=1)
    bits = cases.pack_bits(seen)
    stored = device.array(reference.haar(samples))
    dense = masked.reduce_coefficients(device, stored, bits, levels, levels).get()
    assert (masked.reduce_in_place(device, stored, bits).get() == dense).all()


def test_two_runs_agree_bit_for_bit(device: Device) -> None:
    samples, bits, _ = case(6, 6, 3)
    runs = [
        (
            masked.reduce_samples(device, device.array(samples), bits, 6, 6).get(),
            masked.reduce_coefficients(device, device.array(samples), bits, 6, 6).get(),
            masked.reduce_in_place(device, device.array(samples), bits).get(),
        )
        for _ in range(2)
    ]
    for first, second in zip(*runs, strict=True):
        assert (first == second).all()


@pytest.mark.parametrize(
    ("shape", "words", "rays"),
    [((2, 1, 64), (2, 1), 3), ((2, 1, 64), (3, 2), 3), ((2, 64), (2, 2), 3), ((2, 1, 64), (2, 8), 4)],
)
def test_shapes_that_do_not_fit_are_refused(
    device: Device, shape: tuple[int, ...], words: tuple[int, int], rays: int
) -> None:
    bits = np.zeros(words, dtype=np.uint32)
    for call in (masked.reduce_samples, masked.reduce_coefficients):
        with pytest.raises(InputError, match=r"and bits: expected \(points, channels, 4\*\*levels\)"):
            call(device, device.empty(shape), bits, rays, 1)

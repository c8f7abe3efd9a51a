"""kernels/haar.cl against the float64 reference, its plain twin, and the laws of an orthonormal transform."""

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

from prtcl import quadtree, reference
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form
from prtcl.errors import InputError
from prtcl.wavelet import haar


@pytest.fixture(
    scope="module", autouse=True, params=[Form("items"), Form("wide", 8)], ids=lambda form: form.name
)
def form(request: pytest.FixtureRequest) -> Iterator[Form]:
    """Each form of the transform in turn."""
    with haar.TRANSFORM.trial(request.param):
        yield request.param


LEVELS_AND_ROWS = [(levels, rows) for levels in range(1, 8) for rows in cases.row_counts(levels)]


def plain(device: Device, x: NDArray[np.floating], *, inverse: bool = False) -> NDArray[np.floating]:
    """The plain twins of kernels/haar_plain.cl."""
    rows, levels = haar.check_rows(x, "x")
    kernels = device.kernels("haar_plain.cl", GROUP=8)
    src, dst, scratch = device.array(x), device.empty(x.shape), device.empty(x.shape)
    if inverse:
        device.launch(kernels["haar_inverse_plain"], rows, 8, src, dst, rows, levels)
    else:
        device.launch(kernels["haar_forward_plain"], rows, 8, src, dst, scratch, rows, levels)
    return np.asarray(dst.get())


@pytest.mark.parametrize(("levels", "rows"), LEVELS_AND_ROWS)
def test_integers_are_exact_both_ways(device: Device, levels: int, rows: int) -> None:
    # |samples| < 2^10: every sum is an integer over 2^7 below 2^24, exact in float32.
    x = np.random.default_rng(levels).integers(-1000, 1000, (rows, 4**levels)).astype(np.float32)
    with guard_bands(device):
        coefficients = haar.forward(device, device.array(x))
        back = haar.inverse(device, coefficients)
        assert (plain(device, x) == reference.haar(x)).all()
        assert (plain(device, coefficients.get(), inverse=True) == x).all()
    assert (coefficients.get() == reference.haar(x)).all()
    assert (back.get() == x).all()


@pytest.mark.parametrize(("levels", "rows"), LEVELS_AND_ROWS)
def test_against_the_reference(any_device: Device, levels: int, rows: int) -> None:
    device = any_device
    u = tolerances.STORED[device.precision]
    x = cases.light_samples("random", rows, levels).astype(device.dtype)
    with guard_bands(device):
        forward = haar.forward(device, device.array(x)).get()
        inverse = haar.inverse(device, device.array(x)).get()
    for got, expected in ((forward, reference.haar(x)), (inverse, reference.ihaar(x))):
        error = tolerances.norms(got - expected)
        # The float64 reference rounds as much as a float64 device.
        bound = tolerances.haar(levels, u, x) + tolerances.haar(levels, 2.0**-53, x)
        assert_close(error, np.zeros_like(error), bound, zeros=1)


@pytest.mark.parametrize("levels", range(1, 8))
def test_equals_the_plain_twin(any_device: Device, levels: int) -> None:
    device = any_device
    x = cases.light_samples("high dynamic range", cases.row_counts(levels)[-1], levels).astype(device.dtype)
    forward = haar.forward(device, device.array(x)).get()
    inverse = haar.inverse(device, device.array(x)).get()
    if (
        device.precision == "mixed"
    ):  # the twin stores float32 after every level, the kernels after every launch
        for got, twin in ((forward, plain(device, x)), (inverse, plain(device, x, inverse=True))):
            bound = 2 * tolerances.haar(levels, 2.0**-24, x)
            assert_close(tolerances.norms(got - twin), np.zeros((len(x), 1)), bound, zeros=1)
    else:
        assert (forward == plain(device, x)).all()
        assert (inverse == plain(device, x, inverse=True)).all()


@pytest.mark.parametrize("kind", cases.KINDS)
@pytest.mark.parametrize("levels", range(1, 8))
def test_acceptance(any_device: Device, levels: int, kind: str) -> None:
    """‖error‖/‖reference‖ ≤ 2e-6 in float32, 1e-14 · levels in float64, for every row."""
    device = any_device
    x = cases.light_samples(kind, 3, levels).astype(device.dtype)
    coefficients = haar.forward(device, device.array(x)).get()
    limit = 1e-14 * levels if device.precision == "float64" else 2e-6
    assert (tolerances.relative_errors(coefficients, reference.haar(x)) <= limit).all()


@given(seed=st.integers(0, 2**31), levels=st.integers(1, 5), rows=st.integers(1, 70))
def test_round_trip_and_parseval(device: Device, seed: int, levels: int, rows: int) -> None:
    x = cases.light_samples("random", rows, levels, seed).astype(np.float32)
    coefficients = haar.forward(device, device.array(x))
    back = haar.inverse(device, coefficients).get()
    bound = tolerances.haar(levels, 2.0**-24, x)
    assert_close(tolerances.norms(back.astype(np.float64) - x), np.zeros((rows, 1)), 2 * bound, zeros=1)
    assert_close(tolerances.norms(coefficients.get()), tolerances.norms(x), bound)


@given(depth=st.integers(1, 3), seed=st.integers(0, 2**31), group=st.sampled_from([1, 8, 64, 128]))
def test_every_stage_depth_and_group_agree(device: Device, depth: int, seed: int, group: int) -> None:
    """One launch of every DEPTH and GROUP on levels 1 … 3 equals the library's answer bit for bit."""
    x = cases.light_samples("random", 37, depth, seed).astype(np.float32)
    kernels = device.kernels("haar.cl", DEPTH=depth, GROUP=group)
    out, back, unused = device.empty(x.shape), device.empty(x.shape), device.empty((len(x),))
    src = device.array(x)
    run = 4**depth
    device.launch(kernels["haar_forward"], len(x), group, src, run, out, run, unused, len(x), 0, 1.0)
    device.launch(kernels["haar_inverse"], len(x), group, src, run, src, back, len(x), 0)
    assert (out.get() == haar.forward(device, src).get()).all()
    assert (back.get() == haar.inverse(device, src).get()).all()


def test_scale_by_a_power_of_two_is_exact(device: Device) -> None:
    x = device.array(cases.light_samples("random", 5, 5))
    plain_scale = haar.forward(device, x).get()
    assert (haar.forward(device, x, scale=8.0).get() == 8 * plain_scale).all()


def test_leading_axes_and_given_output(device: Device) -> None:
    x = cases.light_samples("random", 6, 4).astype(np.float32)
    flat = haar.forward(device, device.array(x)).get()
    out = device.array(np.full((2, 3, 4**4), np.nan))
    assert haar.forward(device, device.array(x.reshape(2, 3, -1)), out=out) is out
    assert (out.get().reshape(6, -1) == flat).all()
    back = device.array(np.full((2, 3, 4**4), np.nan))
    assert haar.inverse(device, out, out=back) is back
    assert (back.get() == haar.inverse(device, device.array(flat)).get().reshape(2, 3, -1)).all()


@pytest.mark.parametrize("bottom", [1, 2, 4])
def test_coarse_levels_from_means_leave_the_finer_alone(device: Device, bottom: int) -> None:
    levels, rows = 5, 9
    means = cases.light_samples("random", rows, bottom).astype(np.float32)
    out = device.array(np.full((rows, 4**levels), 7.0))
    haar.forward_from_means(device, device.array(means), bottom, out)
    got = out.get()
    assert (got[:, 4**bottom :] == 7).all()
    assert (got[:, : 4**bottom] == haar.forward(device, device.array(means)).get()).all()


def test_two_runs_agree_bit_for_bit(device: Device) -> None:
    x = device.array(cases.light_samples("high dynamic range", 3, 6))
    assert (haar.forward(device, x).get() == haar.forward(device, x).get()).all()


@pytest.mark.parametrize("shape", [(3, 8), (3, 1), (3, 4**10), (), (16, 3)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    class Fake:
        pass

    Fake.shape, Fake.size = shape, int(np.prod(shape))
    with pytest.raises(InputError, match=r"light: expected shape \(\.\.\., 4\*\*levels\) with 1 to 9 levels"):
        haar.check_rows(Fake, "light")


@pytest.mark.parametrize("most", [haar.STAGE, haar.WIDE_STAGE])
def test_stages_cover_all_levels_once(most: int) -> None:
    for levels in range(1, quadtree.MAX_LEVELS + 1):
        taken = [level for top, depth in haar.stages(levels, most) for level in range(top, top + depth)]
        assert sorted(taken) == list(range(levels))
        assert all(depth <= most for _, depth in haar.stages(levels, most))
        if most == haar.WIDE_STAGE and levels > 1:  # what vectors of sixteen take
            assert all(depth > 1 for _, depth in haar.stages(levels, most))


@pytest.mark.parametrize("levels", [8, 9])
def test_the_deepest_trees(device: Device, levels: int) -> None:
    x = cases.light_samples("random", 2, levels).astype(np.float32)
    coefficients = haar.forward(device, device.array(x))
    back = haar.inverse(device, coefficients).get()
    bound = tolerances.haar(levels, 2.0**-24, x)
    assert_close(tolerances.norms(coefficients.get() - reference.haar(x)), np.zeros((2, 1)), bound, zeros=1)
    assert_close(tolerances.norms(back - x), np.zeros((2, 1)), 2 * bound, zeros=1)

"""kernels/triple.cl against the float64 reference, its plain twin, and the laws of a product."""

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
from prtcl.wavelet import triple


@pytest.fixture(scope="module", autouse=True, params=triple.REDUCTION.forms, ids=lambda form: form.name)
def form(request: pytest.FixtureRequest) -> Iterator[Form]:
    """Each form of the reduction in turn."""
    with triple.REDUCTION.trial(request.param):
        yield request.param


LEVELS_AND_ROWS = [(levels, rows) for levels in range(1, 8) for rows in cases.row_counts(levels)]


def coefficients(samples: NDArray[np.floating], device: Device) -> NDArray[np.floating]:
    """Of rows of samples, in float64, then rounded to what the device stores: the exact input of a test."""
    return reference.haar(samples).astype(device.dtype)


def reduce(
    device: Device, a: NDArray[np.floating], b: NDArray[np.floating], **options: int
) -> NDArray[np.floating]:
    """`triple.reduce` of rows: a, b (rows, n) as one channel each."""
    got = triple.reduce(device, device.array(a[:, None]), device.array(b[:, None]), **options)
    return np.asarray(got.get())[:, 0]


def plain(device: Device, a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.floating]:
    """The plain twin; a (points, channels, n), b (points, channels or 1, n)."""
    points, channels, n = a.shape
    levels = quadtree.levels_of(n)
    kernel = device.kernels("triple.cl", LEVELS=levels, CHANNELS=channels, CHANNELS_B=b.shape[1], GROUP=64)
    energy = device.empty((points * channels, quadtree.n_squares(levels)), triple.accumulator_dtype(device))
    out = device.empty(a.shape)
    rows = points * channels
    device.launch(kernel["triple_plain"], rows, 64, device.array(a), device.array(b), energy, out, rows)
    return np.asarray(out.get())


def oracle_bound(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.float64]:
    """What the float64 oracle itself may err by: transforms of ‖a b‖ ≤ ‖a‖ ‖b‖."""
    levels = quadtree.levels_of(a.shape[-1])
    return (6 * levels + 1) * 2.0**-53 * tolerances.norms(a) * tolerances.norms(b)


@pytest.mark.parametrize(("levels", "rows"), LEVELS_AND_ROWS)
def test_integers_are_exact(device: Device, levels: int, rows: int) -> None:
    """Samples that are whole numbers of 0 … 3: all sums are below 2^24 in units of 4^(−levels)."""
    rng = np.random.default_rng(levels)
    high = 4 if levels <= 4 else 2
    a, b = rng.integers(0, high, (2, rows, 4**levels))
    with guard_bands(device):
        got = reduce(device, reference.haar(a), reference.haar(b))
        twin = got
        if not (levels == 7 and cases.ends_long_loops(device)):
            twin = plain(device, reference.haar(a)[:, None], reference.haar(b)[:, None])[:, 0]
    assert (got == reference.haar(a * b)).all()
    assert (twin == reference.haar(a * b)).all()


@pytest.mark.parametrize(("levels", "rows"), LEVELS_AND_ROWS)
def test_against_the_reference_and_the_plain_twin(any_device: Device, levels: int, rows: int) -> None:
    device = any_device
    a = coefficients(cases.light_samples("random", rows, levels), device)
    b = coefficients(cases.light_samples("random", rows, levels, seed=1), device)
    bound = tolerances.triple(a, b, device.precision)
    with guard_bands(device):
        got = reduce(device, a, b)
        # Building the twin takes its time: every level in float32, one in the other precisions.
        compare = levels == 4 or (device.precision == "float32" and levels < 7)
        twin = plain(device, a[:, None], b[:, None])[:, 0] if compare else got
    assert_close(got, reference.triple(a, b), bound + oracle_bound(a, b))
    assert_close(twin, got, 2 * bound)


@pytest.mark.parametrize("channels_b", [1, 3])
def test_channels_share_or_own_the_second_factor(device: Device, channels_b: int) -> None:
    levels, points = 4, 7
    a = coefficients(cases.light_samples("random", 3 * points, levels), device).reshape(points, 3, -1)
    b = coefficients(cases.light_samples("random", channels_b * points, levels, 1), device)
    b = b.reshape(points, channels_b, -1)
    with guard_bands(device):
        got = triple.reduce(device, device.array(a), device.array(b)).get()
        twin = plain(device, a, b)
    bound = tolerances.triple(a, b, "float32")
    assert_close(got, reference.triple(a, b), bound + oracle_bound(a, b))
    assert_close(twin, got, 2 * bound)


# --- acceptance ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", cases.KINDS)
@pytest.mark.parametrize("levels", range(1, 8))
def test_acceptance(any_device: Device, levels: int, kind: str) -> None:
    """L ⊕ V for every point: ‖error‖/‖reference‖ ≤ 2e-6 in float32 and mixed, 1e-14 · levels in float64.

    In float32 and float64 the brightest sample is seen; `mixed` must do as well where it is hidden (below).
    """
    device = any_device
    rows = 16 if levels < 7 else 4
    light, seen = cases.light_samples(kind, rows, levels), cases.visibility(rows, levels)
    seen[np.arange(rows), np.abs(light).argmax(axis=1)] = True
    a, b = coefficients(light, device), coefficients(seen, device)
    errors = tolerances.relative_errors(reduce(device, a, b), reference.triple(a, b))
    assert (errors <= (1e-14 * levels if device.precision == "float64" else 2e-6)).all()


@pytest.mark.parametrize("levels", range(1, 8))
def test_mixed_holds_where_the_brightest_sample_is_hidden(make_device, levels: int) -> None:
    """A sample 1000 times as bright as all the rest together, hidden: float32 sums lose what is left."""
    device = make_device("mixed")
    rows = 8 if levels < 7 else 3
    light, seen = cases.light_samples("high dynamic range", rows, levels), cases.visibility(rows, levels)
    brightest = light.argmax(axis=1)
    everyone = np.arange(rows)
    light[everyone, brightest] = 1e3 * light.sum(axis=1)
    seen[everyone, (brightest + 1) % 4**levels] = True
    seen[everyone, brightest] = False
    a, b = coefficients(light, device), coefficients(seen, device)
    expected = reference.triple(a, b)
    assert (tolerances.relative_errors(reduce(device, a, b), expected) <= 2e-6).all()
    if levels >= 4:  # the case is a hard one: float32 fails it
        single = reduce(make_device("float32"), a, b)
        assert (tolerances.relative_errors(single, expected) > 2e-6).any()


# --- laws ---------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**31), levels=st.integers(1, 5), rows=st.integers(1, 9))
def test_symmetric_under_argument_swap(device: Device, seed: int, levels: int, rows: int) -> None:
    a = coefficients(cases.light_samples("random", rows, levels, seed), device)
    b = coefficients(cases.light_samples("random", rows, levels, seed + 1), device)
    assert_close(reduce(device, a, b), reduce(device, b, a), 2 * tolerances.triple(a, b, "float32"))


@pytest.mark.parametrize("levels", range(1, 8))
def test_all_ones_is_the_identity(device: Device, levels: int, form: Form) -> None:
    a = coefficients(cases.light_samples("random", 3, levels), device)
    ones = coefficients(np.ones((3, 4**levels)), device)
    for got in (reduce(device, a, ones), reduce(device, ones, a)):
        if form.name == "tree" or not triple.wide_fits(levels):
            # psum of ones is 1 and the energy 0: nothing rounds, and a_j psum(b) is a_j itself.
            assert (got == a).all()
        else:  # to samples and back
            bound = 2 * tolerances.haar(levels, 2.0**-24, a)
            assert_close(tolerances.norms(got - a), np.zeros((3, 1)), bound, zeros=1)


def test_visibility_squared_is_visibility(device: Device) -> None:
    # Sums of whole numbers times powers of two: exact in every form.
    seen = coefficients(cases.visibility(5, 5), device)
    assert (reduce(device, seen, seen) == seen).all()


@pytest.mark.parametrize("levels", [1, 2, 4, 6])
def test_keep_is_the_truncation_of_the_full_result(any_device: Device, levels: int) -> None:
    a = coefficients(cases.light_samples("high dynamic range", 3, levels), any_device)
    b = coefficients(cases.visibility(3, levels), any_device)
    full = reduce(any_device, a, b)
    for keep in range(1, levels + 1):
        with guard_bands(any_device):
            kept = reduce(any_device, a, b, keep=keep)
        assert kept.shape == (3, 4**keep)
        assert (kept == full[:, : 4**keep]).all()


def test_truncating_before_the_product_is_another_thing(device: Device) -> None:
    a, b = (coefficients(cases.light_samples("random", 2, 4, seed), device) for seed in (1, 2))
    coarse = reference.triple(a[:, :16], b[:, :16]) / 4  # 2^(2−4): the same functions on the finer grid
    assert np.abs(reduce(device, a, b, keep=2) - coarse).max() > 0.1


@pytest.mark.parametrize("levels", range(1, 8))
def test_parent_sums(any_device: Device, levels: int) -> None:
    device = any_device
    a = coefficients(cases.light_samples("random", 5, levels), device)
    with guard_bands(device):
        got = triple.parent_sums(device, device.array(a)).get()
    assert got.dtype == triple.accumulator_dtype(device)
    u = tolerances.SUMMED[device.precision]
    # Terms are 2^(r−R) |a_j|, two additions a level; the reference goes through samples: ‖·‖ bounds a mean.
    bound = 2 * levels * (u + 2.0**-53) * np.abs(a).sum(axis=1, keepdims=True)
    assert_close(got, reference.parent_sums(a), bound)


def test_two_runs_agree_bit_for_bit(device: Device) -> None:
    a = coefficients(cases.light_samples("high dynamic range", 5, 6), device)
    b = coefficients(cases.visibility(5, 6), device)
    assert (reduce(device, a, b) == reduce(device, a, b)).all()


def test_given_output(device: Device) -> None:
    a = coefficients(cases.light_samples("random", 5, 3), device)[:, None]
    out = device.array(np.full((5, 1, 16), np.nan))
    pair = device.array(a), device.array(a)
    assert triple.reduce(device, *pair, keep=2, out=out) is out
    assert (out.get() == triple.reduce(device, *pair).get()[..., :16]).all()


@pytest.mark.parametrize(
    ("shape_a", "shape_b", "keep", "message"),
    [
        ((2, 1, 16), (3, 1, 16), None, "same points and levels"),
        ((2, 1, 16), (2, 1, 64), None, "same points and levels"),
        ((2, 16), (2, 16), None, "expected a"),
        ((2, 3, 16), (2, 2, 16), None, "b: expected 1 or 3 channels"),
        ((2, 1, 16), (2, 1, 16), 3, "keep: expected 1 to 2"),
        ((2, 1, 16), (2, 1, 16), 0, "keep: expected 1 to 2"),
        ((2, 1, 15), (2, 1, 16), None, "a: expected shape"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(
    device: Device, shape_a: tuple[int, ...], shape_b: tuple[int, ...], keep: int | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        triple.reduce(device, device.empty(shape_a), device.empty(shape_b), keep=keep)

"""The tests' own comparison and bounds: what they must refuse, and that the bounds hold."""

from __future__ import annotations

import numpy as np
import pytest
import tolerances
from tolerances import assert_close

from prtcl import quadtree, reference

ONES = np.ones((3, 4))


def test_equal_passes_with_a_bound_of_zero(capsys: pytest.CaptureFixture[str]) -> None:
    assert_close(ONES, ONES, 0.0)
    assert capsys.readouterr().out == "worst error/bound 0 at (0, 0)\n"


def test_message_names_place_ratio_and_count() -> None:
    got = ONES.copy()
    got[1, 2] += 3e-3
    got[2, 3] -= 2e-3
    with pytest.raises(AssertionError, match=r"error/bound 3 at \(1, 2\).*bound 0.001; 2 of 12 beyond it"):
        assert_close(got, ONES, 1e-3)


def test_error_just_inside_and_outside() -> None:
    assert_close([1.0 + 2.0**-20], [1.0], 2.0**-20)
    with pytest.raises(AssertionError, match="error/bound 2 at"):
        assert_close([1.0 + 2.0**-19], [1.0], 2.0**-20)


def test_bound_is_taken_element_by_element() -> None:
    bound = np.array([1.0, 0.0])
    assert_close([1.5, 1.0], [1.0, 1.0], bound)
    with pytest.raises(AssertionError, match=r"at \(1,\)"):
        assert_close([1.0, 1.5], [1.0, 1.0], bound)


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
def test_prefilled_values_are_refused(poison: float) -> None:
    got = ONES.copy()
    got[2, 1] = poison
    with pytest.raises(AssertionError, match=r"1 of 12 values are NaN or infinite, the first at \(2, 1\)"):
        assert_close(got, ONES, 1e30)
    with pytest.raises(AssertionError, match="MISTRUSTED"):
        assert_close(ONES, got, 1e30)


def test_mostly_zero_expectations_are_mistrusted() -> None:
    mostly = np.zeros(10)
    mostly[:4] = 1.0
    with pytest.raises(AssertionError, match="MISTRUSTED: 60% of the expected answer is zero"):
        assert_close(mostly, mostly, 1.0)
    assert_close(mostly, mostly, 1.0, zeros=0.6)


def test_nothing_compared_and_other_shapes_are_refused() -> None:
    with pytest.raises(AssertionError, match="MISTRUSTED: nothing"):
        assert_close(np.empty((0, 4)), np.empty((0, 4)), 1.0)
    with pytest.raises(AssertionError, match="shape"):
        assert_close(np.ones((3, 1)), ONES, 1.0)  # would broadcast


@pytest.mark.parametrize("bound", [-1.0, np.nan, np.inf])
def test_senseless_bounds_are_refused(bound: float) -> None:
    with pytest.raises(AssertionError, match="MISTRUSTED"):
        assert_close(ONES, ONES, bound)


def test_relative_errors() -> None:
    np.testing.assert_allclose(tolerances.relative_errors([[3.0, 4.5]], [[3.0, 4.0]]), [0.1])
    with pytest.raises(AssertionError, match="MISTRUSTED"):
        tolerances.relative_errors([[0.0, 0.0]], [[0.0, 0.0]])
    with pytest.raises(AssertionError, match="NaN"):
        tolerances.relative_errors([[np.nan, 0.0]], [[1.0, 0.0]])


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_triple_magnitude_is_the_brute_force_one(levels: int) -> None:
    rng = np.random.default_rng(levels)
    a, b = rng.normal(size=(2, 4**levels))
    brute = np.einsum("ijk,j,k->i", np.abs(reference.tripling_coefficients(levels)), np.abs(a), np.abs(b))
    # The coefficients that should vanish are some 1e-17 each in the brute-force sums.
    np.testing.assert_allclose(tolerances.triple_magnitude(a, b), brute, rtol=1e-12)


def test_haar_bound_holds_for_a_float32_transform_and_is_not_idle() -> None:
    levels = 5
    x = np.random.default_rng(1).normal(size=(64, 4**levels)).astype(np.float32)
    means, out = x, np.empty_like(x)
    for level in reversed(range(levels)):
        children = means.reshape(64, -1, 4)
        signs = quadtree.SIGNS.astype(np.float32)
        for m in range(3):
            terms = children * signs[m]
            out[:, 4**level + m : 4 ** (level + 1) : 3] = (
                (terms[..., 0] + terms[..., 1]) + (terms[..., 2] + terms[..., 3])
            ) / np.float32(2)
        means = ((children[..., 0] + children[..., 1]) + (children[..., 2] + children[..., 3])) / np.float32(
            2
        )
    out[:, 0] = means[:, 0]
    error = np.linalg.norm(out - reference.haar(x), axis=1, keepdims=True)
    bound = tolerances.haar(levels, 2.0**-24, x)
    assert (error <= bound).all()
    assert (error >= bound / 100).all()

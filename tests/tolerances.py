"""The one comparison of the tests; the bounds it is given are the package's own, `prtcl.bounds`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl.bounds import (
    STORED,
    SUMMED,
    Array,
    brdf,
    dot,
    haar,
    inner_product,
    inner_product_plain,
    masked_average,
    measured_lookup,
    norms,
    table_lookup,
    triple,
    triple_magnitude,
)

__all__ = [
    "STORED", "SUMMED", "UNIT", "assert_close", "brdf", "dot", "haar", "inner_product", "inner_product_plain",
    "masked_average", "measured_lookup", "norms", "relative_errors", "table_lookup", "triple", "triple_magnitude",
    "worst_ratio",
]  # fmt: skip

UNIT = {"float32": 2.0**-24, "float64": 2.0**-53}


def worst_ratio(actual: npt.ArrayLike, expected: npt.ArrayLike, bound: npt.ArrayLike) -> float:
    """The largest |actual − expected| / bound; 0/0 is 0."""
    return float(_ratios(actual, expected, bound).max(initial=0.0))


def _ratios(actual: npt.ArrayLike, expected: npt.ArrayLike, bound: npt.ArrayLike) -> Array:
    error = np.abs(np.asarray(actual, dtype=np.float64) - np.asarray(expected, dtype=np.float64))
    allowed = np.broadcast_to(np.asarray(bound, dtype=np.float64), error.shape)
    if (allowed < 0).any() or not np.isfinite(allowed).all():
        raise AssertionError("MISTRUSTED: a bound is negative or not finite")
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(error == 0.0, 0.0, error / allowed)


def assert_close(
    actual: npt.ArrayLike, expected: npt.ArrayLike, bound: npt.ArrayLike, *, zeros: float = 0.5
) -> None:
    """Assert |actual − expected| ≤ bound everywhere; print the worst error/bound and where it is.

    Parameters
    ----------
    bound : broadcasts against both; ≥ 0
    zeros : the share of `expected` that may be exactly zero; more is refused as MISTRUSTED, since a kernel
    that
        writes zeros would pass
    """
    got, wanted = np.asarray(actual, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    assert got.shape == wanted.shape, f"shape {got.shape}, expected {wanted.shape}"
    assert wanted.size, "MISTRUSTED: nothing was compared"
    assert np.isfinite(wanted).all(), "MISTRUSTED: the expected answer is not finite"
    share = float((wanted == 0.0).mean())
    assert share <= zeros, f"MISTRUSTED: {share:.0%} of the expected answer is zero"
    bad = ~np.isfinite(got)
    first = tuple(int(i) for i in np.argwhere(bad)[0]) if bad.any() else ()
    assert not bad.any(), f"{int(bad.sum())} of {got.size} values are NaN or infinite, the first at {first}"
    ratios = _ratios(got, wanted, bound)
    at = np.unravel_index(int(np.argmax(ratios)), ratios.shape)
    where = tuple(int(i) for i in at)
    print(f"worst error/bound {ratios[at]:.3g} at {where}")
    assert ratios[at] <= 1.0, (
        f"error/bound {ratios[at]:.3g} at {where}: got {float(got[at])!r}, expected {float(wanted[at])!r}, "
        f"bound {float(np.broadcast_to(bound, got.shape)[at])!r}; "
        f"{int((ratios > 1).sum())} of {got.size} beyond it"
    )


def relative_errors(actual: npt.ArrayLike, expected: npt.ArrayLike) -> Array:
    """‖error‖₂ / ‖expected‖₂ of every row; a row of zeros is refused."""
    got, wanted = np.asarray(actual, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    assert got.shape == wanted.shape
    length = norms(wanted)[..., 0]
    assert (length > 0).all(), "MISTRUSTED: an expected row is all zero"
    error: Array = norms(got - wanted)[..., 0] / length
    assert np.isfinite(error).all(), "NaN or infinite values"
    print(f"worst relative error {error.max():.3g}")
    return error

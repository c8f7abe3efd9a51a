"""The bivariate table that best explains linear measurements of it: least squares, smooth, not negative, robust.

Minimised per channel over f̃ ≥ 0 is

    Σ_p w_p ((A f̃ − b)_p / σ_p)²  +  λ ∫∫ (∂²ln f̃/∂t² / κ_h)² + (∂²ln f̃/∂u² / κ_d)² + the same of slopes  dt du

with t = √(θ_h / 90°) and u = θ_d / 90°. The roughness is relative: a peak of 100 may curve as a shade of 0.1 does and
is not flattened, and a lobe that is seen at some θ_d continues with its shape to where it is not. To keep the problem
linear the logarithm is taken at the last round's estimate, ln f̃ ≈ ln s − 1 + f̃ / s. σ_p is relative to what the pixel
should be, with a floor; its size is that of the residuals. Pixels far off it lose their weight w_p: first as Huber's
function has it, under which a highlight that the start does not know keeps pulling, in the last rounds as Tukey's,
which lets go.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.errors import PrtclError

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.floating]

CURVATURE_H, CURVATURE_D = 30.0, 3.0
"""κ: relative curvature that costs as much as a residual of one σ, over all t and over all u. A GGX lobe of α = 0.3
falls by exp(6) over t = 0.8, a curvature of about 20; along θ_d there are only Fresnel's rise and shadowing."""
SLOPE_H, SLOPE_D = 100.0, 3.0
"""The same of relative slopes: nodes that no pixel reads stay near those that one does."""
FLOOR = 0.05
"""σ of a black pixel over that of one of the mean brightness."""
SMALLEST = 3e-3
"""Values below this share of the mean count as so large in s."""
HUBER, TUKEY = 2.0, 8.0
"""Residuals, in robust standard deviations, at which their weight starts to fall, and at which it is gone."""
ROUNDS, LAST = 10, 2
"""Rounds at most, and how many of them, once the others have settled, are Tukey's."""
SETTLED = 0.1
"""Change of what is predicted, in standard deviations, from which further rounds are not worth it."""
LEAST_NOISE = 1e-4
"""Relative noise that is assumed at least of measurements whose rows are exact but for float32."""
BLOCK = 2048
"""Rows multiplied at a time."""


@dataclass(frozen=True, eq=False)
class Solution:
    """What `solve` found.

    Attributes
    ----------
    values : (nh, nd, channels) ≥ 0
    deviation : (nh, nd) standard deviation of a value over the value, the worst channel's: what noise and the
        smoothness leave open
    alone : (nh, nd) the same by the measurements without the smoothness, were all other values known
    read : (nh, nd) bool, whether any measurement depends on the node
    weights : (n,) in [0, 1], the last ones: 0 is an outlier
    predicted : (n, channels) A f̃
    noise : relative standard deviation of the residuals, robust
    rounds : how many were needed
    """

    values: Array
    deviation: Array
    alone: Array
    read: npt.NDArray[np.bool_]
    weights: Array
    predicted: Array
    noise: float
    rounds: int


def solve(
    rows: Rows, measured: npt.ArrayLike, theta_h: Array, theta_d: Array, *, smoothness: float = 1.0,
    robust: bool = True, rounds: int = ROUNDS,
    least_noise: float = LEAST_NOISE,
) -> Solution:  # fmt: skip
    """The table of which `rows` times it are the measurements.

    Parameters
    ----------
    rows : (n, 1 or channels, nh · nd); one channel serves all
    measured : (n, channels)
    theta_h, theta_d : (nh,), (nd,) nodes
    smoothness : λ
    robust : False weighs all measurements alike
    least_noise : relative, of the measurements and the rows together, taken for granted

    Raises
    ------
    PrtclError
        If scipy is not there, or nothing measures anything.
    """
    b = np.asarray(measured, np.float64)
    shape, channels = (theta_h.size, theta_d.size), b.shape[1]
    own = [min(c, rows.shape[1] - 1) for c in range(channels)]
    sums = np.stack([rows[:, c].sum(axis=1, dtype=np.float64) for c in own], axis=1)
    if not (sums > 0).any():
        raise PrtclError("fit: no pixel is lit; nothing can be said of the table")
    # The start is Lambert's: one value, of the median pixel.
    start = [float(np.median(b[s > 0, c] / s[s > 0])) for c, s in enumerate(sums.T)]
    x = np.repeat(np.maximum(start, 1e-6)[:, None], rows.shape[2], axis=1)
    predicted = sums * x[:, 0]
    floor = FLOOR * np.maximum(np.abs(b).mean(axis=0), 1e-30)
    weights = np.ones(len(b))
    deviation, alone = np.empty_like(x), np.empty_like(x)
    done = last = 0
    settled = False
    while done < rounds and last < LAST:
        done += 1
        final = settled or done > rounds - LAST
        last += final
        spread = np.hypot(predicted, floor)
        relative = np.sqrt((((predicted - b) / spread) ** 2).mean(axis=1))
        noise = max(1.4826 * float(np.median(relative)), least_noise)
        if robust:
            weights = _weights(relative / noise, final)
        before = predicted
        predicted = np.empty_like(b)
        for c in range(channels):
            size = np.maximum(x[c], max(SMALLEST * float(x[c].mean()), 1e-12))
            roughness, pull = _roughness(theta_h, theta_d, size)
            per_row = weights / (noise * spread[:, c]) ** 2
            normal, right = _normal(rows[:, own[c]], b[:, c], per_row)
            x[c], deviation[c] = _minimum(normal + smoothness * roughness, right + smoothness * pull, size)
            alone[c] = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300)) / size
            predicted[:, c] = _product(rows[:, own[c]], x[c])
        moved = np.sqrt((((predicted - before) / spread) ** 2).mean())
        settled = settled or moved < SETTLED * noise
        if settled and not robust:
            break
    read = np.any([np.asarray(rows[:, c] != 0).any(axis=0) for c in set(own)], axis=0)
    return Solution(
        x.T.reshape(*shape, channels), deviation.max(axis=0).reshape(shape), alone.max(axis=0).reshape(shape),
        read.reshape(shape), weights, predicted, noise, done,
    )  # fmt: skip


def _weights(far: Array, last: bool) -> Array:
    """Of residuals in robust standard deviations."""
    if last:
        return np.asarray(np.maximum(1 - (far / TUKEY) ** 2, 0.0) ** 2)
    return np.asarray(np.minimum(1.0, HUBER / np.maximum(far, 1e-30)))


def _normal(rows: Rows, measured: Array, weights: Array) -> tuple[Array, Array]:
    """Aᵀ W A and Aᵀ W b in float64, a block of rows at a time."""
    size = rows.shape[1]
    normal, right = np.zeros((size, size)), np.zeros(size)
    for start in range(0, len(rows), BLOCK):
        part = slice(start, start + BLOCK)
        own = rows[part] * np.sqrt(weights[part])[:, None]
        normal += own.T @ own
        right += own.T @ (measured[part] * np.sqrt(weights[part]))
    return normal, right


def _product(rows: Rows, x: Array) -> Array:
    parts = (rows[start : start + BLOCK].astype(np.float64) @ x for start in range(0, len(rows), BLOCK))
    return np.concatenate(list(parts))


def _minimum(matrix: Array, right: Array, scale: Array) -> tuple[Array, Array]:
    """x ≥ 0 that minimises xᵀ M x − 2 xᵀ r, and the standard deviation that M leaves it, over `scale`.

    Solved in x / scale, whose entries are of one size.
    """
    linalg, nnls = _scipy()
    whole = matrix * scale[:, None] * scale
    whole[np.diag_indices_from(whole)] *= 1 + 1e-12
    factor = linalg.cholesky(whole, lower=True)
    half = linalg.solve_triangular(factor, right * scale, lower=True)
    x = linalg.solve_triangular(factor, half, lower=True, trans=1)
    if (x < 0).any():
        x, _ = nnls(factor.T, half, maxiter=30 * len(x))
    inverse = linalg.solve_triangular(factor, np.eye(len(x)), lower=True)
    return x * scale, np.sqrt((inverse**2).sum(axis=0))


def _differences(at: Array) -> tuple[Array, Array]:
    """Curvatures (k, n) and slopes (n − 1, n) of values at places, times the root of the length each stands for.

    The first place is where the function is even (the peak of a lobe, or the half vector at the light): its
    neighbour is its own mirror image.
    """
    n, step = at.size, np.diff(at)
    slopes = np.zeros((max(n - 1, 0), n))
    index = np.arange(n - 1)
    slopes[index, index], slopes[index, index + 1] = -1 / step, 1 / step
    curvatures = np.zeros((max(n - 1, 0), n))
    if n > 1:
        curvatures[0] = 2 * slopes[0] / step[0] * np.sqrt(step[0] / 2)
        width = (step[1:] + step[:-1]) / 2
        curvatures[1:] = (slopes[1:] - slopes[:-1]) / np.sqrt(width)[:, None]
    return curvatures, slopes * np.sqrt(step)[:, None]


def _lengths(at: Array) -> Array:
    """What each place stands for of the whole."""
    if at.size == 1:
        return np.ones(1)
    step = np.diff(at)
    return np.asarray((np.append(step, 0) + np.insert(step, 0, 0)) / 2)


def _roughness(theta_h: Array, theta_d: Array, size: Array) -> tuple[Array, Array]:
    """R and r: xᵀ R x − 2 xᵀ r is the roughness of ln s − 1 + x / s, but for a constant, for s (nh · nd,)."""
    t, u = np.sqrt(theta_h / (np.pi / 2)), theta_d / (np.pi / 2)
    index = np.arange(t.size * u.size).reshape(t.size, u.size)
    matrix = np.zeros((index.size, index.size))
    for places, others, lines, curvature, slope in (
        (t, u, index.T, CURVATURE_H, SLOPE_H), (u, t, index, CURVATURE_D, SLOPE_D)
    ):  # fmt: skip
        curvatures, slopes = _differences(places)
        own = curvatures.T @ curvatures / curvature**2 + slopes.T @ slopes / slope**2
        for line, width in zip(lines, _lengths(others), strict=True):
            matrix[np.ix_(line, line)] += own * width
    return matrix / size[:, None] / size, -(matrix @ np.log(size)) / size


def _scipy() -> tuple[Any, Any]:
    try:
        import scipy.linalg
        from scipy.optimize import nnls
    except ImportError as error:
        raise PrtclError(
            "fit: solving for a table needs scipy, which is not installed\npip install prtcl[fit]"
        ) from error
    return scipy.linalg, nnls

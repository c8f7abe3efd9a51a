"""Directions over a point's hemisphere: the concentric equal-area grid, and where in its cell each sample lies.

The map is Shirley & Chiu's concentric square-to-disk map lifted by z = 1 − r²; every one of the 4**levels
samples subtends 2π/4**levels sr.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.factors.sequence import shuffled, stratified

CENTRE = (0.5, 0.5)

LOW = 0.5
"""Mean cosine of a cell below which its ray is weighed by its own (bench/rays.py: 0.1 % left; 0.2 % for 0.3)."""

ALONE = -1
"""The visibility grid of a point that shares no pixel with others: samples at the cells' centres."""


def cell_offset(grid: int) -> tuple[float, float]:
    """Place of the sample inside its cell for a visibility grid: number of the point in its pixel, or `ALONE`.

    Grids with different places let the sub-pixel points of one pixel see the scene through a finer grid together
    than each has alone. The places are stratified like the points themselves, in an order of their own, and
    centred: places that lean to one side (a Kronecker sequence did, 0.38 on average for the first four) darken or
    brighten grazing directions.
    """
    if grid == ALONE:
        return CENTRE
    x, y = stratified(shuffled(grid))
    return float(y), float(x)


@lru_cache(maxsize=256)
def directions(levels: int, offset: tuple[float, float] = CENTRE) -> npt.NDArray[np.float32]:
    """Local unit directions of the samples in Morton order.

    Parameters
    ----------
    levels : of the grid
    offset : place in the cell, (column, row) in [0, 1)²

    Returns
    -------
    directions : (4**levels, 4) float32, read-only, the layout of OpenCL's float4: x, y, z, and the mean cosine
        over the cell (exact: with it a constant environment gives a Lambert surface its albedo on any grid)
    """
    rows, columns = quadtree.morton_to_grid(levels)
    side = 1 << levels
    out = np.zeros((rows.size, 4), dtype=np.float32)
    out[:, :3] = from_square((columns + offset[0]) / side, (rows + offset[1]) / side)
    out[:, 3] = mean_cosines(rows, columns, side)
    out.setflags(write=False)
    return out


@lru_cache(maxsize=4096)
def ray_weights(levels: int, grid: int) -> npt.NDArray[np.float32]:
    """Weight of each ray of a visibility grid: its cosine over the mean cosine of its cell.

    f_v holds the cosine averaged over a cell, but where a surface hides part of a cell the cosine of what is left
    is another: at the horizon occluders hide the low directions first, and pictures come out dark by 0.5 % at
    4^4 rays. With this weight the rays of a pixel's points together sum the cosine where they went (0.1 % instead,
    bench/rays.py). A grid's weights keep its sum of cosines, so an open hemisphere under constant light is exact.
    Above `LOW` they are 1: there the cosine hardly varies inside a cell, and weights would shift a lobe that lies in
    a few cells by some percent between one sub-pixel point and the next.

    Returns
    -------
    weights : (4**levels,) float32, Morton order, read-only; ones for `ALONE`, whose one ray stands for all its cell
    """
    mean = directions(levels)[:, 3].astype(np.float64)
    weights, low = np.ones_like(mean), mean < LOW
    if grid != ALONE and low.any():
        cosine = directions(levels, cell_offset(grid))[low, 2].astype(np.float64)
        weights[low] = cosine / mean[low] * (mean[low].sum() / cosine.sum())
    out = weights.astype(np.float32)
    out.setflags(write=False)
    return out


def mean_cosines(
    rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64], side: int
) -> npt.NDArray[np.float64]:
    """Mean of z = 1 − max(|a|, |b|)² over cells of width h = 2/side, given by row and column: the shape of those.

    Away from the diagonals one coordinate is the larger one throughout: the mean of its square is that of the
    centre plus h²/12. On a diagonal, with a and b in [q, q + h], the mean of max² is q² + 4/3 q h + h²/2.
    """
    if side == 1:
        return np.full(rows.shape, 0.5)
    h = 2.0 / side
    a, b = np.abs(2 * columns + 1 - side) / side, np.abs(2 * rows + 1 - side) / side
    nearest = np.maximum(a, b) - h / 2
    return 1.0 - np.where(
        a == b, nearest**2 + 4 / 3 * nearest * h + h**2 / 2, np.maximum(a, b) ** 2 + h**2 / 12
    )


def from_square(u: npt.ArrayLike, v: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Local directions (..., 3), z ≥ 0, of points of the unit square; u runs along columns, v along rows."""
    a, b = 2.0 * np.asarray(u, dtype=np.float64) - 1.0, 2.0 * np.asarray(v, dtype=np.float64) - 1.0
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    ratio = np.divide(np.where(wide, b, a), radius, out=np.zeros_like(radius), where=radius != 0.0)
    angle = np.where(wide, np.pi / 4 * ratio, np.pi / 2 - np.pi / 4 * ratio)
    lift = radius * np.sqrt(2.0 - radius**2)
    return np.stack([lift * np.cos(angle), lift * np.sin(angle), 1.0 - radius**2], axis=-1)


def to_square(directions: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Inverse of `from_square`: u and v in [0, 1] of local directions (..., 3) with z ≥ 0."""
    d = np.asarray(directions, dtype=np.float64)
    radius = np.sqrt(np.maximum(1.0 - d[..., 2], 0.0))
    x, y = np.abs(d[..., 0]), np.abs(d[..., 1])
    longer = np.maximum(x, y)
    octant = np.arctan2(np.minimum(x, y), np.where(longer > 0.0, longer, 1.0)) * (4 / np.pi) * radius
    a = np.where(x > y, radius, octant) * np.copysign(1.0, d[..., 0])
    b = np.where(x > y, octant, radius) * np.copysign(1.0, d[..., 1])
    return (a + 1.0) / 2.0, (b + 1.0) / 2.0


def frames_from(
    normals: npt.NDArray[np.floating], towards: npt.NDArray[np.floating] | None = None
) -> npt.NDArray[np.float32]:
    """Orthonormal frames (tangent, bitangent, normal as rows) over unit normals.

    Parameters
    ----------
    normals : (n, 3) unit, world
    towards : (n, 3) world directions whose projection becomes the tangent, such as the view direction: an
        isotropic BRDF then needs slices for one view angle only. None takes a fixed tangent per normal
        (Duff et al. 2017, "Building an Orthonormal Basis, Revisited").

    Returns
    -------
    frames : (n, 3, 3) float32
    """
    n = np.asarray(normals, dtype=np.float64)
    sign = np.copysign(1.0, n[:, 2])
    a = -1.0 / (sign + n[:, 2])
    b = n[:, 0] * n[:, 1] * a
    tangent = np.stack([1.0 + sign * n[:, 0] ** 2 * a, sign * b, -sign * n[:, 0]], axis=1)
    if towards is not None:
        projected = towards - np.sum(towards * n, axis=1, keepdims=True) * n
        length = np.linalg.norm(projected, axis=1, keepdims=True)
        tangent = np.where(length > 1e-6, projected / np.maximum(length, 1e-6), tangent)
    return np.stack([tangent, np.cross(n, tangent), n], axis=1).astype(np.float32)

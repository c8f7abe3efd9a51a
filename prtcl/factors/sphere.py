"""One grid of directions that all points share: the hemisphere's grid over the up axis, and again below.

Cells are those of `prtcl.factors.hemisphere`, equal areas of 2π/4**levels sr, in Morton order, the upper hemisphere's
first. On such a grid light is the same row of numbers for every point, and turning it is a resampling of the
environment alone.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.factors import environment, hemisphere
from prtcl.factors.environment import Light
from prtcl.factors.sequence import stratified

FRAMES = np.array(
    [[[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]]], dtype=np.float32
)  # fmt: skip
"""World tangent, bitangent and normal of the upper and of the lower hemisphere."""

FINEST = 8
"""Levels that light is gathered at before it is averaged over coarser cells. Gathered at the cells' own, a lamp of one
texel brightens and darkens as it turns past their centres, and at one level more sums were 0.3 % low."""


def n_cells(levels: int) -> int:
    """Cells of the whole sphere: 2 · 4**levels."""
    return 2 * quadtree.n_samples(levels)


@lru_cache(maxsize=8)
def centres(levels: int) -> npt.NDArray[np.float32]:
    """World directions of the cells' centres: (n_cells, 4) float32, read-only, the last column 0."""
    local = hemisphere.directions(levels)[:, :3]
    out = np.zeros((n_cells(levels), 4), dtype=np.float32)
    out[:, :3] = np.concatenate([local @ frame for frame in FRAMES])
    out.setflags(write=False)
    return out


@lru_cache(maxsize=4)
def places(levels: int, count: int) -> npt.NDArray[np.float32]:
    """World directions at `count` places of every cell: (count, n_cells, 3) float32, read-only.

    The places of one cell are stratified, and each cell's are shifted (Cranley & Patterson 1976) by a random number of
    its own: a pixel that takes one place in each cell samples the sphere without the lattice's regularity.
    """
    x, y = stratified(np.arange(count))
    shift = np.random.default_rng(levels).random((2, 2, quadtree.n_samples(levels)))
    rows, columns = quadtree.morton_to_grid(levels)
    side = 1 << levels
    out = np.empty((count, 2, quadtree.n_samples(levels), 3), dtype=np.float32)
    for half, frame in enumerate(FRAMES):
        u = (columns + (x[:, None] + shift[half, 0]) % 1.0) / side
        v = (rows + (y[:, None] + shift[half, 1]) % 1.0) / side
        out[:, half] = hemisphere.from_square(u, v) @ frame
    flat = out.reshape(count, -1, 3)
    flat.setflags(write=False)
    return flat


def cell_of(directions: npt.ArrayLike, levels: int) -> npt.NDArray[np.int64]:
    """The cell that each world direction (n, 3) lies in: (n,)."""
    world = np.asarray(directions, dtype=np.float64)
    side, below = 1 << levels, world[:, 1] < 0.0
    local = np.where(below[:, None], world @ FRAMES[1].T, world @ FRAMES[0].T)
    u, v = (np.clip((x * side).astype(np.int64), 0, side - 1) for x in hemisphere.to_square(local))
    return np.asarray(quadtree.grid_to_morton(levels)[v, u] + below * quadtree.n_samples(levels))


def around(directions: npt.ArrayLike, levels: int) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
    """The four cells about each world direction (n, 3) and their bilinear weights: both (n, 4).

    At a hemisphere's edge its own outermost cells stand for what would lie beyond.
    """
    world = np.asarray(directions, dtype=np.float64)
    side, below = 1 << levels, world[:, 1] < 0.0
    local = np.where(below[:, None], world @ FRAMES[1].T, world @ FRAMES[0].T)
    (j, fj), (i, fi) = (
        (np.floor(x), x - np.floor(x)) for x in (t * side - 0.5 for t in hemisphere.to_square(local))
    )
    morton, cells, weights = quadtree.grid_to_morton(levels), [], []
    for di in (0, 1):
        for dj in (0, 1):
            row, column = (np.clip(x, 0, side - 1).astype(np.int64) for x in (i + di, j + dj))
            cells.append(morton[row, column] + below * quadtree.n_samples(levels))
            weights.append(np.abs(1 - di - fi) * np.abs(1 - dj - fj))
    return np.stack(cells, axis=1).astype(np.int32), np.stack(weights, axis=1)


def light_means(device: Device, light: Light, levels: int) -> npt.NDArray[np.float32]:
    """Soft radiance averaged over the cells of `levels`, at most ``light.levels``: (n_cells, 3) float32."""
    fine = environment.gather(device, light, FRAMES).get()
    by_cell = fine.reshape(2, 3, quadtree.n_samples(levels), -1).mean(axis=3, dtype=np.float64)
    return np.ascontiguousarray(by_cell.transpose(0, 2, 1).reshape(-1, 3), dtype=np.float32)

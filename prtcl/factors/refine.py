"""Visibility with fewer rays: a coarse grid first, then only the cells whose neighbours disagree.

What a point sees of its hemisphere is a few large areas. One ray is traced in each block of cells; a block whose eight
neighbours all say the same keeps their answer, others are cut in four and traced again. A block's ray goes through its
cell nearest the horizon, where most of what a point cannot see begins. Against every ray 0.01 to 0.09 % of the bits are
wrong, those of things smaller than a block that lie on no corner of one (bench/visibility.py).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from prtcl import quadtree

FROM = 5
"""Levels from which it pays: of 16 x 16 cells too few are left out."""
BLOCKS, LARGEST = 8, 8
"""Blocks along a side to begin with, each of at most so many cells along its own."""

Bits = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]


def visibility(
    points: int, levels: int, visible: Callable[[Indices, Indices], Bits], blocks: int = BLOCKS
) -> Bits:
    """What each point sees: (points, 4**levels) bool in Morton order.

    Parameters
    ----------
    visible : whether some rays reach the light, given each one's point and its sample's number in Morton order
    blocks : along a side to begin with, at least
    """
    side = 1 << levels
    morton, order = _tables(levels)
    step = max(1, min(LARGEST, side // blocks))

    def trace(which: Bits) -> Bits:
        cells = _outermost(side, step)
        point, block = np.divmod(np.flatnonzero(which), len(cells) ** 2)
        return visible(point, np.take(morton[np.ix_(cells, cells)].ravel(), block))

    shape = points, side // step, side // step
    seen: Bits = trace(np.ones(shape, dtype=np.bool_)).reshape(shape)
    while step > 1:
        again, seen = _doubled(_disagreeing(seen)), _doubled(seen)
        before, step = _outermost(side, step), step // 2
        known = np.isin(_outermost(side, step), before)
        again[:, known[:, None] & known] = False
        seen[again] = trace(again)
    return np.take(seen.reshape(points, -1), order, axis=1)


@lru_cache(maxsize=16)
def _tables(levels: int) -> tuple[Indices, Indices]:
    """Morton number of every cell of the grid, and each Morton number's place in the grid, row by row."""
    rows, columns = quadtree.morton_to_grid(levels)
    return quadtree.grid_to_morton(levels), (rows << levels) + columns


def _outermost(side: int, step: int) -> Indices:
    """Each block's cell nearest the border, along one side. That of a block is that of one of its parts, too."""
    first = np.arange(0, side, step)
    return np.where(2 * first >= side, first + step - 1, first)


def _doubled(grid: Bits) -> Bits:
    return np.repeat(np.repeat(grid, 2, axis=1), 2, axis=2)


def _disagreeing(seen: Bits) -> Bits:
    """Cells (points, n, n) of which one of the eight neighbours differs."""
    some, every = seen, seen
    for axis in (1, 2):
        all_points = (slice(None),) * axis
        low, high = (*all_points, slice(None, -1)), (*all_points, slice(1, None))
        wider, narrower = some.copy(), every.copy()
        wider[high] |= some[low]
        wider[low] |= some[high]
        narrower[high] &= every[low]
        narrower[low] &= every[high]
        some, every = wider, narrower
    return some & ~every

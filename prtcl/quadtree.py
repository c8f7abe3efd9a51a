"""The quadtree: where samples, squares and coefficients lie in memory.

All index arithmetic of the Python side is here; `kernels/quadtree.clh` is its twin on the device.

A hemisphere is a grid of ``side × side`` samples, ``side = 2**levels``. Samples are stored in Morton order,
so that the samples of any square of the tree are one contiguous run. Square ``(r, s)`` is the s-th square of
level r (``0 <= s < 4**r``; level 0 is the whole grid); its children are ``(r + 1, 4 s + c)`` with
``c = 2 * row_bit + column_bit``.

Each square carries three wavelets M = 1, 2, 3 (written 01, 10, 11), whose sign in child c is
``(-1)**popcount(M & c)``: 01 changes sign with the column, 10 with the row, 11 with both. Coefficients are
stored by level: the scaling function at 0, then wavelet M of square (r, s) at ``4**r + 3 s + M - 1``, so the
first ``4**k`` entries are exactly the levels below k.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

MAX_LEVELS = 9
"""The deepest tree that is supported: 512 × 512 directions."""

SIGNS = np.array([[(-1) ** ((m & c).bit_count() & 1) for c in range(4)] for m in (1, 2, 3)], dtype=np.int8)
"""(3, 4) int8: the sign of wavelet M = row + 1 in child c = column."""


def n_samples(levels: int) -> int:
    """Samples, and coefficients, of a tree of `levels` levels: ``4**levels``."""
    return 1 << (2 * levels)


def n_squares(levels: int) -> int:
    """Squares that carry wavelets, levels ``0 … levels - 1``: ``(4**levels - 1) / 3``."""
    return (n_samples(levels) - 1) // 3


def levels_of(count: int) -> int:
    """The number of levels whose grid has `count` samples.

    Raises
    ------
    ValueError
        If `count` is not a power of four.
    """
    levels = (count.bit_length() - 1) // 2
    if count < 1 or n_samples(levels) != count:
        raise ValueError(f"expected a power of four of samples (1, 4, 16, …), got {count}")
    return levels


def square(level: int, index: int) -> int:
    """Position of square (level, index) in an array over all squares, coarse to fine."""
    return n_squares(level) + index


def coefficient(level: int, index: int, wavelet: int) -> int:
    """Position of wavelet 1, 2 or 3 of square (level, index) among the coefficients."""
    return n_samples(level) + 3 * index + wavelet - 1


def morton_to_grid(levels: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Row and column of every sample, in Morton order.

    Returns
    -------
    rows, columns : (4**levels,) int64
    """
    index = np.arange(n_samples(levels), dtype=np.int64)
    rows = np.zeros_like(index)
    columns = np.zeros_like(index)
    for bit in range(levels):
        columns |= ((index >> (2 * bit)) & 1) << bit
        rows |= ((index >> (2 * bit + 1)) & 1) << bit
    return rows, columns


def grid_to_morton(levels: int) -> npt.NDArray[np.int64]:
    """Morton index of every sample of the grid: ``samples[..., grid_to_morton(levels)]`` is the picture.

    Returns
    -------
    index : (side, side) int64, row and column
    """
    rows, columns = morton_to_grid(levels)
    side = 1 << levels
    index = np.empty((side, side), dtype=np.int64)
    index[rows, columns] = np.arange(rows.size)
    return index


def turned_squares(levels: int) -> npt.NDArray[np.int32]:
    """Where every square of levels 0 … `levels` goes under the eight turns of the square.

    Turn t swaps rows and columns if t & 4, then mirrors the columns if t & 1 and the rows if t & 2. Turns of the grid
    are turns of the hemisphere about its normal and mirrors through it: the concentric map keeps the square's symmetry.

    Returns
    -------
    index : (8, n_squares(levels + 1)) int32, positions as `square` gives them
    """
    out = np.empty((8, n_squares(levels + 1)), dtype=np.int32)
    for level in range(levels + 1):
        rows, columns = morton_to_grid(level)
        morton, last = grid_to_morton(level), (1 << level) - 1
        for turn in range(8):
            r, c = (columns, rows) if turn & 4 else (rows, columns)
            r, c = (last - r if turn & 2 else r), (last - c if turn & 1 else c)
            out[turn, n_squares(level) : n_squares(level + 1)] = n_squares(level) + morton[r, c]
    return out


def visibility_words(levels: int) -> int:
    """32-bit words that hold one point's visibility bits (a last word is padded with zeros)."""
    return max(1, n_samples(levels) // 32)

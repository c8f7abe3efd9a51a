"""Points that stay evenly spread however many are added: pixels and hemisphere cells are sampled at them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def stratified(index: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Place of the index-th point in the unit square: a (0, 2)-sequence (van der Corput and Sobol' bit reversal).

    The first N × N points, N a power of two, put exactly one into each cell of an N × N grid, so points may be
    added until there are enough and none is thrown away.

    Returns
    -------
    x, y : (n,) in [0, 1)
    """
    i = np.asarray(index, dtype=np.uint32)
    x, y = np.zeros_like(i), np.zeros_like(i)
    column = np.uint32(1 << 31)
    for bit in range(32):
        on = (i >> np.uint32(bit)) & np.uint32(1)
        x ^= on << np.uint32(31 - bit)
        y ^= on * column
        column ^= column >> np.uint32(1)
    # Bit reversal alone puts the first point of every stratum into its corner: a picture shifted by an eighth of
    # a pixel at four points. Flipping the bits 0110 0110 … keeps the strata and moves each first point to within a
    # tenth of a stratum of its centre, for 1, 4, 16, 64 and 256 points alike.
    centre = np.uint32(0x66666666)
    return (x ^ centre) / 2.0**32, (y ^ centre) / 2.0**32

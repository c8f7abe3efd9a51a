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


def shuffled(index: int) -> int:
    """The index in another order, which takes every aligned run of 2**k numbers to such a run.

    Two places made from one number move together: sub-pixel place and direction would cover a plane of their four
    dimensions, and more points would not bring the mean nearer. Numbers shuffled in the manner of Owen (1995), each
    bit flipped or not by a hash of the bits above it, decouple the two and leave `stratified` as even as it was.
    Nothing is flipped under zeros, so the first 2**k numbers stay the first 2**k: few points lie as well as many.
    """
    out = index
    for bit in range(index.bit_length()):
        above = index >> (bit + 1)
        if above and _hash(above * 32 + bit) & 1:
            out ^= 1 << bit
    return out


def _hash(x: int) -> int:
    """Mixed bits of a 32-bit number: xorshift and multiply, twice (Wellons 2018, "Prospecting for hash functions")."""
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x = ((x ^ (x >> shift)) * factor) & 0xFFFFFFFF
    return x ^ (x >> 16)

"""Bytes that a stage must move and floating-point operations that it must do: lower bounds, from its size alone.

Bytes: every input read once, every output written once. Tables that stay in a cache (directions, the light's cube,
leaves of a cut) count nothing, nor does anything that a stage stores for itself on the way. Operations: additions and
multiplications of the cheapest way known; a division, a square root or a comparison of numbers that decides a value
counts one. Index arithmetic, conversions and bits count nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree

REAL = 4
"""Bytes of a float32."""
BUTTERFLY = 8
"""Additions that take four values to a mean and three details: two a pair, twice. Halves go into other factors."""
TURN = 15
"""A direction into another frame: nine products, six sums."""
LOOK_UP = 7
"""Where in the cube: one division, two multiply-adds, two fractions."""
BILINEAR = 9
"""For a channel: three interpolations of a difference, a product and a sum."""
GGX = 41
"""A microfacet lobe but for Fresnel: half vector 12, its cosine 5, D 8, two Smith terms 12, their product 4."""
FRESNEL = 25
"""A conductor's exact reflectance, for a channel."""


@dataclass(frozen=True)
class Size:
    """What a stage is run at."""

    points: int
    levels: int
    channels: int

    @property
    def samples(self) -> int:
        """Directions of a hemisphere, 4**levels."""
        return quadtree.n_samples(self.levels)

    @property
    def squares(self) -> int:
        """Squares that carry wavelets."""
        return quadtree.n_squares(self.levels)

    @property
    def row(self) -> int:
        """Bytes of a point's row of all channels."""
        return self.channels * self.samples * REAL

    @property
    def bits(self) -> int:
        """Bytes of a point's visibility."""
        return 4 * quadtree.visibility_words(self.levels)

    @property
    def transform(self) -> int:
        """Operations of a point's transform, one way: `BUTTERFLY` a square and channel."""
        return BUTTERFLY * self.channels * self.squares


Cost = tuple[float, float]
"""Bytes and floating-point operations."""
FRAME = 9 * REAL
RADIANCE = 4 * REAL


def visibility(size: Size) -> Cost:
    """Origin and frame in, bits out; every direction turned into the world. Tracing itself is not counted."""
    return size.points * (3 * REAL + FRAME + size.bits), size.points * TURN * size.samples


def bits_to_coefficients(size: Size) -> Cost:
    """Bits in, one row out; one transform's additions, of counts."""
    return size.points * (size.bits + size.row), size.points * size.transform


def light(size: Size) -> Cost:
    """A frame in, a row out; a look-up a direction."""
    flops = size.samples * (TURN + LOOK_UP + BILINEAR * size.channels)
    return size.points * (FRAME + size.row), size.points * flops


def light_times_visibility(size: Size, seen: int) -> Cost:
    """A frame and bits in, a row out; a look-up and a weight for each of the `seen` directions of all points."""
    flops = seen * (TURN + LOOK_UP + (BILINEAR + 1) * size.channels)
    return size.points * (FRAME + size.bits + size.row), max(1, flops)


def light_times_visibility_reduced(size: Size, seen: int) -> Cost:
    """The same and a transform."""
    moved, flops = light_times_visibility(size, seen)
    return moved, flops + size.points * size.transform


def pack(size: Size) -> Cost:
    """A row and its place in, four bytes a square of levels 0 … levels out.

    A square's mean is three sums and a product a channel; packing scales each channel and takes three multiply-adds.
    """
    squares = quadtree.n_squares(size.levels + 1)
    flops = 4 * size.channels * size.squares + (size.channels + 6) * squares
    return size.points * (size.row + 4 + 4 * squares), size.points * flops


def light_times_visibility_packed(size: Size, seen: int) -> Cost:
    """The product straight into packed sums: its row is never stored."""
    moved, flops = light_times_visibility(size, seen)
    own, packing = pack(size)
    return moved + own - 2 * size.points * size.row, flops + packing


def haar(size: Size) -> Cost:
    """A row in, a row out; one transform."""
    return 2 * size.points * size.row, size.points * size.transform


def parent_sums(size: Size) -> Cost:
    """A row in, a mean a square out; the inverse transform without its finest level."""
    moved = size.row + size.channels * size.squares * REAL
    flops = size.channels * (BUTTERFLY * quadtree.n_squares(max(1, size.levels - 1)) + 1)
    return size.points * moved, size.points * flops


def reduction(size: Size) -> Cost:
    """Two factors' rows in, the second of one channel, a row out.

    The fewest operations known: both factors back to samples, a product a sample, and the transform of that.
    """
    single = size.transform // size.channels
    flops = 2 * size.transform + single + size.channels * size.samples
    return size.points * (2 * size.row + size.row // size.channels), size.points * flops


def bits_reduction(size: Size) -> Cost:
    """A row and bits in, a row out; to samples and back."""
    return size.points * (2 * size.row + size.bits), size.points * 2 * size.transform


def sparse_reduction(size: Size, words: npt.NDArray[np.uint32]) -> Cost:
    """Bits in; mixed squares' three numbers in and out, hidden squares' out; two butterflies a mixed square.

    Parameters
    ----------
    words : (points, words) uint32 visibility
    """
    flat = np.unpackbits(words.astype("<u4").view(np.uint8), axis=1, bitorder="little")[:, : size.samples]
    mixed = written = 0
    some: Any = flat
    every: Any = flat
    for level in reversed(range(size.levels)):
        shape = (len(words), 4**level, 4)
        some, every = some.reshape(shape).max(2), every.reshape(shape).min(2)
        mixed += int((some > every).sum())
        written += int((every == 0).sum())
    moved = 3 * REAL * size.channels * (mixed + written)
    return len(words) * size.bits + moved, max(1, 2 * BUTTERFLY * size.channels * mixed)


def product(size: Size) -> Cost:
    """A row and bits in, a row out; one transform. To mask is no operation."""
    return size.points * (2 * size.row + size.bits), size.points * size.transform


def slices(size: Size, sub: int) -> Cost:
    """A row out for each slice; the BRDF at 4**sub directions a cell, averaged, and one transform."""
    each = GGX + FRESNEL * size.channels + 2 * size.channels
    flops = size.samples * 4**sub * each + size.transform
    return size.points * size.row, size.points * flops


def inner_product(size: Size, slices: int) -> Cost:
    """A row, two indices and two weights in, radiance out, the `slices` in use once; two inner products a channel."""
    moved = size.points * (size.row + 2 * (4 + REAL) + RADIANCE) + slices * size.row
    return moved, size.points * 4 * size.channels * size.samples


def pixel_product(size: Size, environments: int) -> Cost:
    """A row over both hemispheres in, three sums an environment out, all lights once."""
    cells = 2 * size.samples
    moved = 2 * size.points * size.row + environments * 3 * REAL * (cells + size.points)
    return moved, 2 * size.points * cells * 3 * environments


def cut(size: Size, leaves: int) -> Cost:
    """Four bytes a leaf, of all points' `leaves` together, a view in and radiance out; the BRDF a leaf."""
    each = GGX + FRESNEL * size.channels + 2 * size.channels + 3
    return size.points * (2 * 4 + 2 * RADIANCE) + 4 * leaves, max(1, leaves * each)


def job(size: Size, seen: int, slices: int) -> Cost:
    """Frames, views and bits in, radiance out, slices once: nothing between need ever be stored."""
    look_ups = light_times_visibility_reduced(size, seen)[1]
    moved = size.points * (FRAME + 3 * REAL + size.bits + RADIANCE) + slices * size.row
    return moved, look_ups + inner_product(size, slices)[1]

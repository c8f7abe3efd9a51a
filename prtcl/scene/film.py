"""Sub-pixel points gathered into pixels, and the choice of pixels that need more of them."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from prtcl.factors.sequence import stratified

Array = npt.NDArray[np.float64]

FIRST = 4
"""Points that every pixel starts with: 2 × 2. Those of hard light are up to `Settings.hard_points`."""


class Film:
    """Sums of radiance by pixel; a pixel is the box average of its sub-pixel points.

    Colour is premultiplied by coverage: a point that misses the mesh counts as black and transparent.

    Parameters
    ----------
    size : width and height
    pixels : (m,) flat indices of the pixels that are exposed, or None for all of them
    first : number of a pixel's first point, a multiple of as many as it may get: films that begin at different ones
        share no point

    Attributes
    ----------
    pixels : (m,) flat index of each exposed pixel; what the methods call a pixel is its place among these
    points : (m,) how many points each has
    """

    def __init__(
        self, size: tuple[int, int], pixels: npt.NDArray[np.int64] | None = None, first: int = 0
    ) -> None:
        self.width, self.height = size
        self._whole, self.first = pixels is None, first
        self.pixels = np.arange(self.width * self.height) if pixels is None else pixels
        count = len(self.pixels)
        self.points = np.zeros(count, dtype=np.int64)
        self._sum = np.zeros((count, 3))
        self._hits = np.zeros(count)
        self._variance = np.zeros(count)

    def add(
        self,
        pixels: npt.NDArray[np.int64],
        first: int,
        last: int,
        hit: npt.NDArray[np.int64],
        radiance: npt.NDArray[np.floating],
    ) -> None:
        """Add points first … last − 1 of each of some pixels.

        Parameters
        ----------
        pixels : (k,) all with `first` points so far
        hit : (m,) which of the k (last − first) points, pixel by pixel, saw the mesh
        radiance : (m, 3) of those
        """
        each = last - first
        values = np.zeros((len(pixels) * each, 4))
        values[hit, :3], values[hit, 3] = radiance, 1.0
        by_pixel = values.reshape(len(pixels), each, 4)
        sums = by_pixel.sum(axis=1)
        self._sum[pixels] += sums[:, :3]
        self._hits[pixels] += sums[:, 3]
        self.points[pixels] += each
        self._variance[pixels] = (
            _local_variance(by_pixel[..., :3].mean(axis=2), first, last, self.first) / last
        )

    def mean(self) -> Array:
        """(pixels, 3) premultiplied radiance."""
        return np.asarray(self._sum / np.maximum(self.points, 1)[:, None])

    def coverage(self) -> Array:
        """(pixels,) the share of points that saw the mesh."""
        return np.asarray(self._hits / np.maximum(self.points, 1))

    def variance(self) -> Array:
        """(pixels,) estimated squared error of each pixel's grey mean.

        A pixel takes a quarter of the largest estimate among its neighbours if that is more, for what its own
        first points may have missed. Pixels of a film that has not all of them stand alone.
        """
        return np.maximum(self._variance, 0.25 * self.around(self._variance))

    def around(self, values: Array) -> Array:
        """(pixels,) the largest of a pixel's values and its neighbours'; its own if the film has not all pixels."""
        if not self._whole:
            return values
        grid = np.pad(values.reshape(self.height, self.width), 1)
        shifts = [grid[i : i + self.height, j : j + self.width] for i in range(3) for j in range(3)]
        return np.asarray(np.max(shifts, axis=0).ravel())

    def worst(self, allowed: float) -> npt.NDArray[np.int64]:
        """The fewest pixels, largest estimate first, whose repair leaves a sum of `variance` below `allowed`."""
        variance = self.variance()
        order = np.argsort(-variance, kind="stable")
        left = np.cumsum(variance[order][::-1])[::-1]  # what stays if the pixels before this one are repaired
        return np.sort(order[: int(np.searchsorted(-left, -allowed, side="left"))])


def _local_variance(values: Array, first: int, last: int, offset: int = 0) -> Array:
    """Variance of points (pixels, last − first) within the blocks of the pixel in which they are stratified.

    Of the first 4 n points of the (0, 2)-sequence, n = 4**k, each block of the √n × √n grid holds four, three
    of them among the later 3 n. Their variance inside the block, over 4 n, bounds the error of the stratified
    mean (each point has a quarter of the block to itself); the variance over the whole pixel would be many
    times that.
    """
    each = last - first
    blocks = last // 4
    side = math.isqrt(blocks)
    nested = last == 4 * side * side and side & (side - 1) == 0 and first in (0, blocks)
    if each < 2:
        return np.zeros(len(values))
    if not nested:
        return np.asarray(values.var(axis=1, ddof=1))
    x, y = stratified(offset + np.arange(first, last))
    order = np.argsort((y * side).astype(np.int64) * side + (x * side).astype(np.int64), kind="stable")
    return np.asarray(values[:, order].reshape(len(values), blocks, -1).var(axis=2, ddof=1).mean(axis=1))

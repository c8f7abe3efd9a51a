"""Sub-pixel points gathered into pixels, and the choice of pixels that need more of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FIRST = 4
"""Points that every pixel starts with: 2 × 2."""


class Film:
    """Sums of radiance by pixel; a pixel is the box average of its sub-pixel points.

    Colour is premultiplied by coverage: a point that misses the mesh counts as black and transparent.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.width, self.height = size
        count = self.width * self.height
        self.points = np.zeros(count, dtype=np.int64)
        self._sum = np.zeros((count, 3))
        self._hits = np.zeros(count)
        self._square = np.zeros(count)

    def add(
        self, pixel: npt.NDArray[np.int64], hit: npt.NDArray[np.int64], radiance: npt.NDArray[np.floating]
    ) -> None:
        """Add points: `pixel` (n,) of all of them, of which `hit` (m,) saw the mesh with `radiance` (m, 3)."""
        count = len(self.points)
        self.points += np.bincount(pixel, minlength=count)
        at = pixel[hit]
        self._hits += np.bincount(at, minlength=count)
        for c in range(3):
            self._sum[:, c] += np.bincount(at, radiance[:, c], count)
        grey = np.asarray(radiance, dtype=np.float64).mean(axis=1)
        self._square += np.bincount(at, grey**2, count)

    def image(self) -> npt.NDArray[np.float32]:
        """(h, w, 4) float32 premultiplied linear RGBA."""
        n = np.maximum(self.points, 1)[:, None]
        rgba = np.concatenate([self._sum, self._hits[:, None]], axis=1) / n
        return np.asarray(rgba.reshape(self.height, self.width, 4), dtype=np.float32)

    def covered(self) -> npt.NDArray[np.bool_]:
        """(pixels,) whether any point of a pixel saw the mesh."""
        return self._hits > 0

    def variance(self) -> Array:
        """(pixels,) estimated squared error of each pixel's grey mean: that of independent points.

        Points are stratified, so the true error is smaller; a pixel also takes a quarter of the largest
        estimate among its neighbours, for what its own first points may have missed.
        """
        n = np.maximum(self.points, 1)
        mean = self._sum.mean(axis=1) / n
        own = np.maximum(self._square / n - mean**2, 0.0) / np.maximum(n - 1, 1)
        grid = np.pad(own.reshape(self.height, self.width), 1)
        around = np.max(
            [grid[i : i + self.height, j : j + self.width] for i in range(3) for j in range(3)], axis=0
        )
        return np.maximum(own, 0.25 * around.ravel())

    def error(self) -> float:
        """Estimated relative RMSE over the covered pixels of having finitely many points."""
        covered = self.covered()
        if not covered.any():
            return 0.0
        mean = (self._sum.mean(axis=1) / np.maximum(self.points, 1))[covered].mean()
        return float(np.sqrt(self.variance()[covered].mean()) / mean) if mean > 0 else 0.0

    def worst(self, target: float) -> npt.NDArray[np.int64]:
        """The fewest pixels, largest estimated error first, whose repair brings `error` to `target`."""
        covered = self.covered()
        if not covered.any():
            return np.zeros(0, dtype=np.int64)
        mean = (self._sum.mean(axis=1) / np.maximum(self.points, 1))[covered].mean()
        variance = self.variance()
        order = np.argsort(-variance, kind="stable")
        left = np.cumsum(variance[order][::-1])[::-1]  # what stays if the pixels before this one are repaired
        needed = int(np.searchsorted(-left, -((target * mean) ** 2 * covered.sum()), side="left"))
        return np.sort(order[:needed])

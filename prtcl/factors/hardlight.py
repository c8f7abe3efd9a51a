"""Hard light: the peaks of an environment as a few exact directions."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_SAMPLES = 512
REFINE = 4
"""Subtexels along each side of a bright texel: a sun of two texels still has a round penumbra."""
SPREAD = 0.005
"""Clusters are split until their share of the map's hard energy times their extent in degrees is below this:
a sun of 60 % of the energy and one degree becomes some 25 samples, a small distant lamp stays one."""


@dataclass(frozen=True, eq=False)
class Subtexels:
    """Points of a map on a grid finer than its texels: directions (n, 3), radiance (n, 3), sr (n,)."""

    directions: Array
    radiance: Array
    solid_angles: Array


def candidates(image: Array, threshold: float) -> npt.NDArray[np.bool_]:
    """(h, w) texels at which the bilinear surface may exceed `threshold`: themselves or a neighbour do."""
    over = image.mean(axis=2) > threshold
    if not over.any():
        return over
    wide = over | np.roll(over, 1, axis=1) | np.roll(over, -1, axis=1)
    out = wide.copy()
    out[1:] |= wide[:-1]
    out[:-1] |= wide[1:]
    return out


def subtexel_bands(image: Array, mask: npt.NDArray[np.bool_], refine: int) -> Iterator[Subtexels]:
    """`subtexels` of the texels of `mask` in bands of about a million, so that an 8k map needs no gigabytes."""
    rows, columns = np.nonzero(mask)
    step = max(1, (1 << 20) // refine**2)
    for start in range(0, len(rows), step):
        yield subtexels(image, rows[start : start + step], columns[start : start + step], refine)


def subtexels(
    image: Array, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64], refine: int
) -> Subtexels:
    """Texels (rows[i], columns[i]), each as refine × refine points of the bilinearly interpolated map.

    Solid angles are exact for every subtexel, so they sum to those of the texels.
    """
    height, width = image.shape[:2]
    steps = (np.arange(refine) + 0.5) / refine
    y = (rows[:, None, None] + steps[None, :, None] + np.zeros((1, 1, refine))).reshape(-1)
    x = (columns[:, None, None] + steps[None, None, :] + np.zeros((1, refine, 1))).reshape(-1)
    half = 0.5 / refine
    solid = (np.cos(np.pi * (y - half) / height) - np.cos(np.pi * (y + half) / height)) * (
        2 * np.pi / (width * refine)
    )
    theta, phi = np.pi * y / height, 2 * np.pi * x / width
    directions = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=1)
    # Bilinear between texel centres, columns wrapping, rows clamped at the poles.
    fx, fy = x - 0.5, np.clip(y - 0.5, 0.0, height - 1.0)
    x0, y0 = np.floor(fx).astype(np.int64), np.floor(fy).astype(np.int64)
    wx, wy = (fx - x0)[:, None], (fy - y0)[:, None]
    left, right, y1 = x0 % width, (x0 + 1) % width, np.minimum(y0 + 1, height - 1)
    top = image[y0, left] * (1 - wx) + image[y0, right] * wx
    bottom = image[y1, left] * (1 - wx) + image[y1, right] * wx
    return Subtexels(directions, top * (1 - wy) + bottom * wy, solid)


def clip(radiance: Array, threshold: float) -> tuple[Array, Array]:
    """Soft and hard part of radiance (n, 3): what lies below the threshold keeps its colour, the rest is hard."""
    level = radiance.mean(axis=1, keepdims=True)
    kept = np.minimum(1.0, threshold / np.maximum(level, 1e-300))
    return radiance * kept, radiance * (1.0 - kept)


def cluster(directions: Array, energy: Array, max_samples: int, spread: float = SPREAD) -> Array:
    """Median-cut clusters of energetic directions, each a direction and the energy of all its members.

    The cluster with the largest energy × extent is split at the energy median of its longest axis, until that
    product is below `spread` of the whole or `max_samples` is reached.

    Parameters
    ----------
    directions : (n, 3) unit
    energy : (n, 3) radiance times solid angle, RGB

    Returns
    -------
    samples : (k, 6): direction; energy. Energy is kept exactly (to float64 rounding).
    """
    weight = energy.mean(axis=1)
    members = np.nonzero(weight > 0.0)[0]
    if not members.size or max_samples < 1:
        return np.zeros((0, 6))
    total = weight[members].sum()

    def entry(index: npt.NDArray[np.int64], order: int) -> tuple[float, int, npt.NDArray[np.int64], int]:
        w = weight[index] / weight[index].sum()
        away = directions[index] - w @ directions[index]
        variance = w @ away**2
        extent = np.degrees(2.0 * np.sqrt(variance.sum()))
        priority = float(weight[index].sum() / total * extent) if index.size > 1 else 0.0
        return -priority, order, index, int(np.argmax(variance))

    heap = [entry(members, 0)]
    made = 1
    while len(heap) < max_samples and -heap[0][0] > spread:
        _, _, index, axis = heapq.heappop(heap)
        index = index[np.argsort(directions[index, axis], kind="stable")]
        running = np.cumsum(weight[index])
        cut = int(np.clip(np.searchsorted(running, running[-1] / 2) + 1, 1, index.size - 1))
        for half in (index[:cut], index[cut:]):
            heapq.heappush(heap, entry(half, made))
            made += 1
    samples = np.zeros((len(heap), 6))
    for row, (_, _, index, _) in enumerate(sorted(heap, key=lambda e: e[1])):
        centre = weight[index] @ directions[index]
        samples[row, :3] = centre / np.linalg.norm(centre)
        samples[row, 3:] = energy[index].sum(axis=0)
    return samples

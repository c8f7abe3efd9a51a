"""Packed parent sums: the mean of a product over every square of the quadtree, four bytes a square."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from prtcl import quadtree
from prtcl.compute.device import Device

GROUP = 64
DEPTH = 3
TOP_EXPONENT = 15
"""Values are scaled to at most 2^15, half of the format's largest."""
ROUNDING = 2.0**-8
"""A step of the largest channel relative to it, at most: stored means are right to half of this, other channels to the
same step."""


def row_bytes(levels: int) -> int:
    """Bytes of one point's packed sums, levels 0 … `levels`."""
    return 4 * quadtree.n_squares(levels + 1)


def scale_for(largest: float) -> float:
    """The power of two that brings values of at most `largest` below 2^15 (1 where all is dark), itself in float32."""
    return 2.0 ** min(126, TOP_EXPONENT - math.ceil(math.log2(largest))) if largest > 0.0 else 1.0


def pack(device: Device, samples: Any, rows: Any, sums: Any, scale: float) -> None:
    """Means of samples over all squares, packed into some rows of `sums`.

    Parameters
    ----------
    samples : device array (n, channels, 4**levels), Morton order, 0 or more
    rows : device array (n,) int32, where each point's sums go
    sums : device array (any, n_squares(levels + 1)) uint32, written
    scale : as `scale_for` gives it; the stored means are this much larger
    """
    count, channels, size = samples.shape
    levels = quadtree.levels_of(size)
    bottom, values = levels, samples
    while bottom > 0:
        top = max(0, bottom - DEPTH)
        means = device.empty((count, channels, quadtree.n_samples(top)))
        kernel = device.kernels(
            "pyramid.cl", LEVELS=levels, DEPTH=bottom - top, CHANNELS=channels, GROUP=GROUP
        )["pack_means"]
        device.launch(
            kernel, quadtree.n_samples(top), GROUP, values, means, rows, sums, top, float(scale), y=count
        )
        bottom, values = top, means


def unpack(packed: Any, scale: float = 1.0) -> Any:
    """Packed sums (NumPy, uint32) as (..., 3) float32, for checking and for people."""
    word = np.asarray(packed, dtype=np.uint32)
    step = np.ldexp(1.0, (word >> 27).astype(np.int32) - 24)
    mantissas = np.stack([word & 511, (word >> 9) & 511, (word >> 18) & 511], axis=-1)
    return (mantissas * step[..., None] / scale).astype(np.float32)

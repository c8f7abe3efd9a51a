"""The 2D Haar transform of many hemispheres at once, on the device."""

from __future__ import annotations

from typing import Any

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.errors import InputError

GROUP = 64
STAGE = 3
"""Levels one launch takes: 64 values a work-item, which is what registers hold."""


def stages(levels: int) -> list[tuple[int, int]]:
    """(top level, depth) of the launches that cover `levels` levels, from fine to coarse."""
    out = []
    bottom = levels
    while bottom > 0:
        depth = min(STAGE, bottom)
        out.append((bottom - depth, depth))
        bottom -= depth
    return out


def check_rows(array: Any, name: str) -> tuple[int, int]:
    """Rows and levels of an array (..., 4**levels).

    Raises
    ------
    InputError
        If the last axis is not 4**levels with 1 ≤ levels ≤ 9.
    """
    try:
        levels = quadtree.levels_of(array.shape[-1])
    except (ValueError, IndexError):
        levels = 0
    if not 1 <= levels <= quadtree.MAX_LEVELS:
        raise InputError(
            f"{name}: expected shape (..., 4**levels) with 1 to {quadtree.MAX_LEVELS} levels, "
            f"got {tuple(array.shape)}"
        )
    return int(array.size // array.shape[-1]), levels


def forward(device: Device, samples: Any, *, out: Any = None, scale: float = 1.0) -> Any:
    """Haar coefficients of device rows of Morton-ordered samples, times `scale` (a power of two is exact).

    Parameters
    ----------
    samples : device array (..., 4**levels)
    out : device array of the same shape, or None for a new one; may not be `samples`

    Returns
    -------
    coefficients : device array (..., 4**levels), by level (`prtcl.quadtree`)
    """
    _, levels = check_rows(samples, "samples")
    out = device.empty(samples.shape) if out is None else out
    return forward_from_means(device, samples, levels, out, scale)


def forward_from_means(device: Device, means: Any, bottom: int, out: Any, scale: float = 1.0) -> Any:
    """The levels below `bottom` of `out` (..., 4**levels), from rows of 4**bottom means."""
    n_rows = means.size >> (2 * bottom)
    width = 1 << (2 * bottom)
    stride = out.shape[-1]
    for top, depth in stages(bottom):
        kernel = device.kernels("haar.cl", DEPTH=depth, GROUP=GROUP)["haar_forward"]
        coarser = device.empty((max(1, n_rows << (2 * top)),))
        device.launch(
            kernel, n_rows << (2 * top), GROUP, means, width, out, stride, coarser, n_rows, top,
            scale,
        )  # fmt: skip
        means, width, scale = coarser, 1 << (2 * top), 1.0
    return out


def inverse(device: Device, coefficients: Any, *, out: Any = None) -> Any:
    """Morton-ordered samples of device rows of Haar coefficients; shapes as for `forward`."""
    n_rows, levels = check_rows(coefficients, "coefficients")
    out = device.empty(coefficients.shape) if out is None else out
    stride = coefficients.shape[-1]
    means = coefficients  # not read where top is 0
    for top, depth in reversed(stages(levels)):
        kernel = device.kernels("haar.cl", DEPTH=depth, GROUP=GROUP)["haar_inverse"]
        bottom = top + depth
        values = out if bottom == levels else device.empty((n_rows << (2 * bottom),))
        device.launch(kernel, n_rows << (2 * top), GROUP, coefficients, stride, means, values, n_rows, top)
        means = values
    return out

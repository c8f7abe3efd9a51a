"""The 2D Haar transform of many hemispheres at once, on the device."""

from __future__ import annotations

from typing import Any

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form, Tunable
from prtcl.errors import InputError

GROUP = 64
STAGE = 3
"""Levels one launch of "items" takes: 64 values a work-item, which is what registers hold."""
WIDE_STAGE = 6
"""Levels one launch of "wide" takes: 4096 values a work-item, which is what a first-level cache holds."""
TRANSFORM = Tunable(
    "haar",
    (Form("items"), Form("wide", 1), Form("wide", 8), Form("wide", 32)),
    cpu=Form("wide", 8),
    gpu=Form("items"),
)
"""Work-items of 4 … 64 values (haar.cl), or vectors along a row and `size` squares a work-item (haar_wide.cl)."""


def stages(levels: int, most: int = STAGE) -> list[tuple[int, int]]:
    """(top level, depth) of the launches that cover `levels` levels, at most `most` each, from fine to coarse."""
    out = []
    bottom = levels
    while bottom > 0:
        depth = min(most, bottom)
        if most == WIDE_STAGE and bottom - depth == 1:
            depth -= 1  # vectors of 16 take two levels at least
        out.append((bottom - depth, depth))
        bottom -= depth
    return out


def _launches(device: Device, levels: int, way: str) -> list[tuple[int, int, Any, int, int]]:
    """(top level, depth, kernel, squares a work-item, group) of each launch, from fine to coarse."""
    form = TRANSFORM.of(device)
    out = []
    for top, depth in stages(levels, WIDE_STAGE if form.name == "wide" else STAGE):
        if form.name == "wide" and depth > 1:
            kernels = device.kernels("haar_wide.cl", DEPTH=depth, RUNS=form.size)
            out.append((top, depth, kernels[f"haar_{way}_wide"], form.size, 1))
        else:
            kernels = device.kernels("haar.cl", DEPTH=depth, GROUP=GROUP)
            out.append((top, depth, kernels[f"haar_{way}"], 1, GROUP))
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
    for top, _, kernel, runs, group in _launches(device, bottom, "forward"):
        coarser = device.empty((max(1, n_rows << (2 * top)),))
        device.launch(
            kernel, -(-(n_rows << (2 * top)) // runs), group, means, width, out, stride, coarser, n_rows, top,
            float(scale), stage="haar_forward",
        )  # fmt: skip
        means, width, scale = coarser, 1 << (2 * top), 1.0
    return out


def inverse(device: Device, coefficients: Any, *, out: Any = None) -> Any:
    """Morton-ordered samples of device rows of Haar coefficients; shapes as for `forward`."""
    n_rows, levels = check_rows(coefficients, "coefficients")
    out = device.empty(coefficients.shape) if out is None else out
    stride = coefficients.shape[-1]
    means = coefficients  # not read where top is 0
    for top, depth, kernel, runs, group in reversed(_launches(device, levels, "inverse")):
        bottom = top + depth
        values = out if bottom == levels else device.empty((n_rows << (2 * bottom),))
        device.launch(
            kernel, -(-(n_rows << (2 * top)) // runs), group, coefficients, stride, means, values, n_rows, top,
            stage="haar_inverse",
        )  # fmt: skip
        means = values
    return out

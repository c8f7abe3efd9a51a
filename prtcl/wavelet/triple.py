"""Reduced coefficients a ⊕ b of coefficient rows, through the quadtree, on the device."""

from __future__ import annotations

from typing import Any

import numpy as np

from prtcl import quadtree
from prtcl.compute.device import PRECISIONS, Device
from prtcl.compute.tuning import Form, Tunable
from prtcl.errors import InputError
from prtcl.wavelet.haar import GROUP, check_rows

REDUCTION = Tunable("reduce", (Form("tree"), Form("wide")), cpu=Form("wide"), gpu=Form("tree"))
"""The tree a level a launch (triple.cl), or all of it in one pass over vectors (reduce_wide.cl)."""


def wide_fits(levels: int) -> bool:
    """Whether the kernels on vectors of sixteen take these levels: rows that vectors fill and private memory holds."""
    return 3 <= levels <= 7


def in_one_pass(device: Device, levels: int) -> bool:
    """Whether `reduce` keeps nothing but its result on the device."""
    return REDUCTION.of(device).name == "wide" and wide_fits(levels)


def accumulator_dtype(device: Device) -> Any:
    """NumPy dtype of the sums that `device`'s precision works in."""
    return np.float64 if PRECISIONS[device.precision][1] == "double" else np.float32


def parent_sums(device: Device, coefficients: Any, *, channels: int = 1, channels_b: int = 1) -> Any:
    """psum(a; r, s), the mean of `a` over every square of levels 0 … levels − 1.

    Returns
    -------
    means : device array (rows, (4**levels − 1) / 3), coarse to fine, in the precision of the sums
    """
    n_rows, levels = check_rows(coefficients, "coefficients")
    kernel = _kernels(device, levels, channels, channels_b)["parent_sums"]
    sums = device.empty((n_rows, quadtree.n_squares(levels)), accumulator_dtype(device))
    for level in range(max(1, levels - 1)):
        device.launch(kernel, quadtree.n_samples(level), GROUP, coefficients, sums, level, y=n_rows)
    return sums


def reduce(device: Device, a: Any, b: Any, *, keep: int | None = None, out: Any = None) -> Any:
    """a ⊕ b: the Haar coefficients of the product of two functions given by theirs.

    Parameters
    ----------
    a : device array (points, channels, 4**levels)
    b : device array (points, channels or 1, 4**levels); one row serves all channels
    keep : levels of the product to keep, 1 … levels; None keeps all. What is kept is exact: the finer levels
        of both factors still enter it (multiply fine, keep coarse).
    out : device array (points, channels, 4**keep) or None

    Returns
    -------
    reduced : device array (points, channels, 4**keep)

    Raises
    ------
    InputError
        If shapes do not fit together.

    Notes
    -----
    The equation and its source stand in kernels/triple.cl; kernels/reduce_wide.cl takes a square's sums as the product
    that they are, which rounds less where the brightest light is hidden. The kernel's G_j carries 2^(r−R) where the
    supplemental prints 2^(r−r'); `prtcl.reference.triple_tree` evaluates both.
    """
    _, levels = check_rows(a, "a")
    _, levels_b = check_rows(b, "b")
    keep = levels if keep is None else keep
    if len(a.shape) != 3 or len(b.shape) != 3 or levels != levels_b or a.shape[0] != b.shape[0]:
        raise InputError(
            "triple: expected a (points, channels, 4**levels) and b of the same points and levels, "
            f"got {tuple(a.shape)} and {tuple(b.shape)}"
        )
    points, channels, _ = a.shape
    if b.shape[1] not in (1, channels):
        raise InputError(f"b: expected 1 or {channels} channels as a has, got {b.shape[1]}")
    if not 1 <= keep <= levels:
        raise InputError(f"keep: expected 1 to {levels} levels, got {keep}")
    out = device.empty((points, channels, quadtree.n_samples(keep))) if out is None else out
    if in_one_pass(device, levels):
        wide = device.kernels(
            "reduce_wide.cl", LEVELS=levels, BITS=levels, KEEP=keep, CHANNELS=channels, CHANNELS_B=b.shape[1]
        )["reduce_pair"]
        device.launch(wide, points, 1, a, b, out, points)
        return out
    kernels = _kernels(device, levels, channels, b.shape[1])
    sums_a = parent_sums(device, a, channels=channels, channels_b=b.shape[1])
    sums_b = parent_sums(device, b, channels=channels, channels_b=b.shape[1])
    energy = device.empty(sums_a.shape, sums_a.dtype)
    for level in reversed(range(levels)):
        device.launch(
            kernels["triple_accumulate"], quadtree.n_samples(level), GROUP,
            a, b, sums_a, sums_b, energy, out, level, keep, y=points * channels,
        )  # fmt: skip
    return out


def _kernels(device: Device, levels: int, channels: int, channels_b: int) -> dict[str, Any]:
    return device.kernels("triple.cl", LEVELS=levels, CHANNELS=channels, CHANNELS_B=channels_b, GROUP=GROUP)

"""Reduced coefficients and hard light to radiance."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form, Tunable
from prtcl.factors.environment import Light
from prtcl.factors.slices import Materials

GROUP = 64
INNER = Tunable(
    "inner_product",
    (
        Form("lanes", 4),
        Form("lanes", 16),
        Form("lanes", 64),
        Form("wide", 1),
        Form("wide", 8),
        Form("wide", 64),
    ),
    cpu=Form("wide", 8),
    gpu=Form("lanes", 64),
)
"""`size` work-items a point (shade.cl), or vectors along a point's coefficients, `size` points a work-item
(shade_wide.cl)."""
LANES = Form("lanes", 4)
"""Where a row is shorter than a vector."""


def soft_radiance(
    device: Device,
    reduced: Any,
    slices: Any,
    index: Any,
    weight: Any,
    levels: int,
    *,
    out: Any = None,
) -> Any:
    """I_p = Σ_j (L ⊕ V)_j f_v,j, equation (5), with f_v interpolated between stored slices.

    Parameters
    ----------
    reduced : device array (n, channels, 4**keep)
    slices : device array (m, slice_channels, 4**keep)
    index, weight : (n, k) int32 and real: the slices of each point and their weights
    levels : of the product: its samples subtend 2π/4**levels sr
    out : device array (n, 4) that is added to, or None for a new one

    Returns
    -------
    radiance : device array (n, 4): RGB and 0
    """
    count, channels, kept = reduced.shape
    keep = quadtree.levels_of(kept)
    where, weights = device.array(index, np.int32), device.array(weight)
    # Coefficients of the product are those of 4**levels samples, those of f_v of 4**keep: on the finer grid
    # f_v's would be 2**(levels − keep) larger.
    scale = 2 * np.pi / 4.0**levels * 2.0 ** (levels - keep)
    add = out is not None
    out = device.empty((count, 4)) if out is None else out
    form = INNER.of(device)
    form = LANES if form.name == "wide" and keep < 2 else form
    defines = {
        "KEEP": keep,
        "CHANNELS": channels,
        "SLICE_CHANNELS": slices.shape[1],
        "N_SLICES": where.shape[1],
    }
    arguments = [reduced, slices, where, weights, out, float(scale), int(add)]
    if form.name == "wide":
        kernel = device.kernels("shade_wide.cl", POINTS=form.size, **defines)["inner_product_wide"]
        device.launch(kernel, -(-count // form.size), 1, *arguments, count, stage="inner_product")
    else:
        kernel = device.kernels("shade.cl", GROUP=form.size, **defines)["inner_product"]
        device.launch(kernel, form.size, form.size, *arguments, y=count)
    return out


def add_hard_radiance(
    device: Device,
    materials: Materials,
    light: Light,
    bits: Any,
    material: npt.NDArray[np.int32],
    frames: npt.NDArray[np.float32],
    views: npt.NDArray[np.floating],
    out: Any,
) -> Any:
    """Add Σ_l V(ω_l) f(ω_l, v) max(n·ω_l, 0) E_l to `out` (n, 4), with the exact BRDF.

    Parameters
    ----------
    bits : (n, words) uint32, which hard samples each point sees
    material : (n,) int32
    frames : (n, 3, 3) world frames; views : (n, 3) local outgoing directions
    """
    count = len(frames)
    if not len(light.hard) or not count:
        return out
    outgoing = np.zeros((count, 4))
    outgoing[:, :3] = views
    _, hard = light.buffers(device)
    kernel = device.kernels("lights.cl", KINDS=materials.mask, GROUP=GROUP)["shade_lights"]
    device.launch(
        kernel, count, GROUP, *materials.arguments, device.array(material, np.int32), hard, len(light.hard),
        device.array(bits, np.uint32), device.array(frames), device.array(outgoing), out, count,
    )  # fmt: skip
    return out

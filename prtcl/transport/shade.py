"""Reduced coefficients and hard light to radiance."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.factors.environment import Light
from prtcl.factors.slices import Materials

GROUP = 64
LANES_CPU, LANES_GPU = 4, 64
"""Work-items a point for the inner product. A CPU's vectors are short and its barriers are loops: four lanes ran 1.4
to 1.8 times as fast as 64 on PoCL (bench/reduce.py shows both)."""


def soft_radiance(
    device: Device,
    reduced: Any,
    slices: Any,
    index: Any,
    weight: Any,
    levels: int,
    *,
    out: Any = None,
    lanes: int | None = None,
) -> Any:
    """I_p = Σ_j (L ⊕ V)_j f_v,j, equation (5), with f_v interpolated between stored slices.

    Parameters
    ----------
    reduced : device array (n, channels, 4**keep)
    slices : device array (m, slice_channels, 4**keep)
    index, weight : (n, k) int32 and real: the slices of each point and their weights
    levels : of the product: its samples subtend 2π/4**levels sr
    out : device array (n, 4) that is added to, or None for a new one
    lanes : work-items a point, a power of two; None takes what suits the device

    Returns
    -------
    radiance : device array (n, 4): RGB and 0
    """
    count, channels, kept = reduced.shape
    keep = quadtree.levels_of(kept)
    where, weights = device.array(index, np.int32), device.array(weight)
    lanes = lanes or (LANES_CPU if device.is_cpu else LANES_GPU)
    kernel = device.kernels(
        "shade.cl", KEEP=keep, CHANNELS=channels, SLICE_CHANNELS=slices.shape[1], N_SLICES=where.shape[1],
        GROUP=lanes,
    )["inner_product"]  # fmt: skip
    # Coefficients of the product are those of 4**levels samples, those of f_v of 4**keep: on the finer grid
    # f_v's would be 2**(levels − keep) larger.
    scale = 2 * np.pi / 4.0**levels * 2.0 ** (levels - keep)
    add = out is not None
    out = device.empty((count, 4)) if out is None else out
    device.launch(kernel, lanes, lanes, reduced, slices, where, weights, out, float(scale), int(add), y=count)
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

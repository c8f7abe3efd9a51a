"""Light and visibility of each point collapsed once into reduced coefficients, L ⊕ V."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form, Tunable
from prtcl.factors import environment, hemisphere
from prtcl.factors.environment import Light
from prtcl.factors.visibility import sees_all
from prtcl.transport.settings import Settings
from prtcl.wavelet import haar, masked, pyramid, triple

GROUP = 64
PRODUCT = Tunable("product", (Form("stages"), Form("wide")), cpu=Form("wide"), gpu=Form("stages"))
"""Products stored and then transformed or packed (product.cl), or all in one pass over vectors (product_wide.cl)."""


def reduced_coefficients(
    device: Device,
    light: Light,
    bits: Any,
    frames: npt.NDArray[np.float32],
    settings: Settings,
    channels: int = 3,
    grid: npt.NDArray[np.int32] | None = None,
) -> Any:
    """L ⊕ V of every point: device array (n, channels, 4**keep), the levels below `settings.keep`.

    Hard samples are not in it: `prtcl.transport.shade` adds them with the exact BRDF.

    Parameters
    ----------
    bits : (n, words) uint32 visibility of 4**settings.rays directions
    frames : (n, 3, 3) float32
    grid : (n,) the visibility grid of each point, whose rays' cosines the pixel-domain product weighs
        (`hemisphere.ray_weights`; the tree takes the bits as they are); None is `hemisphere.ALONE` for all
    """
    levels, keep = settings.levels, settings.keep
    if settings.tree:
        soft = environment.gather(device, light, frames, channels=channels)
        coefficients = haar.forward(device, soft)
        seen = masked.visibility_coefficients(device, bits, settings.rays, levels)
        return triple.reduce(device, coefficients, seen, keep=keep)
    if _wide(device, settings):
        kernels, arguments = _fused(device, light, bits, frames, settings, channels, grid)
        reduced = device.empty((len(frames), channels, quadtree.n_samples(keep)))
        device.launch(
            kernels["light_times_visibility_reduced"], len(frames), 1, *arguments, reduced,
            stage="light_times_visibility",
        )  # fmt: skip
        return reduced
    product = product_samples(device, light, bits, frames, settings, channels, grid)
    return haar.forward(device, product, scale=2.0 ** (levels - keep))


def packed_sums(
    device: Device,
    light: Light,
    bits: Any,
    frames: npt.NDArray[np.float32],
    settings: Settings,
    channels: int,
    rows: Any,
    sums: Any,
    scale: float,
) -> None:
    """Parent sums of L ⊕ V at all levels of `settings.levels`, which is `settings.keep`, packed into rows of `sums`.

    Parameters
    ----------
    rows : device array (n,) int32, where each point's sums go
    sums, scale : as for `prtcl.wavelet.pyramid.pack`
    others : those of `reduced_coefficients`; visibility counts as it is, without the rays' weights
    """
    if _wide(device, settings):
        kernels, arguments = _fused(device, light, bits, frames, settings, channels, None)
        device.launch(
            kernels["light_times_visibility_packed"], len(frames), 1, *arguments, rows, sums, float(scale),
            stage="light_times_visibility",
        )  # fmt: skip
        return
    product = product_samples(device, light, bits, frames, settings, channels)
    pyramid.pack(device, product, rows, sums, scale)


def _wide(device: Device, settings: Settings) -> bool:
    return PRODUCT.of(device).name == "wide" and triple.wide_fits(settings.levels) and environment.SUB == 0


def _fused(
    device: Device, light: Light, bits: Any, frames: npt.NDArray[np.float32], settings: Settings, channels: int,
    grid: npt.NDArray[np.int32] | None,
) -> tuple[dict[str, Any], list[Any]]:  # fmt: skip
    """Kernels of product_wide.cl, and the arguments that they share."""
    kernels = device.kernels(
        "product_wide.cl", LEVELS=settings.levels, BITS=settings.rays, KEEP=settings.keep, CHANNELS=channels
    )
    directions = environment.direction_planes(device, settings.levels)
    return kernels, _product_arguments(device, light, bits, frames, settings, grid, directions)


def _product_arguments(
    device: Device, light: Light, bits: Any, frames: npt.NDArray[np.float32], settings: Settings,
    grid: npt.NDArray[np.int32] | None, directions: Any,
) -> list[Any]:  # fmt: skip
    """What every form of the product takes first."""
    cube, _ = light.buffers(device)
    grid = np.full(len(frames), hemisphere.ALONE) if grid is None else grid
    weights, row = _ray_weights(bits, settings.rays, grid, settings.leaves("unshadowed"))
    return [
        cube, cube.shape[1] - 2, directions, environment.frames_on_map(device, light, frames),
        device.array(bits, np.uint32, name="bits"), device.array(weights), device.array(row, np.int32),
    ]  # fmt: skip


def product_samples(
    device: Device,
    light: Light,
    bits: Any,
    frames: npt.NDArray[np.float32],
    settings: Settings,
    channels: int = 3,
    grid: npt.NDArray[np.int32] | None = None,
) -> Any:
    """L V itself, averaged over the cells of 4**keep directions: device array (n, channels, 4**keep).

    Parameters are those of `reduced_coefficients`, which transforms this.
    """
    levels, keep, count = settings.levels, settings.keep, len(frames)
    product = device.empty((count, channels, quadtree.n_samples(keep)))
    kernel = device.kernels(
        "product.cl", LEVELS=levels, BITS=settings.rays, KEEP=keep, CHANNELS=channels,
        SUB=environment.SUB, GROUP=GROUP,
    )["light_times_visibility"]  # fmt: skip
    arguments = _product_arguments(
        device, light, bits, frames, settings, grid, environment.look_up_directions(device, levels)
    )
    device.launch(kernel, quadtree.n_samples(keep), GROUP, *arguments, product, y=count)
    return product


def _ray_weights(
    bits: npt.NDArray[np.uint32], rays: int, grid: npt.NDArray[np.int32], leave_out: bool = True
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.intp]]:
    """Rows of `hemisphere.ray_weights` and each point's row.

    A point that sees its whole hemisphere needs none: weights would only add noise. (It is all of a point or nothing:
    weighing only the cells beside a hidden one errs more than no weights at all, for which those are depends on
    where the rays went.)
    """
    some_hidden = grid != hemisphere.ALONE
    if leave_out and some_hidden.any():
        some_hidden &= ~sees_all(bits, rays)
    grids, row = np.unique(np.where(some_hidden, grid, hemisphere.ALONE), return_inverse=True)
    return np.stack([hemisphere.ray_weights(rays, int(g)) for g in grids]), row


def bytes_per_point(device: Device, settings: Settings, channels: int) -> dict[str, int]:
    """Bytes that each stage keeps on the device for one point."""
    real = np.dtype(device.dtype).itemsize
    samples, kept = quadtree.n_samples(settings.levels), quadtree.n_samples(settings.keep)
    squares = quadtree.n_squares(settings.levels)
    stages = {
        "visibility_bits": 4 * quadtree.visibility_words(settings.rays),
        "reduced_coefficients": channels * kept * real,
    }
    if settings.tree:
        stages["light_samples"] = channels * samples * real
        stages["light_coefficients"] = channels * samples * real
        stages["visibility_coefficients"] = samples * real
        if not triple.in_one_pass(device, settings.levels):
            stages["parent_sums_and_energy"] = (2 * channels + 1) * squares * 8
    elif not _wide(device, settings):
        stages["product_samples"] = channels * kept * real
    return stages

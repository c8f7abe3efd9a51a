"""Light and visibility of each point collapsed once into reduced coefficients, L ⊕ V."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.factors import environment, hemisphere
from prtcl.factors.environment import Light
from prtcl.transport.settings import Settings
from prtcl.wavelet import haar, triple

GROUP = 64


def visibility_coefficients(device: Device, bits: Any, rays: int, levels: int | None = None) -> Any:
    """Haar coefficients of visibility, exact integer sums by popcount.

    Parameters
    ----------
    bits : (n, words) uint32, host or device, of 4**rays directions
    levels : of the coefficients, at least `rays` (the default)

    Returns
    -------
    coefficients : device array (n, 1, 4**levels)
    """
    levels = rays if levels is None else levels
    words = device.array(bits, np.uint32, name="bits")
    count = words.shape[0]
    top = max(0, rays - 3)
    out = device.empty((count, 1, quadtree.n_samples(levels)))
    means = device.empty((max(1, count << (2 * top)),))
    kernel = device.kernels("visibility.cl", LEVELS=levels, BITS=rays, GROUP=GROUP)["visibility_coefficients"]
    device.launch(kernel, count << (2 * top), GROUP, words, out, means, count)
    if top:
        haar.forward_from_means(device, means, top, out)
    return out


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
        seen = visibility_coefficients(device, bits, settings.rays, levels)
        return triple.reduce(device, coefficients, seen, keep=keep)
    product = product_samples(device, light, bits, frames, settings, channels, grid)
    return haar.forward(device, product, scale=2.0 ** (levels - keep))


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
    cube, _ = light.buffers(device)
    weights, row = _ray_weights(
        bits, settings.rays, np.full(count, hemisphere.ALONE) if grid is None else grid
    )
    device.launch(
        kernel, quadtree.n_samples(keep), GROUP, cube, cube.shape[1] - 2,
        environment.look_up_directions(device, levels), environment.frames_on_map(device, light, frames),
        device.array(bits, np.uint32, name="bits"), device.array(weights), device.array(row, np.int32), product,
        y=count,
    )  # fmt: skip
    return product


def _ray_weights(
    bits: npt.NDArray[np.uint32], rays: int, grid: npt.NDArray[np.int32]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.intp]]:
    """Rows of `hemisphere.ray_weights` and each point's row.

    A point that sees its whole hemisphere needs none: weights would only add noise. (It is all of a point or nothing:
    weighing only the cells beside a hidden one errs more than no weights at all, for which those are depends on
    where the rays went.)
    """
    seen = np.uint32(0xFFFFFFFF >> max(0, 32 - 4**rays))
    some_hidden = grid != hemisphere.ALONE
    if some_hidden.any():
        some_hidden &= ~(bits == seen).all(axis=1)
    grids, row = np.unique(np.where(some_hidden, grid, hemisphere.ALONE), return_inverse=True)
    return np.stack([hemisphere.ray_weights(rays, int(g)) for g in grids]), row


def product_of(device: Device, light: Any, bits: Any, rays: int, keep: int) -> Any:
    """L ⊕ V from light samples that are already on the device, in the pixel domain.

    Parameters
    ----------
    light : device array (n, channels, 4**levels) of radiance, Morton order
    bits : (n, words) uint32 visibility of 4**rays directions
    keep : levels of the product to keep

    Returns
    -------
    reduced : device array (n, channels, 4**keep) of Haar coefficients
    """
    count, channels, samples = light.shape
    levels = quadtree.levels_of(samples)
    kernel = device.kernels(
        "product.cl", LEVELS=levels, BITS=rays, KEEP=keep, CHANNELS=channels, GROUP=GROUP
    )["masked_average"]
    product = device.empty((count, channels, quadtree.n_samples(keep)))
    words = device.array(bits, np.uint32, name="bits")
    device.launch(kernel, quadtree.n_samples(keep), GROUP, light, words, product, y=count * channels)
    return haar.forward(device, product, scale=2.0 ** (levels - keep))


def bytes_per_point(settings: Settings, channels: int, real: int) -> dict[str, int]:
    """Bytes that each stage keeps on the device for one point.

    Parameters
    ----------
    real : bytes of a stored number
    """
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
        stages["parent_sums_and_energy"] = (2 * channels + 1) * squares * 8
    else:
        stages["product_samples"] = channels * kept * real
    return stages

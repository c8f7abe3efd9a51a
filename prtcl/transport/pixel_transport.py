"""Transport of pixels as rows of a matrix, V ⊕ f_v, and its product with many environments at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form, Tunable
from prtcl.factors import sphere
from prtcl.factors.slices import Materials

GROUP = 64
PANEL = 16
"""Environments a panel of the lights: a vector of a CPU. A batch is filled up with black ones."""
PRODUCT = Tunable(
    "pixel_product",
    (Form("rows", 4), Form("rows", 8), Form("wide", 4), Form("wide", 8), Form("wide", 12)),
    cpu=Form("wide", 8),
    gpu=Form("rows", 8),
)
"""`size` pixels a work-item, against one environment (pixel_product.cl) or sixteen (pixel_product_wide.cl)."""


@dataclass(frozen=True, eq=False)
class Tile:
    """Some pixels on the device, with their points.

    Attributes
    ----------
    first, phase : device arrays as `prtcl.factors.pixel_visibility.Pixels` has them, counted within the tile
    frames, views : device arrays (points, 9) and (points, 4)
    bits : (pixels, words) uint32 on the host, and `device_bits`, the same there
    """

    first: Any
    phase: Any
    frames: Any
    views: Any
    bits: npt.NDArray[np.uint32]
    device_bits: Any

    def __len__(self) -> int:
        return len(self.bits)

    def seen(self, rays: int, levels: int) -> npt.NDArray[np.int32]:
        """The cells of `levels` that any of the pixels sees some of, ascending.

        Parameters
        ----------
        rays : levels of the bits
        """
        words = np.bitwise_or.reduce(self.bits, axis=0).astype("<u4").view(np.uint8)
        some = np.unpackbits(words, bitorder="little")
        if levels <= rays:
            return np.flatnonzero(some.reshape(-1, 4 ** (rays - levels)).any(axis=1)).astype(np.int32)
        each = 4 ** (levels - rays)
        return np.add.outer(np.flatnonzero(some) * each, np.arange(each)).ravel().astype(np.int32)


@dataclass(frozen=True)
class Grids:
    """Levels of the sphere's grids.

    Attributes
    ----------
    light : cells that light is averaged over
    fine : cells that f is evaluated in, at least `light` and `rays`
    rays : visibility's
    """

    light: int
    fine: int
    rays: int


def transport(
    device: Device, materials: Materials, material: Any, tile: Tile, cells: Any, grids: Grids, channels: int
) -> Any:
    """T of a tile's pixels over some cells: device array (channels, pixels, cells).

    Parameters
    ----------
    material : device array (points,) int32
    cells : device array int32
    """
    out = device.empty((channels, len(tile), len(cells)))
    kernel = device.kernels(
        "pixel_transport.cl", LEVELS=grids.light, FINE=grids.fine, BITS=grids.rays, CHANNELS=channels,
        KINDS=materials.mask, GROUP=GROUP,
    )["pixel_transport"]  # fmt: skip
    directions = device.constant(("sphere", grids.fine), lambda: sphere.centres(grids.fine))
    device.launch(
        kernel, len(cells), GROUP, *materials.arguments, material, directions, tile.device_bits, tile.frames,
        tile.views, tile.first, tile.phase, cells, len(cells), len(tile), out, y=len(tile),
    )  # fmt: skip
    return out


def panels(lights: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Columns of light as the product takes them.

    Parameters
    ----------
    lights : (environments, n_cells, 3)

    Returns
    -------
    panels : (3 panels, n_cells, PANEL), red's first; environments are filled up to whole panels with zeros
    """
    count, cells, _ = lights.shape
    full = np.zeros((3, -(-count // PANEL) * PANEL, cells), dtype=lights.dtype)
    full[:, :count] = lights.transpose(2, 0, 1)
    return np.ascontiguousarray(full.reshape(-1, PANEL, cells).transpose(0, 2, 1))


def product(device: Device, rows: Any, lights: Any, cells: Any) -> Any:
    """Radiance of pixels under all environments: device array (pixels, 3, panels · PANEL).

    Parameters
    ----------
    rows : device array (channels, pixels, cells), as `transport` gives it
    lights : device array, as `panels` gives it
    cells : device array int32, which rows of the lights the transport's columns stand for
    """
    channels, pixels, count = rows.shape
    n_panels, form = lights.shape[0] // 3, PRODUCT.of(device)
    out = device.empty((pixels, 3, n_panels * PANEL))
    arguments = [rows, lights, lights.shape[1], cells, count, pixels, n_panels, out]
    blocks = -(-pixels // form.size)
    if form.name == "wide":
        kernel = device.kernels("pixel_product_wide.cl", CHANNELS=channels, ROWS=form.size)[
            "pixel_product_wide"
        ]
        device.launch(kernel, 3 * n_panels, 1, *arguments, y=blocks, stage="pixel_product")
    else:
        kernel = device.kernels("pixel_product.cl", CHANNELS=channels, ROWS=form.size, PANEL=PANEL)[
            "pixel_product"
        ]
        device.launch(kernel, 3 * n_panels * PANEL, 16, *arguments, y=blocks)
    return out


def bytes_per_pixel(device: Device, grids: Grids, channels: int, environments: int) -> int:
    """Bytes that one pixel's transport and radiance take on the device."""
    real = np.dtype(device.dtype).itemsize
    filled = -(-environments // PANEL) * PANEL
    return real * (2 * channels * quadtree.n_samples(grids.light) + 3 * filled)

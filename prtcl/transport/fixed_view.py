"""One view under many environments: V ⊕ f_v for each pixel in the world's own directions, times all lights at once.

The other order, L ⊕ V (`prtcl.transport.pipeline`), serves many materials and views of one light. Where the view is
fixed and the light varies, a pixel's transport

    T_p(ω) = mean over its points s of  V_s(ω) f_s(ω, v_s) max(n_s · ω, 0),     I_p = ∫ T_p(ω) L(ω) dω

is a row of numbers over cells of directions that all pixels share (`prtcl.factors.sphere`), light is a column, and
hundreds of environments are one matrix product. Averaging over a pixel before the product makes more sub-pixel points
free. T is made tile by tile, multiplied and forgotten. A turned environment is another column and nothing more. Peaks
of light that no such cell can hold are samples of their own (`prtcl.factors.hardlight`), traced for each environment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.chunks import chunk_size
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import hemisphere, pixel_visibility, sphere
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.pixel_visibility import Pixels
from prtcl.factors.slices import Materials
from prtcl.factors.visibility import Progress, Tracer
from prtcl.transport import pixel_transport
from prtcl.transport.light_columns import SHARE, Lamps, Lights
from prtcl.transport.pipeline import Points
from prtcl.transport.pixel_transport import PANEL, Grids, Tile

ROUGH = 0.25
"""GGX α from which a lobe is as wide as ten cells of 2.2 degrees."""
TILE = 512
"""Pixels of one product at most."""
LIGHTS = 1 << 24
"""Most bits of hard light's visibility, pixels times samples, in one launch."""


def rays_for(materials: Iterable[Material]) -> int:
    """Levels of the visibility grid that the sharpest of all materials needs: cells of 2.2 degrees, or of 1.1.

    The finer grid takes 2.2 times the rays (bench/relight_choices.py); narrow lobes need it where they meet the edge of
    what hides the light.
    """
    return 6 if min(material.roughness for material in materials) >= ROUGH else 7


def grids_for(materials: Sequence[Material], rays: int) -> Grids:
    """Grids of light and f for what reflects sharpest among some materials."""
    alpha = min(material.roughness for material in materials)
    light = 6 if alpha >= ROUGH else 7 if alpha >= 0.08 else 8
    return Grids(light=light, fine=max(light, rays), rays=rays)


Bits = npt.NDArray[np.uint32]
Keeper = Callable[[Points, Pixels, Callable[[], Bits]], Bits]
"""Gives the visibility of pixels, kept from before or traced: called with the points and pixels in the order of the
bits, and what traces them."""


class FixedView:
    """The pixels of one view, ready for any environments and materials.

    Parameters
    ----------
    device : where the kernels run
    tracer : of the mesh
    points : the sub-pixel points, those of each pixel together
    pixel : (n,) the pixel that each point belongs to
    rays : levels of the visibility grid, see `rays_for`
    progress : called with the number of pixels traced, from worker threads
    every : trace all cells; otherwise those alone that `prtcl.factors.refine` needs
    keeper : see `Keeper`; None traces

    Notes
    -----
    T is made anew at each call of `radiance`: ask for many environments at once, some hundred where there are as many.
    All looks of a call share the rays.

    The answer for one environment does not depend, to the bit, on which others are asked for with it.

    Raises
    ------
    InputError
        If the points of some pixel do not stand together, or `rays` is out of range.
    """

    def __init__(
        self, device: Device, tracer: Tracer, points: Points, pixel: npt.ArrayLike, *, rays: int = 6,
        progress: Progress | None = None, every: bool = False, keeper: Keeper | None = None,
    ) -> None:  # fmt: skip
        if not 3 <= rays <= quadtree.MAX_LEVELS - 2:
            raise InputError(f"rays: expected 3 to {quadtree.MAX_LEVELS - 2} levels, got {rays}")
        given = Pixels.of(pixel)
        if given.first[-1] != len(points):
            raise InputError(f"pixel: expected one for each of {len(points)} points, got {given.first[-1]}")
        self.device, self.tracer, self.rays = device, tracer, rays
        self._order = _by_normal(points.frames[:, 2], given)
        counts = np.diff(given.first)[self._order]
        first = np.append(0, np.cumsum(counts)).astype(np.int32)
        within = np.arange(first[-1]) - np.repeat(first[:-1], counts)
        self.points = points[np.repeat(given.first[:-1][self._order], counts) + within]
        self.pixels = Pixels(first, given.phase[self._order])

        def trace() -> Bits:
            with device.profile.host("visibility_rays"):
                return pixel_visibility.soft_visibility(
                    tracer, self.points.origins, self.points.frames[:, 2], self.pixels, rays, progress, every=every
                )  # fmt: skip

        self.bits = trace() if keeper is None else keeper(self.points, self.pixels, trace)

    def __len__(self) -> int:
        return len(self.pixels)

    def radiance(
        self,
        environments: Sequence[Environment],
        looks: Sequence[Sequence[Material]],
        *,
        hard: str = "auto",
        share: float = SHARE,
        progress: Progress | None = None,
    ) -> npt.NDArray[np.float32]:
        """Radiance of every pixel, the mean over its points.

        Parameters
        ----------
        environments : one or more
        looks : one or more times the materials that `Points.material` indexes
        hard : "auto" takes hard light out of the maps, "off" leaves it in
        share : what a cell may hold before its light is hard, see `SHARE`
        progress : called with the number of pixels done, once for each look and tile

        Returns
        -------
        radiance : (looks, environments, pixels, 3) float32 linear RGB, pixels in the order they were given
        """
        if not environments or not looks:
            raise InputError("environments and looks: expected at least one of each")
        needed = int(self.points.material.max()) + 1
        for look in looks:
            if len(look) < needed:
                raise InputError(f"looks: expected {needed} materials for the points, got {len(look)}")
        device = self.device
        grids = [grids_for(look, self.rays) for look in looks]
        with device.profile.host("resample_light"):
            lights = Lights.of(device, environments, sorted({own.light for own in grids}), hard, share)
            columns = {
                level: device.array(pixel_transport.panels(means)) for level, means in lights.means.items()
            }
        materials = [Materials(device, list(look)) for look in looks]
        out = np.empty((len(looks), len(environments), len(self), 3), dtype=np.float32)
        lamps = Lamps(device, lights, self.rays)
        widest = max(
            pixel_transport.bytes_per_pixel(device, own, known.channels, len(environments))
            for own, known in zip(grids, materials, strict=True)
        )
        size = max(1, min(TILE, chunk_size(device, widest, widest), LIGHTS // max(1, len(lights.hard))))
        for start in range(0, len(self), size):
            part = slice(start, min(start + size, len(self)))
            points, pixels, tile = self._tile(part)
            seen = self._hard_bits(points, pixels, lights)
            material = device.array(points.material, np.int32)
            for number, (own, known) in enumerate(zip(grids, materials, strict=True)):
                got = _soft(device, known, material, tile, own, columns[own.light])
                lamps.add(known, material, tile, seen, got)
                values = got.get()[..., : len(environments)] * lights.units
                out[number][:, self._order[part]] = values.transpose(2, 0, 1)
                if progress is not None:
                    progress(len(tile))
        return out

    def _tile(self, part: slice) -> tuple[Points, Pixels, Tile]:
        """Some pixels with their points, on the host and on the device."""
        device = self.device
        first = self.pixels.first[part.start : part.stop + 1]
        points = self.points[slice(int(first[0]), int(first[-1]))]
        pixels = replace(self.pixels, first=first - first[0], phase=self.pixels.phase[part])
        views = np.zeros((len(points), 4))
        views[:, :3] = points.views
        # Nothing is reflected to a view from below: without a frame, no direction lies above the horizon.
        frames = np.where(points.views[:, 2, None, None] > 0.0, points.frames, np.float32(0))
        bits = self.bits[part]
        return points, pixels, Tile(
            device.array(pixels.first, np.int32), device.array(pixels.phase, np.int32),
            device.array(frames), device.array(views), bits, device.array(bits, np.uint32),
        )  # fmt: skip

    def _hard_bits(self, points: Points, pixels: Pixels, lights: Lights) -> Any:
        with self.device.profile.host("hard_light_rays"):
            seen = pixel_visibility.hard_visibility(
                self.tracer, points.origins, points.frames[:, 2], pixels, lights.rays
            )  # fmt: skip
        return self.device.array(seen, np.uint32)


def _soft(device: Device, materials: Materials, material: Any, tile: Tile, grids: Grids, columns: Any) -> Any:
    """Radiance of a tile's pixels from soft light: device array (pixels, 3, environments)."""
    cells = device.array(tile.seen(grids.rays, grids.light), np.int32)
    if not len(cells):
        return device.array(np.zeros((len(tile), 3, columns.shape[0] // 3 * PANEL)))
    rows = pixel_transport.transport(device, materials, material, tile, cells, grids, materials.channels)
    return pixel_transport.product(device, rows, columns, cells)


def _by_normal(normals: npt.NDArray[np.float32], pixels: Pixels) -> npt.NDArray[np.int64]:
    """Pixels in an order in which neighbours face alike, so that a tile's horizons are nearly one."""
    mean = np.add.reduceat(normals.astype(np.float64), pixels.first[:-1], axis=0)
    mean = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
    above = mean[:, 1] >= 0
    local = np.where(above[:, None], mean @ sphere.FRAMES[0].T, mean @ sphere.FRAMES[1].T)
    u, v = hemisphere.to_square(local)
    cell = quadtree.grid_to_morton(4)[np.clip(v * 16, 0, 15).astype(int), np.clip(u * 16, 0, 15).astype(int)]
    return np.lexsort((np.arange(len(pixels)), cell, ~above))

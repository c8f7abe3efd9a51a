"""Light and visibility of a mesh's points collapsed and kept, so that materials and views change at once.

What is kept is the packed parent sums of L ⊕ V (`prtcl.wavelet.pyramid`). A view or a material then costs each point
the leaves of one cut (`prtcl.transport.cut`), with f evaluated exactly, plus its hard light. Points are traced and
collapsed when they are first asked for.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.chunks import chunk_size, chunks
from prtcl.compute.device import Device
from prtcl.errors import DeviceError
from prtcl.factors.environment import Environment, Light
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.factors.visibility import Progress, Tracer
from prtcl.transport import collapse, cut, shade
from prtcl.transport.pipeline import Points
from prtcl.transport.settings import Settings
from prtcl.wavelet import haar, pyramid

LANES_CPU, LANES_GPU = 16, 64
"""Work-items a point for the leaves of its cut."""
GROUP = 64
PILOT = 128
"""Points whose products tell how much detail light and visibility have at each level."""

Indices = npt.NDArray[np.int32]


class Relit:
    """The points of a mesh under one light at a time.

    Parameters
    ----------
    device : where everything is kept; float32
    tracer : what occludes
    positions : (n, 3) world
    points : frames that depend on the normal alone, as `vertex_points` makes them without an eye
    levels : 4**levels directions of light, product and visibility
    rays : levels of the visibility grid, at most `levels`
    bits : (n, words) visibility already traced on 4**rays directions, or None
    """

    def __init__(
        self, device: Device, tracer: Tracer, positions: npt.NDArray[np.float64], points: Points, levels: int,
        rays: int, bits: npt.NDArray[np.uint32] | None = None,
    ) -> None:  # fmt: skip
        self.device, self.tracer, self.points = device, tracer, points
        self.settings = Settings(levels=levels, rays=rays, keep=levels)
        count = len(points)
        needed = count * pyramid.row_bytes(levels)
        if needed > min(device.max_allocation, device.memory * 3 // 4):
            raise DeviceError(
                f"{device.name}: {count} points at 4^{levels} directions keep {needed / 2**30:.1f} GiB in one "
                f"buffer, its largest is {device.max_allocation / 2**30:.1f} GiB\nuse fewer levels, or a coarser mesh"
            )
        # The tracer's own origin and scale keep positions exact in float32, and the eye's direction with them.
        self._centre = positions.mean(axis=0)
        self._positions = device.array(positions - self._centre)
        self._frames, self._material = device.array(points.frames), device.array(points.material, np.int32)
        self._sums = device.empty((count, quadtree.n_squares(levels + 1)), np.uint32)
        self._leaves = device.constant(("leaves", levels), lambda: cut.leaf_directions(levels))
        self._turns = device.array(quadtree.turned_squares(levels), np.int32)
        words = quadtree.visibility_words(rays)
        self._bits = np.zeros((count, words), dtype=np.uint32) if bits is None else bits
        self.traced = np.full(count, bits is not None)
        self.collapsed = np.zeros(count, dtype=np.bool_)
        self._cuts: dict[Hashable, cut.Cut] = {}
        self.light: Light | None = None

    # --- the light ------------------------------------------------------------------------------------------

    def set_light(self, environment: Environment) -> None:
        """Take another light: nothing traced is lost, nothing collapsed is kept."""
        self.light = environment.split(self.settings.levels)
        self.channels = 1 if self.light.grey else 3
        self.scale = pyramid.scale_for(float(self.light.cube[..., :3].max()))
        self._hard_bits = np.zeros(
            (len(self.points), max(1, (len(self.light.hard) + 31) // 32)), dtype=np.uint32
        )
        self._hard_on_device: Any = None
        self.collapsed[:] = False
        self._cuts.clear()
        self._spread: npt.NDArray[np.float64] | None = None

    @property
    def spread(self) -> npt.NDArray[np.float64]:
        """(levels,) w_r of `prtcl.transport.cut`, from a fixed sample of the mesh's points."""
        if self._spread is None:
            levels, count = self.settings.levels, len(self.points)
            some = np.linspace(0, count - 1, min(PILOT, count)).astype(np.int32)
            self.trace(some)
            product = self._product(some)
            coefficients = haar.forward(self.device, product).get().astype(np.float64)
            mean = coefficients[..., 0].mean() / 2.0**levels
            self._spread = np.array(
                [
                    (coefficients[..., 4**level : 4 ** (level + 1)] ** 2).mean() / max(mean**2, 1e-300)
                    for level in range(levels)
                ]
            )
        return self._spread

    def trace(self, chosen: Indices, progress: Progress | None = None) -> int:
        """Trace the visibility of those points that have none yet; how many there were."""
        new = chosen[~self.traced[chosen]]
        if len(new):
            points = self.points[new]
            self._bits[new] = self.tracer.visibility(
                points.origins, points.frames, self.settings.rays, points.grid, progress=progress
            )
            self.traced[new] = True
        return len(new)

    def collapse(self, chosen: Indices) -> int:
        """Collapse light and visibility of those points that are not; how many there were."""
        new = chosen[~self.collapsed[chosen]]
        if not len(new):
            return 0
        assert self.light is not None
        each = self.channels * quadtree.n_samples(self.settings.levels) * np.dtype(self.device.dtype).itemsize
        for part in chunks(len(new), chunk_size(self.device, 2 * each, each)):
            some = new[part]
            pyramid.pack(
                self.device, self._product(some), self.device.array(some, np.int32), self._sums, self.scale
            )
        if len(self.light.hard):
            points = self.points[new]
            self._hard_bits[new] = self.tracer.light_visibility(
                points.origins, points.frames[:, 2], self.light.hard[:, :3]
            )
            self._hard_on_device = None
        self.collapsed[new] = True
        return len(new)

    def _product(self, chosen: Indices) -> Any:
        assert self.light is not None
        return collapse.product_samples(
            self.device,
            self.light,
            self._bits[chosen],
            self.points.frames[chosen],
            self.settings,
            self.channels,
        )

    # --- materials ------------------------------------------------------------------------------------------

    def dress(self, materials: list[Material], error: float) -> Dress:
        """Materials ready to shade with, their cuts made or found.

        Parameters
        ----------
        materials : what the points' `material` indexes
        error : relative, what the cuts may leave out; 0 takes every sample
        """
        cuts = [self._cut(material, error) for material in materials]
        return Dress(self.device, materials, cuts)

    def _cut(self, material: Material, error: float) -> cut.Cut:
        stand_ins = cut.stand_ins(material)
        key = ("whole",) if error == 0 else (error, *(id(m) if m.table else m.spec for m in stand_ins))
        if key not in self._cuts:
            levels = self.settings.levels
            self._cuts[key] = (
                cut.whole(levels)
                if error == 0
                else cut.build(self.device, stand_ins, levels, self.spread, error)
            )
        return self._cuts[key]

    # --- views ----------------------------------------------------------------------------------------------

    def radiance(self, dress: Dress, eye: npt.ArrayLike, chosen: Indices) -> npt.NDArray[np.float32]:
        """Radiance (k, 3) of chosen, collapsed points towards an eye; 0 where the eye is below the horizon."""
        device, light, count = self.device, self.light, len(chosen)
        assert light is not None
        if not count:
            return np.zeros((0, 3), dtype=np.float32)
        lanes = LANES_CPU if device.is_cpu else LANES_GPU
        wanted = device.array(chosen, np.int32)
        defines = {"LEVELS": self.settings.levels, "SIDE": cut.SIDE, "KINDS": dress.materials.mask}
        views, out = device.empty((count, 4)), device.empty((count, 4))
        at = [float(x) for x in np.asarray(eye, dtype=np.float64) - self._centre]
        kernels = device.kernels("cut.cl", GROUP=GROUP, **defines)
        device.launch(
            kernels["local_views"], count, GROUP, self._positions, self._frames, wanted, *at, views, count
        )
        device.launch(
            device.kernels("cut.cl", GROUP=lanes, **defines)["shade_cut"], lanes, lanes, *dress.materials.arguments,
            self._material, self._leaves, self._turns, dress.leaves, dress.starts, self._sums, wanted, views, out,
            1.0 / self.scale, 0, y=count,
        )  # fmt: skip
        if len(light.hard):
            if self._hard_on_device is None:
                self._hard_on_device = device.array(self._hard_bits, np.uint32)
            shade.add_chosen_hard_radiance(
                device,
                dress.materials,
                light,
                wanted,
                self._hard_on_device,
                self._material,
                self._frames,
                views,
                out,
            )
        return np.asarray(out.get()[:, :3])


class Dress:
    """Packed materials and their cuts on a device."""

    def __init__(self, device: Device, materials: list[Material], cuts: list[cut.Cut]) -> None:
        self.materials, self.cuts = Materials(device, materials), cuts
        leaves, starts, offset = [], [], 0
        first: dict[int, int] = {}
        for own in cuts:
            if id(own) not in first:
                first[id(own)] = offset
                leaves.append(own.leaves)
                offset += len(own.leaves)
            starts.append(own.starts + first[id(own)])
        self.leaves = device.array(np.concatenate(leaves), np.int32)
        self.starts = device.array(np.concatenate(starts), np.int32)

    @property
    def error(self) -> float:
        """What the coarsest of the cuts is expected to leave out, relative."""
        return max(own.error for own in self.cuts)

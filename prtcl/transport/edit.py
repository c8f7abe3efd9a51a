"""Light and visibility of a mesh's points collapsed and kept, so that materials and views change at once.

What is kept is the packed parent sums of L ⊕ V (`prtcl.wavelet.pyramid`). A view or a material then costs each point
the leaves of one cut (`prtcl.transport.cut`), with f evaluated exactly, plus its hard light. Points are traced and
collapsed when they are first asked for.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.chunks import chunk_size, chunks, largest_buffer
from prtcl.compute.device import Device
from prtcl.errors import DeviceError
from prtcl.factors.environment import Environment, Light
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.factors.visibility import Progress, Tracer
from prtcl.transport import collapse, cut
from prtcl.transport.hard_tree import HardSums
from prtcl.transport.leaves import Leaves, Squares, local_views
from prtcl.transport.pilots import Pilots, sample
from prtcl.transport.pipeline import Points, in_unit
from prtcl.transport.settings import Settings
from prtcl.wavelet import pyramid

Indices = npt.NDArray[np.int32]

KEPT = 4
"""Lists of leaves that stay on the device: what is worn now, and what was just before."""
CUTS = 128
"""Cuts that stay here. Each edit of a table asks for one; those of analytic materials are some dozens in all."""
DRAFT = 4.0
"""Times the error asked for that a draft may cost: a fit takes half a second, and trying another's cut a tenth of it
(bench/table_edit.py)."""


class Relit:
    """The points of a mesh under one light at a time.

    Parameters
    ----------
    device : where everything is kept; float32
    tracer : what occludes
    positions : (n, 3) world
    points : frames that depend on the normal alone, as `vertex_points` makes them without an eye
    other_origins : (n, 3) float32 ray origins on the points' back side
    levels : 4**levels directions of light, product and visibility
    rays : levels of the visibility grid, at most `levels`
    bits : (n, words) visibility already traced on 4**rays directions, or None
    """

    def __init__(
        self, device: Device, tracer: Tracer, positions: npt.NDArray[np.float64], points: Points,
        other_origins: npt.NDArray[np.float32], levels: int, rays: int, bits: npt.NDArray[np.uint32] | None = None,
    ) -> None:  # fmt: skip
        self.device, self.tracer, self._front = device, tracer, points
        # Their own copies: points may be turned to their back side.
        self.points = replace(points, origins=points.origins.copy(), frames=points.frames.copy())
        self._other, self._back = other_origins.copy(), np.zeros(len(points), dtype=np.bool_)
        self.settings = Settings(levels=levels, rays=rays, keep=levels)
        count = len(points)
        needed = count * pyramid.row_bytes(levels)
        if needed > largest_buffer(device):
            raise DeviceError(
                f"{device.name}: {count} points at 4^{levels} directions keep {needed / 2**30:.1f} GiB in one "
                f"buffer, its largest is {device.max_allocation / 2**30:.1f} GiB\nuse fewer levels, or a coarser mesh"
            )
        # The tracer's own origin and scale keep positions exact in float32, and the eye's direction with them.
        self._centre = tracer.centre
        self._positions = device.array(positions - self._centre)
        self._frames, self._material = device.array(points.frames), device.array(points.material, np.int32)
        self._sums = device.empty((count, quadtree.n_squares(levels + 1)), np.uint32)
        self._squares = Squares(levels)
        words = quadtree.visibility_words(rays)
        self._bits = np.zeros((count, words), dtype=np.uint32) if bits is None else bits.copy()
        self.traced = np.full(count, bits is not None)
        self.collapsed = np.zeros(count, dtype=np.bool_)
        self._cuts: OrderedDict[Hashable, tuple[cut.Cut, tuple[Material, ...]]] = OrderedDict()
        self._tried: OrderedDict[Hashable, tuple[float, Material, cut.Cut]] = OrderedDict()
        self._lists: OrderedDict[Hashable, tuple[Leaves, list[cut.Cut]]] = OrderedDict()
        self._pilots: Pilots | None = None
        self._pilot_bits = None if bits is None else bits[sample(count)]
        self.light: Light | None = None

    # --- the light ------------------------------------------------------------------------------------------

    def set_light(self, environment: Environment) -> None:
        """Take another light: nothing traced is lost, nothing collapsed is kept."""
        scaled, unit = in_unit(environment)
        light, count = scaled.split(self.settings.levels), len(self.points)
        # What may fail comes first: the light that is there stays whole.
        hard = HardSums(self.device, light.hard, light.hard_share, count) if len(light.hard) else None
        self.light, self._hard, self._unit = light, hard, np.float32(unit)
        self.channels = 1 if light.grey else 3
        self.scale = pyramid.scale_for(float(light.cube[..., :3].max()))
        self.collapsed[:] = False
        for kept in (self._cuts, self._tried, self._lists):
            kept.clear()
        self._pilots = None

    def turn(self, chosen: Indices, back: npt.NDArray[np.bool_]) -> None:
        """Have the chosen points stand on their front or, where `back`, on their back side.

        A point that changes sides is traced and collapsed anew when it is next needed.
        """
        which = chosen[self._back[chosen] != back]
        if not len(which):
            return
        points = self.points
        points.frames[which, 1:] *= -1.0  # bitangent and normal: the frame stays right-handed
        points.origins[which], self._other[which] = self._other[which], points.origins[which]
        self._back[which] ^= True
        self._frames = self.device.array(points.frames)
        self.traced[which] = self.collapsed[which] = False

    def waiting(self, chosen: Indices, back: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Which of the chosen points are not collapsed on the side wanted."""
        return ~self.collapsed[chosen] | (self._back[chosen] != back)

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
            collapse.packed_sums(
                self.device, self.light, self._bits[some], self.points.frames[some], self.settings, self.channels,
                self.device.array(some, np.int32), self._sums, self.scale,
            )  # fmt: skip
        if self._hard is not None:
            points = self.points[new]
            seen = self.tracer.light_visibility(
                points.origins, points.frames[:, 2], self._hard.samples[:, :3], runs=self._hard.runs
            )
            self._hard.collapse(seen, new)
        self.collapsed[new] = True
        return len(new)

    # --- materials ------------------------------------------------------------------------------------------

    def dress(self, materials: list[Material], error: float, draft: bool = False) -> Dress:
        """Materials ready to shade with, their cuts made or found.

        Parameters
        ----------
        materials : what the points' `material` indexes
        error : relative, what the cuts may leave out; 0 takes every sample
        draft : while a hand drags: an edit of a table may wear that one's cut at `DRAFT` times the error
        """
        found = [self._cut(material, error, draft) for material in materials]
        cuts = [own for own, _ in found]
        places = [0.0 if error == 0.0 else cut.ends(material)[2] for material in materials]
        key = tuple((id(own), place) for own, place in zip(cuts, places, strict=True))
        if key not in self._lists:
            # The cuts are kept with their leaves: each is known by its identity, which must stay its own.
            _keep(self._lists, key, (Leaves(self.device, self._squares, cuts, places), cuts), KEPT)
        self._lists.move_to_end(key)
        hard = None if self._hard is None else self._hard.lists(materials, error)
        return Dress(
            Materials(self.device, materials), cuts, self._lists[key][0], hard, max(e for _, e in found)
        )

    def _cut(self, material: Material, error: float, draft: bool) -> tuple[cut.Cut, float]:
        """A cut of the error asked for, or a whole one for 0, and what it is expected to leave out of this material.

        An edit of a table takes that one's cut where it does, as tried at the sample of points for the edit itself.
        """
        if error == 0.0:
            return self._whole, 0.0
        if material.like is not None and self._key(material, error) not in self._cuts:
            own = self._cut(material.like, error, False)[0]
            off = self._off(material, own)
            if off <= error * (DRAFT if draft else 1.0):
                return own, off
        sharp, wide, _ = cut.ends(material)
        key = self._key(material, error)
        if key not in self._cuts:
            # The stand-ins are kept: a table is known by its identity, which must stay its own.
            _keep(self._cuts, key, (self._sample().fit(sharp, wide, error), sharp), CUTS)
        self._cuts.move_to_end(key)
        made = self._cuts[key][0]
        return made, made.error

    def _key(self, material: Material, error: float) -> Hashable:
        return (error, *(id(m) if m.table else m.spec for m in cut.ends(material)[0]))

    def _off(self, material: Material, own: cut.Cut) -> float:
        """What another's cut costs a material, as measured at the sample."""
        key = id(material), id(own)
        if key not in self._tried:
            _keep(self._tried, key, (self._sample().measure(material, own), material, own), CUTS)
        return self._tried[key][0]

    def _sample(self) -> Pilots:
        if self._pilots is None:
            assert self.light is not None
            some = sample(len(self.points))
            self._pilots = Pilots(
                self.device, self.tracer, self._front[some], self._pilot_bits, self.settings, self._squares,
                self._whole, self.light,
            )  # fmt: skip
            self._pilot_bits = self._pilots.bits
        return self._pilots

    @cached_property
    def _whole(self) -> cut.Cut:
        return cut.whole(self.settings.levels)

    # --- views ----------------------------------------------------------------------------------------------

    def radiance(self, dress: Dress, eye: npt.ArrayLike, chosen: Indices) -> npt.NDArray[np.float32]:
        """Radiance (k, 3) of chosen, collapsed points towards an eye; 0 where the eye is below the horizon."""
        device, light, count = self.device, self.light, len(chosen)
        assert light is not None
        if not count:
            return np.zeros((0, 3), dtype=np.float32)
        wanted, out = device.array(chosen, np.int32), device.empty((count, 4))
        at = np.asarray(eye, dtype=np.float64) - self._centre
        views = local_views(
            device, dress.materials, self.settings.levels, self._positions, self._frames, wanted, at
        )
        dress.leaves.shade(dress.materials, self._material, self._sums, wanted, views, out, 1.0 / self.scale)
        if self._hard is not None and dress.hard is not None:
            self._hard.add_radiance(
                dress.materials, dress.hard, wanted, self._material, self._frames, views, out
            )
        return np.asarray(out.get()[:, :3] * self._unit)


@dataclass(frozen=True, eq=False)
class Dress:
    """Packed materials and their cuts on a device.

    Attributes
    ----------
    hard : as `HardSums.lists` gives them
    error : what the coarsest of the cuts is expected to leave out, relative
    """

    materials: Materials
    cuts: list[cut.Cut]
    leaves: Leaves
    hard: tuple[Any, Any] | None
    error: float


Value = TypeVar("Value")


def _keep(kept: OrderedDict[Hashable, Value], key: Hashable, value: Value, most: int) -> None:
    """Put a value in, and take out those longest unused."""
    kept[key] = value
    while len(kept) > most:
        kept.popitem(last=False)

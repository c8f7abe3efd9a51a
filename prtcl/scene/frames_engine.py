"""What computes the images of a batch: the interface, and the simple way that every device has.

An engine stands before one view at a time, is shown the lights one after another, and gives an image for every
material that is wanted under each. How much it keeps from light to light is its own affair.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.chunks import cache_bytes, chunk_size, chunks
from prtcl.compute.device import Device
from prtcl.factors.environment import Environment, Light
from prtcl.factors.slices import Materials, ViewTable
from prtcl.factors.stored import SliceStore
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.frames_looks import Looks
from prtcl.scene.frames_points import Sight, see
from prtcl.scene.kept_visibility import KeptVisibility
from prtcl.scene.mesh import Mesh
from prtcl.transport import collapse, shade
from prtcl.transport.pipeline import HARD_CHUNK, Points, in_unit
from prtcl.transport.settings import Settings

Image = npt.NDArray[np.float32]
Wanted = tuple[Environment, Sequence[int]]
"""A light, and the numbers of the materials whose images under it are wanted."""
RADIANCE = 1 << 30
"""Host bytes that the radiance of several materials may take together; for more of them a light is collapsed again."""
POINT_BYTES, HIT_BYTES = 200, 40
"""Host bytes of a sub-pixel point beside its visibility, and of one that only says which vertices it lies between."""
BUSY = ("camera_rays", "visibility_rays", "hard_light_rays")
"""Host stages that count as work of the machine's, as kernels do: rays."""


class Engine(Protocol):
    """Images of one mesh in some materials, numbered as they were given, for one view after another."""

    @property
    def device(self) -> Device:
        """Where kernels run, whose profile has the time of every stage."""

    tracer: Tracer
    """Of the mesh."""
    pixel_bytes: float
    """Host bytes that a view takes for each pixel that sees the mesh, about; `prepare` refuses what does not fit."""

    def ahead(self, environment: Environment) -> None:
        """Do what can be done for a light on another thread, before its turn comes."""

    def prepare(self, camera: Camera, pixels: npt.NDArray[np.int64] | None = None, traced: Any = None) -> Any:
        """Stand before this view: the images that follow are of it.

        Parameters
        ----------
        pixels : the images are one row of these, as `see` says; None takes all
        traced : what `prepare` of an engine made alike, in another process, returned for this view; None traces

        Returns
        -------
        traced : the visibility of the view's points, in arrays, which takes most of the time
        """

    def images(self, lights: Iterable[Wanted]) -> Iterator[Image]:
        """For each light, an image of each wanted material: (h, w, 4) float32, linear premultiplied RGBA.

        Every image is the same, bit for bit, whatever others are wanted beside it: interrupted work is finished so.
        An engine may take several lights before it gives the first image.
        """


@dataclass(eq=False)
class _Group:
    """Materials of one `Settings`, and their slices.

    Attributes
    ----------
    local : (all materials,) int32 each one's number within the group; −1 for those of other groups
    """

    settings: Settings
    local: npt.NDArray[np.int32]
    materials: Materials
    slices: SliceStore


@dataclass(eq=False)
class _Layer:
    """Radiance of every point in one assignment of materials, to be computed."""

    material: npt.NDArray[np.int32]
    """(n,) numbers among all materials; −1 where nothing is to be computed, and radiance stays 0."""
    radiance: npt.NDArray[np.floating]


class Simple:
    """Points and visibility of a view are traced once; each light is collapsed with it once, for all materials.

    Costs a light one L ⊕ V at every point, then one inner product a material. Host memory: of every sub-pixel point
    `POINT_BYTES`, about, and 4**rays bits.

    Parameters
    ----------
    looks : what the mesh is seen in
    device : where
    points : "pixel" or "vertex", as `Scene.render` takes it
    samples : N × N sub-pixel points a pixel
    two_sided : as for `Scene`
    bits : of a bake, (vertices, words); None traces
    tracer : of the mesh; None makes it
    kept : where the visibility of whole views is kept; None traces
    """

    def __init__(
        self, mesh: Mesh, looks: Looks, device: Device, *, points: str = "pixel", samples: int = 3,
        two_sided: bool = True, bits: npt.NDArray[np.uint32] | None = None, tracer: Tracer | None = None,
        kept: KeptVisibility | None = None,
    ) -> None:  # fmt: skip
        self.mesh, self.looks, self.points, self.samples = mesh, looks, points, samples
        self.two_sided, self.bits, self._device, self._kept = two_sided, bits, device, kept
        with device.profile.host("build_bvh"):
            self.tracer = tracer or Tracer(mesh.vertices, mesh.faces)
        different = list(dict.fromkeys(looks.settings))
        share = cache_bytes(device, len(different))
        self._groups: list[_Group] = []
        for settings in different:
            members = [i for i, own in enumerate(looks.settings) if own == settings]
            local = np.full(len(looks.settings), -1, dtype=np.int32)
            local[members] = np.arange(len(members))
            materials = Materials(device, [looks.materials[i] for i in members])
            table = ViewTable.make(bits is None, settings.views)
            self._groups.append(
                _Group(settings, local, materials, SliceStore(device, materials, table, settings.keep, share))
            )
        each = float(HIT_BYTES)
        if points == "pixel" and bits is None:
            rays = {(own.rays, own.visibility) for own in different}
            each = POINT_BYTES + sum(quadtree.n_samples(levels) / 8 for levels, _ in rays)
        self.pixel_bytes = samples**2 * each
        self._sight: Sight | None = None
        self._seen: dict[tuple[int, str], npt.NDArray[np.uint32]] = {}

    @property
    def device(self) -> Device:
        """Where kernels run."""
        return self._device

    def ahead(self, environment: Environment) -> None:
        """Take the light apart."""
        scaled, unit = in_unit(environment)
        if unit == 1.0:  # of a scaled copy nothing would be kept
            for group in self._groups:
                scaled.split(group.settings.levels, group.settings.hard)

    def prepare(
        self, camera: Camera, pixels: npt.NDArray[np.int64] | None = None,
        traced: dict[tuple[int, str], npt.NDArray[np.uint32]] | None = None,
    ) -> dict[tuple[int, str], npt.NDArray[np.uint32]]:  # fmt: skip
        """Shoot the camera's rays, and trace the visibility of what they hit.

        Returns
        -------
        traced : bits (points, words) by levels and --visibility; none where a bake has them
        """
        profile, self._sight, self._seen = self.device.profile, None, dict(traced or {})
        with profile.host("camera_rays"):
            vertex = self.points == "vertex" or self.bits is not None
            sight = see(
                self.mesh, self.tracer, camera, self.samples, vertex, self.two_sided, self.bits is not None,
                pixels, self.pixel_bytes,
            )  # fmt: skip
        for group in self._groups:
            key = group.settings.rays, group.settings.visibility
            if key in self._seen:
                continue
            if self.bits is not None and sight.vertices is not None:
                self._seen[key] = self.bits[sight.vertices]
                continue
            trace = partial(self._trace, sight.points, *key)
            if self._kept is None or pixels is not None:
                self._seen[key] = trace()
            else:
                self._seen[key] = self._kept.of_points(camera, sight.points, *key, trace)
        self._sight = sight
        return {} if self.bits is not None else self._seen

    def _trace(self, points: Points, levels: int, mode: str) -> npt.NDArray[np.uint32]:
        with self.device.profile.host("visibility_rays"):
            return self.tracer.visibility(
                points.origins, points.frames, levels, points.grid, every=mode == "every"
            )

    def images(self, lights: Iterable[Wanted]) -> Iterator[Image]:
        """As `Engine.images`; one light at a time."""
        assert self._sight is not None, "no view was prepared"
        sight = self._sight
        parts = sight.points.material
        none = np.broadcast_to(np.zeros(3, self.device.dtype), (len(parts), 3))
        together = max(1, RADIANCE // max(1, 2 * none.nbytes))
        for environment, wanted in lights:
            for some in (wanted[part] for part in chunks(len(wanted), together)):
                layers = []
                for look in some:
                    for assigned in (self.looks.full[look], self.looks.left[look]):
                        nothing = bool((assigned < 0).all())
                        radiance = none if nothing else np.zeros(none.shape, none.dtype)
                        layers.append(_Layer(assigned[parts], radiance))
                self._light_up(sight.points, environment, layers)
                for number, look in enumerate(some):
                    full, left = layers[2 * number].radiance, layers[2 * number + 1].radiance
                    at = np.flatnonzero(self.looks.tinted[look][parts])
                    if len(at):
                        full[at] = left[at] + sight.colour(self.mesh)[at] * (full[at] - left[at])
                    yield sight.develop(self.mesh, full)

    def _light_up(self, points: Points, environment: Environment, layers: list[_Layer]) -> None:
        """Fill the layers' radiance under a light."""
        scaled, unit = in_unit(environment)
        with self.device.profile.host("split_light"):
            lights = [scaled.split(g.settings.levels, g.settings.hard) for g in self._groups]
        waiting: list[Any] = []
        for part in chunks(len(points), self._chunk(lights)):
            started: list[Any] = []
            hard_seen: list[tuple[npt.NDArray[np.float64], npt.NDArray[np.uint32]]] = []
            for group, light in zip(self._groups, lights, strict=True):
                numbers = [self._local(group, layer.material[part]) for layer in layers]
                rows = np.flatnonzero(np.any([number >= 0 for number in numbers], axis=0))
                if len(rows):
                    at = rows + part.start
                    seen = self._hard(points[part], light, hard_seen)
                    own = [(layer, number[rows]) for layer, number in zip(layers, numbers, strict=True)]
                    started += self._shade(group, light, points[at], at, seen[rows], own)
            # A chunk is waited for when the next one is under way, where the device works beside the host.
            self._finish(waiting if self.device.beside_host else started, unit)
            waiting = started if self.device.beside_host else []
        self._finish(waiting, unit)

    def _chunk(self, lights: list[Light]) -> int:
        """Points that are in flight together, for the hungriest group."""
        sizes = [HARD_CHUNK]
        real = np.dtype(self.device.dtype).itemsize
        for group, light in zip(self._groups, lights, strict=True):
            stages = collapse.bytes_per_point(self.device, group.settings, 1 if light.grey else 3)
            stages["frames_views_radiance"] = 40 * real
            stages["hard_light_bits"] = 4 * ((len(light.hard) + 31) // 32)
            sizes.append(chunk_size(self.device, sum(stages.values()), max(stages.values())))
        return min(sizes)

    @staticmethod
    def _local(group: _Group, material: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Numbers within a group of materials (n,); −1 stays."""
        return np.where(material >= 0, group.local[material], -1).astype(np.int32)

    def _hard(
        self,
        points: Points,
        light: Light,
        known: list[tuple[npt.NDArray[np.float64], npt.NDArray[np.uint32]]],
    ) -> npt.NDArray[np.uint32]:
        """Which hard samples some points see; traced once for all groups that have the same."""
        for hard, bits in known:
            if np.array_equal(hard, light.hard):
                return bits
        with self.device.profile.host("hard_light_rays"):
            bits = self.tracer.light_visibility(points.origins, points.frames[:, 2], light.hard[:, :3])
        known.append((light.hard, bits))
        return bits

    def _shade(
        self, group: _Group, light: Light, points: Points, at: npt.NDArray[np.intp],
        hard_seen: npt.NDArray[np.uint32], layers: list[tuple[_Layer, npt.NDArray[np.int32]]],
    ) -> list[Any]:  # fmt: skip
        """Start every layer's radiance at some points; what `_finish` takes.

        Parameters
        ----------
        at : (k,) which points these are
        layers : each with the (k,) numbers of its materials within the group, −1 where it has other ones
        """
        settings, device = group.settings, self.device
        channels = 1 if light.grey else 3
        bits = self._seen[settings.rays, settings.visibility][at]

        def collapsed(rows: slice | npt.NDArray[np.int64]) -> Any:
            some = points[rows]
            return collapse.reduced_coefficients(
                device, light, bits[rows], some.frames, settings, channels, some.grid
            )

        reduced = collapsed(slice(None))
        nodes, weight = group.slices.table.locate(points.views)
        started = []
        for layer, number in layers:
            if not (number >= 0).any():
                continue
            keys = group.slices.keys(np.maximum(number, 0), nodes)
            for rows in group.slices.parts(keys, len(keys)):
                # Slices that do not fit the device together are rare, and then L ⊕ V is made anew for each part.
                whole = len(rows) == len(keys) and bool((rows[1:] > rows[:-1]).all())
                slices, index = group.slices.take(keys[rows])
                radiance = shade.soft_radiance(
                    device,
                    reduced if whole else collapsed(rows),
                    slices,
                    index,
                    weight[rows],
                    settings.levels,
                )
                some = points[rows]
                shade.add_hard_radiance(
                    device, group.materials, light, hard_seen[rows], np.maximum(number[rows], 0), some.frames,
                    some.views, radiance,
                )  # fmt: skip
                own = number[rows] >= 0
                started.append((layer, at[rows][own], own, device.fetch(radiance)))
        return started

    def _finish(self, started: list[Any], unit: float) -> None:
        with self.device.profile.host("wait_for_device"):
            for layer, at, own, wait in started:
                layer.radiance[at] = wait()[own, :3] * unit


def with_rotation(environment: Environment, degrees: float) -> Environment:
    """The light turned further about its up axis; what was made of it on its own axes is kept."""
    return replace(environment, rotate=environment.rotate + degrees) if degrees else environment

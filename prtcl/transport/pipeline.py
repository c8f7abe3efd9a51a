"""From points to radiance: visibility, collapse, shade, in chunks that fit the device."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.chunks import cache_bytes, chunk_size, chunks
from prtcl.compute.device import Device
from prtcl.factors.environment import Environment, Light
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials, ViewTable
from prtcl.factors.stored import SliceStore
from prtcl.factors.visibility import Progress, RayCount, Tracer, sees_all
from prtcl.transport import collapse, shade
from prtcl.transport.leave_out import Tally
from prtcl.transport.settings import Settings

HARD_CHUNK = 1 << 16
"""Points a launch of the hard light takes; a point needs some hundred bytes."""


@dataclass(frozen=True, eq=False)
class Points:
    """What radiance is computed at; nothing below the scene knows whether these are vertices or pixels.

    Attributes
    ----------
    origins : (n, 3) float32 ray origins off the surface, in the tracer's coordinates
    frames : (n, 3, 3) float32 world tangent, bitangent, normal as rows
    views : (n, 3) float32 local outgoing directions
    material : (n,) int32 index into the scene's materials
    grid : (n,) int32 which place inside its cells each point's visibility rays take
    polar : whether all views lie in the plane of tangent and normal
    """

    origins: npt.NDArray[np.float32]
    frames: npt.NDArray[np.float32]
    views: npt.NDArray[np.float32]
    material: npt.NDArray[np.int32]
    grid: npt.NDArray[np.int32]
    polar: bool

    def __len__(self) -> int:
        return len(self.origins)

    def __getitem__(self, part: slice | npt.NDArray[np.generic]) -> Points:
        return Points(
            self.origins[part], self.frames[part], self.views[part], self.material[part], self.grid[part],
            self.polar,
        )  # fmt: skip


class Pipeline:
    """One light and some materials, ready to shade any points on one device.

    Parameters
    ----------
    device : where the kernels run
    environment : the light; split into its soft and hard part here, once
    materials : one or more, which `Points.material` indexes
    settings : resolutions
    polar : the kind of view table the points will need (`Points.polar`)
    budget : bytes of device memory a chunk may take; None chooses
    slice_bytes : bytes of device memory the stored slices may take besides; None chooses

    Notes
    -----
    What the scene does not need is left out: one channel where light or material is grey, slices only for the
    materials and views in use, no hard-light rays where there is no hard light, none below a point's horizon.
    """

    def __init__(
        self,
        device: Device,
        environment: Environment,
        materials: list[Material],
        settings: Settings,
        *,
        polar: bool = True,
        budget: int | None = None,
        slice_bytes: int | None = None,
    ) -> None:
        self.device, self.settings, self.budget = device, settings, budget
        with device.profile.host("split_light"):
            scaled, self.unit = in_unit(environment)
            self.light = scaled.split(settings.levels, settings.hard)
        self.tally = Tally()
        self.materials = Materials(device, materials, every_term=not settings.leaves("terms"))
        self.channels = 1 if self.light.grey and settings.leaves("grey") else 3
        self.table = ViewTable.make(polar, settings.views)
        limit = cache_bytes(device) if slice_bytes is None else slice_bytes
        self.slices = SliceStore(
            device, self.materials, self.table, settings.keep, limit, all_views=not settings.leaves("views")
        )
        self._matt = np.array([own.kind == "lambert" for own in materials])
        for stage, count in self.bytes_per_point().items():
            device.profile.per_point(stage, count)

    def bytes_per_point(self) -> dict[str, int]:
        """Device bytes a point by stage."""
        real = np.dtype(self.device.dtype).itemsize
        stages = collapse.bytes_per_point(self.device, self.settings, self.channels)
        stages["frames_views_radiance"] = (2 * 9 + 4 + 4) * real + 4
        stages["view_weights"] = (4 + real) * (2 if self.table.polar else 4)
        stages["hard_light_bits"] = 4 * ((len(self.light.hard) + 31) // 32)
        return stages

    def visibility(
        self, tracer: Tracer, points: Points, progress: Progress | None = None, traced: RayCount | None = None
    ) -> npt.NDArray[np.uint32]:
        """Visibility bits of the points at `settings.rays`: (n, words) uint32; `traced` counts the rays."""
        with self.device.profile.host("visibility_rays"):
            return tracer.visibility(
                points.origins, points.frames, self.settings.rays, points.grid, progress=progress,
                every=self.settings.visibility == "every" or not self.settings.leaves("rays"),
                traced=traced,
            )  # fmt: skip

    def soft(
        self, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None = None,
        progress: Progress | None = None,
    ) -> npt.NDArray[np.floating]:  # fmt: skip
        """Radiance (n, 3) that the soft light gives: reduced coefficients times slices.

        Parameters
        ----------
        bits : visibility as `visibility` returns it; None traces it
        progress : called with the number of points done, from worker threads
        """
        stages = self.bytes_per_point()
        size = chunk_size(self.device, sum(stages.values()), max(stages.values()), self.budget)
        out = np.zeros((len(points), 3), dtype=self.device.dtype)
        nodes, weight = self.table.locate(points.views)
        keys = self.slices.keys(points.material, nodes)
        fetched: tuple[Source, Callable[[], Any]] | None = None
        for part in self.slices.parts(keys, size):
            some = points[part]
            if bits is None:
                # Its own count: other devices' pipelines trace beside this one.
                traced, every = RayCount(), len(some) * quadtree.n_samples(self.settings.rays)
                seen = self.visibility(tracer, some, progress, traced)
                self.tally.add("rays", every - traced.rays, every)
            else:
                seen = bits[part]
            source = self._needed(part, some, seen)
            if source.rows is not None:
                some, seen, part = some[source.rows], seen[source.rows], part[source.rows]
            if len(some):
                reduced = collapse.reduced_coefficients(
                    self.device, self.light, seen, some.frames, self.settings, self.channels, some.grid
                )
                slices, index = self.slices.take(keys[part])
                radiance = shade.soft_radiance(
                    self.device, reduced, slices, index, weight[part], self.settings.levels
                )
                # A part's radiance is waited for when the next part's rays are traced: a GPU computes in between.
                if fetched is not None:
                    self._finish(*fetched, out)
                fetched = source, self.device.fetch(radiance)
                if not self.device.beside_host:
                    self._finish(*fetched, out)
                    fetched = None
            if bits is not None and progress is not None:
                progress(len(source.part))
        if fetched is not None:
            self._finish(*fetched, out)
        views, made = self.slices.count
        self.tally.set("views", views - made, views)
        return out

    def _needed(self, part: npt.NDArray[np.int64], some: Points, seen: npt.NDArray[np.uint32]) -> Source:
        """Which of a part's points must be shaded, and whose radiance each takes.

        One that sees nothing of the sky, or is seen from below its horizon, is black. Matt ones that see all of it
        differ by their normals alone: of each normal one is shaded, and the others take its radiance, though on their
        own grids, turned about the normal, the same sum would be taken over other directions.
        """
        settings = self.settings
        whole = sees_all(seen, settings.rays)
        below = some.views[:, 2] <= 0.0
        dark = ~seen.any(axis=1) | below if settings.leaves("unlit") else np.zeros(len(some), dtype=np.bool_)
        self.tally.add("unlit", dark.sum(), len(some))
        self.tally.add("unshadowed", whole.sum() if settings.leaves("unshadowed") else 0, len(some))
        source = np.arange(len(some))
        # Of light whose peaks are taken out: with them another turn of the grid is another sum, by percents.
        shares = settings.leaves("normals") and settings.hard == "auto"
        shared = source[whole & ~below & self._matt[some.material]] if shares else source[:0]
        if len(shared) > 1:
            named = np.empty(len(shared), dtype=[("normal", "f4", 3), ("material", "i4")])
            named["normal"], named["material"] = some.frames[shared, 2], some.material[shared]
            _, first, inverse = np.unique(named, return_index=True, return_inverse=True)
            source[shared] = shared[first][inverse]
        source[dark] = -1
        self.tally.add("normals", (source[shared] != shared).sum(), len(some))
        rows = np.flatnonzero(source == np.arange(len(some)))
        if len(rows) == len(some):
            return Source(part, None, None)
        place = np.full(len(some) + 1, -1)
        place[rows] = np.arange(len(rows))
        return Source(part, rows, place[source])

    def hard(
        self, tracer: Tracer, points: Points, progress: Progress | None = None
    ) -> npt.NDArray[np.floating]:
        """Radiance (n, 3) that the hard samples give, each traced and shaded with the exact BRDF."""
        out = np.zeros((len(points), 3), dtype=self.device.dtype)
        if not len(self.light.hard):
            return out
        for part in chunks(len(points), HARD_CHUNK):
            some = points[part]
            traced, every = RayCount(), len(some) * len(self.light.hard)
            with self.device.profile.host("hard_light_rays"):
                seen = tracer.light_visibility(
                    some.origins, some.frames[:, 2], self.light.hard[:, :3], progress,
                    horizon=self.settings.leaves("horizon"), traced=traced,
                )  # fmt: skip
            self.tally.add("horizon", every - traced.rays, every)
            radiance = self.device.array(np.zeros((len(some), 4)))
            shade.add_hard_radiance(
                self.device,
                self.materials,
                self.light,
                seen,
                some.material,
                some.frames,
                some.views,
                radiance,
            )
            self._finish(
                Source(np.arange(part.start, part.stop), None, None), self.device.fetch(radiance), out
            )
        return out

    def radiance(
        self, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None = None,
        progress: Progress | None = None,
    ) -> npt.NDArray[np.floating]:  # fmt: skip
        """Outgoing radiance of every point, soft and hard light together: (n, 3), linear RGB."""
        return np.asarray(self.soft(tracer, points, bits, progress) + self.hard(tracer, points))

    def _finish(self, source: Source, wait: Callable[[], Any], out: npt.NDArray[np.floating]) -> None:
        """Wait for a part's radiance, and put it where it belongs."""
        with self.device.profile.host("wait_for_device"):
            radiance = wait()[:, :3] * self.unit
            if source.place is not None:
                radiance = np.where(source.place[:, None] >= 0, radiance[source.place], 0.0)
            out[source.part] = radiance


@dataclass(frozen=True, eq=False)
class Source:
    """Where the radiance of a part's points comes from.

    Attributes
    ----------
    part : (n,) the points
    rows : (m,) which of them are shaded, or None for all
    place : (n,) whose of those radiance each takes, -1 for black, or None for its own
    """

    part: npt.NDArray[np.int64]
    rows: npt.NDArray[np.int64] | None
    place: npt.NDArray[np.int64] | None


def in_unit(environment: Environment) -> tuple[Environment, float]:
    """The light as it is stored, and the power of two that it was divided by.

    That is 1 but for light so bright or dim that sums leave float32's range; the environment is then itself, and keeps
    what `Environment.split` has made of it.
    """
    largest = float(environment.image.max(initial=0.0))
    if largest == 0.0 or 2.0**-60 < largest < 2.0**60:
        return environment, 1.0
    unit = 2.0 ** (math.frexp(largest)[1] - 1)
    return replace(environment, image=environment.image / np.float32(unit)), unit


class Pipelines:
    """A `Pipeline` for every distinct `Settings` among some materials, so that a matt floor is not computed as
    finely as the chrome on it.

    Parameters
    ----------
    materials, settings : one of each per material that `Points.material` indexes
    """

    def __init__(
        self,
        device: Device,
        environment: Environment,
        materials: list[Material],
        settings: list[Settings],
        *,
        polar: bool = True,
        budget: int | None = None,
    ) -> None:
        self.device = device
        self.all: list[Pipeline] = []
        self._pipeline = np.zeros(len(materials), dtype=np.int32)
        self._index = np.zeros(len(materials), dtype=np.int32)
        different = dict.fromkeys(settings)
        share = cache_bytes(device, len(different))
        for number, chosen in enumerate(different):
            members = [i for i, own in enumerate(settings) if own == chosen]
            self._pipeline[members] = number
            self._index[members] = np.arange(len(members))
            some = [materials[i] for i in members]
            self.all.append(
                Pipeline(device, environment, some, chosen, polar=polar, budget=budget, slice_bytes=share)
            )

    @property
    def light(self) -> Light:
        """The light as the first pipeline has it; its hard samples are those of all."""
        return self.all[0].light

    def soft(
        self, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None = None,
        progress: Progress | None = None,
    ) -> npt.NDArray[np.floating]:  # fmt: skip
        """As `Pipeline.soft`, every point by the pipeline of its material."""
        out = np.zeros((len(points), 3), dtype=self.device.dtype)
        for pipeline, at, some in self._parts(points):
            out[at] = pipeline.soft(tracer, some, None if bits is None else bits[at], progress)
        return out

    def hard(
        self, tracer: Tracer, points: Points, progress: Progress | None = None
    ) -> npt.NDArray[np.floating]:
        """As `Pipeline.hard`."""
        out = np.zeros((len(points), 3), dtype=self.device.dtype)
        for pipeline, at, some in self._parts(points):
            out[at] = pipeline.hard(tracer, some, progress)
        return out

    def radiance(
        self, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None = None,
        progress: Progress | None = None,
    ) -> npt.NDArray[np.floating]:  # fmt: skip
        """As `Pipeline.radiance`."""
        return np.asarray(self.soft(tracer, points, bits, progress) + self.hard(tracer, points))

    def _parts(self, points: Points) -> Iterator[tuple[Pipeline, npt.NDArray[np.int64], Points]]:
        which = self._pipeline[points.material]
        for number, pipeline in enumerate(self.all):
            at = np.nonzero(which == number)[0]
            if len(at):
                yield pipeline, at, replace(points[at], material=self._index[points.material[at]])

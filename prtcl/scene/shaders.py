"""What a film's points are shaded with: soft or hard light where a pixel's ray hits, or the mesh's vertices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from prtcl.scene.film import Film
from prtcl.scene.points import Hits, pixel_points, vertex_points, with_eye
from prtcl.scene.tint import Rows
from prtcl.transport.pipeline import Pipelines, Points
from prtcl.transport.several import Several

if TYPE_CHECKING:
    from prtcl.scene.scene import Scene

Notify = Callable[[int, int], object]
Radiance = npt.NDArray[np.floating]


class Counter:
    """Points done and known of, for a progress bar that several threads move, and points by stage."""

    def __init__(self, notify: Notify | None) -> None:
        self.done = self.known = 0
        self.by_stage: dict[str, int] = {}
        self._notify = notify

    def expect(self, stage: str, count: int) -> None:
        self.known += count
        self.by_stage[stage] = self.by_stage.get(stage, 0) + count

    def __call__(self, count: int) -> None:
        self.done += count
        if self._notify is not None:
            self._notify(self.done, self.known)


class Shader(Protocol):
    """Radiance (n, 3) of hits, given each one's number within its pixel."""

    def __call__(self, hits: Hits, sub: npt.NDArray[np.int64]) -> Radiance: ...


@dataclass(frozen=True)
class Layer:
    """A film, what exposes it, and how many points a pixel of it starts with and may end with.

    Attributes
    ----------
    share : of the squared error that the image may have, what this layer's estimate may be
    """

    film: Film
    shader: Shader
    first: int
    most: int
    share: float = 1.0


class PixelShader:
    """One part of the light, where the pixels' rays hit: `light` is `Pipelines.soft` or `Pipelines.hard`."""

    def __init__(self, scene: Scene, light: Callable[..., Radiance], count: Counter, stage: str) -> None:
        self.scene, self.light, self.count, self.stage = scene, light, count, stage

    def __call__(self, hits: Hits, sub: npt.NDArray[np.int64]) -> Radiance:
        scene = self.scene
        points = pixel_points(scene.mesh, scene.tracer, hits, sub, scene.two_sided)

        def shade(some: Points, _: Rows) -> Radiance:
            self.count.expect(self.stage, len(some))
            return self.light(scene.tracer, some, progress=self.count)

        return scene.tints.radiance(
            shade,
            scene.single_material(points),
            lambda at: scene.mesh.base_colour(hits.face[at], hits.barycentric[at]),
        )


class VertexShader:
    """Radiance at vertices, interpolated over the faces the pixels see; each vertex is shaded once."""

    def __init__(self, scene: Scene, pipeline: Pipelines | Several, count: Counter) -> None:
        self.scene, self.pipeline, self.count = scene, pipeline, count
        self._radiance = np.zeros((len(scene.mesh.vertices), 3))
        self._known = np.zeros(len(scene.mesh.vertices), dtype=np.bool_)

    def __call__(self, hits: Hits, sub: npt.NDArray[np.int64]) -> Radiance:
        corners = self.scene.mesh.faces[hits.face]
        leave = self.scene.settings[0][0].leaves("unseen")
        seen = np.unique(corners) if leave else np.arange(len(self._known))
        self._shade(seen[~self._known[seen]])
        return np.asarray(np.einsum("nc,ncx->nx", hits.barycentric, self._radiance[corners]))

    def _shade(self, vertices: npt.NDArray[np.integer]) -> None:
        scene = self.scene
        bits = None
        if scene.bake is None:
            points = vertex_points(scene.mesh, scene.tracer, scene.camera.eye, vertices)
        else:
            points = vertex_points(scene.mesh, scene.tracer, None, vertices)
            points = with_eye(points, scene.mesh.vertices[vertices], scene.camera.eye)
            bits = scene.bake.bits[vertices]

        def shade(some: Points, at: Rows) -> Radiance:
            self.count.expect("vertex", len(some))
            own = None if bits is None else bits[at]
            return self.pipeline.radiance(scene.tracer, some, own, progress=self.count)

        self._radiance[vertices] = scene.tints.radiance(
            shade,
            scene.single_material(points),
            lambda at: scene.mesh.vertex_colour(vertices[at]),
        )
        self._known[vertices] = True

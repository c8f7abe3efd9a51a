"""One scene: this mesh, under this light, of this material, seen from here."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.files.image import write_exr, write_png
from prtcl.files.radiance import read_radiance, require_equirectangular
from prtcl.scene.bake import Bake
from prtcl.scene.camera import Camera
from prtcl.scene.film import FIRST, Film
from prtcl.scene.mesh import Mesh, read_mesh
from prtcl.scene.points import Hits, pixel_points, shoot, vertex_points, with_eye
from prtcl.transport.pipeline import Pipeline, Points
from prtcl.transport.settings import Settings, choose

BATCH = 1 << 17
"""Sub-pixel points in flight: bounds the host's memory whatever the image's size."""
MOST = 256
"""Points that an adaptive pixel may end with: 16 × 16."""
PIXEL_ERROR = 0.005
"""Relative RMSE that adaptive sampling aims its (pessimistic) estimate at."""

Path = str | os.PathLike[str]
Report = dict[str, Any]
Notify = Callable[[int, int], object]


@dataclass(frozen=True, eq=False)
class Render:
    """A finished image and what is known of how it was made.

    Attributes
    ----------
    image : (h, w, 4) float32 linear RGBA, colour premultiplied by coverage
    report : settings, device, seconds and points a second by stage, bytes a point, notes
    """

    image: npt.NDArray[np.float32]
    report: Report = field(default_factory=dict)

    def save(self, path: Path, *, png: Path | None = None, exposure: float = 0.0) -> None:
        """Write EXR, and an 8-bit sRGB preview where `png` names one."""
        write_exr(path, self.image, {"prtcl": str(self.report.get("settings", ""))})
        if png is not None:
            write_png(png, self.image, exposure)


def read_environment(
    source: Path | Environment | npt.NDArray[Any], *, rotate: float = 0.0, up: str = "y", repair: bool = False
) -> tuple[Environment, list[str]]:
    """An environment from a file or an array (h, 2 h, 3), and notes on what was repaired.

    Raises
    ------
    InputError
        If the file cannot be read or does not hold an equirectangular map of finite radiance.
    """
    if isinstance(source, Environment):
        return source, []
    if isinstance(source, np.ndarray):
        return Environment(source.astype(np.float32), rotate, up), []
    image, notes = read_radiance(source, repair=repair)
    require_equirectangular(image, source)
    return Environment(image, rotate, up, os.fspath(source)), notes


class Scene:
    """This mesh, this light, this material, from here.

    Parameters
    ----------
    mesh : a `Mesh`, a path to OBJ, PLY, STL, GLB or glTF, or a `Bake` or a path to one (.npz)
    light : an `Environment`, a path to an EXR or HDR map, or an array (h, 2 h, 3)
    material : a SPEC (`prtcl.factors.material.FORMS`), a `Material`, or None for the mesh's own glTF materials
        (lambert of albedo 0.5 where it names none)
    camera : None frames the mesh
    device : None chooses one
    two_sided : seen from behind, a surface's normal is turned to the viewer
    smooth : replace normals by vertex normals averaged over the faces
    **settings : `Settings` fixed by hand: levels, rays, keep, views, method, hard

    Examples
    --------
    >>> Scene("bunny.ply", "sky.exr", "ggx:alpha=0.3,f0=0.04").render().save("bunny.exr")  # doctest: +SKIP
    """

    def __init__(
        self,
        mesh: Mesh | Bake | Path,
        light: Environment | Path | npt.NDArray[Any],
        material: str | Material | None = None,
        camera: Camera | None = None,
        *,
        device: Device | None = None,
        two_sided: bool = True,
        smooth: bool = False,
        **settings: int | str | None,
    ) -> None:
        self.bake: Bake | None = None
        if not isinstance(mesh, Mesh | Bake):
            mesh = Bake.load(mesh) if os.fspath(mesh).endswith(".npz") else read_mesh(mesh)
        if isinstance(mesh, Bake):
            self.bake, mesh = mesh, mesh.mesh
            settings = {**settings, "rays": self.bake.rays}
        self.mesh = mesh.smooth() if smooth and self.bake is None else mesh
        self.environment, self.notes = read_environment(light)
        self.notes = [*self.mesh.notes, *self.notes]
        self.materials = own_materials(self.mesh) if material is None else [Material.parse(material)]
        self._one_material = material is not None
        self.notes += [note for m in self.materials for note in m.notes]
        self.camera = camera or Camera.framing(self.mesh.bounds)
        self.device = device or Device()
        self.two_sided = two_sided
        chosen, self.reason = choose(self.materials)
        if self.bake is not None and settings.get("levels") is None:
            settings["levels"] = max(chosen.levels, self.bake.rays)
        self.settings: Settings = chosen.with_defaults(**settings)
        with self.device.profile.host("build_bvh"):
            self.tracer = Tracer(self.mesh.vertices, self.mesh.faces)

    def render(
        self, *, points: str = "pixel", samples: int | None = None, progress: Notify | None = None
    ) -> Render:
        """The image.

        Parameters
        ----------
        points : "pixel" computes radiance at what each pixel sees; "vertex" at the mesh's vertices, between
            which it is interpolated. A bake always renders its vertices.
        samples : N × N sub-pixel points a pixel; None adapts, from 2 × 2 up to 16 × 16
        progress : called with (points done, points known of so far), from worker threads

        Raises
        ------
        InputError
            If `points` or `samples` is out of range.
        """
        if points not in ("pixel", "vertex"):
            raise InputError(f"points: expected pixel or vertex, got {points!r}")
        if samples is not None and not 1 <= samples <= 64:
            raise InputError(f"samples: expected 1 to 64 points along a pixel's side, got {samples}")
        start = time.perf_counter()
        self.device.profile.reset()
        vertex = points == "vertex" or self.bake is not None
        pipeline = Pipeline(
            self.device, self.environment, self.materials, self.settings, polar=self.bake is None
        )
        count = _Counter(progress)
        film = Film(self.camera.size)
        shader = _VertexShader(self, pipeline, count) if vertex else _PixelShader(self, pipeline, count)
        everything = np.arange(film.width * film.height)
        if samples is not None:
            self._expose(film, shader, everything, 0, samples**2)
        else:
            self._expose(film, shader, everything, 0, FIRST)
            reached = FIRST
            while reached < MOST and len(pixels := film.worst(PIXEL_ERROR)):
                # Points are numbered within a pixel, so one that waited a round catches up first.
                pixels = pixels[film.points[pixels] < 4 * reached]
                for have in np.unique(film.points[pixels]):
                    self._expose(film, shader, pixels[film.points[pixels] == have], int(have), 4 * reached)
                reached *= 4
        report = self._report(pipeline, film, count.done, vertex, time.perf_counter() - start)
        return Render(film.image(), report)

    def _expose(
        self, film: Film, shader: _Shader, pixels: npt.NDArray[np.int64], first: int, last: int
    ) -> None:
        """Points first … last − 1 of each of the pixels."""
        each = last - first
        step = max(1, BATCH // each)
        for start in range(0, len(pixels), step):
            some = pixels[start : start + step]
            pixel = np.repeat(some, each)
            sub = np.tile(np.arange(first, last), len(some))
            with self.device.profile.host("camera_rays"):
                hits = shoot(self.tracer, self.camera, pixel, sub)
            film.add(pixel, hits.ray, shader(hits, sub[hits.ray]))

    def _report(
        self, pipeline: Pipeline, film: Film, shaded: int, vertex: bool, seconds: float
    ) -> Report:
        device = pipeline.device
        stages = {**device.profile.device_seconds(), **device.profile.host_seconds()}
        covered = film.covered()
        return {
            "device": device.name,
            "device_reason": device.reason,
            "precision": device.precision,
            "mesh": {"name": self.mesh.name, "vertices": len(self.mesh.vertices), "faces": len(self.mesh.faces)},
            "materials": [m.spec for m in self.materials],
            "settings": {**vars(pipeline.settings), "why": self.reason},
            "light": {
                "hard_samples": len(pipeline.light.hard),
                "hard_share": round(pipeline.light.hard_share, 4),
                "channels": pipeline.channels,
            },
            "points": "vertex" if vertex else "pixel",
            "points_shaded": shaded,
            "rays": int(shaded * (4**self.settings.rays + len(pipeline.light.hard))),
            "points_per_pixel": float(film.points[covered].mean()) if covered.any() else 0.0,
            "pixel_error_estimate": film.error(),
            "seconds": {"total": seconds, **{k: round(v, 4) for k, v in stages.items()}},
            "points_per_second": {k: round(shaded / v) for k, v in stages.items() if v > 0 and shaded},
            "bytes_per_point": device.profile.bytes_per_point(),
            "notes": self.notes,
        }

    def single_material(self, points: Points) -> Points:
        """The points as they are, or all of the one material that replaces the mesh's own."""
        if not self._one_material:
            return points
        zero = np.zeros(len(points), dtype=np.int32)
        return Points(points.origins, points.frames, points.views, zero, points.grid, points.polar)


def own_materials(mesh: Mesh) -> list[Material]:
    """A material for every part of the mesh: its glTF metallic-roughness factors, or a grey Lambert."""
    return [
        Material.parse("lambert:albedo=0.5")
        if part is None
        else Material.from_metallic_roughness(part.base_color, part.metallic, part.roughness)
        for part in mesh.materials
    ]


class _Counter:
    """Points done and known of, for a progress bar that several threads move."""

    def __init__(self, notify: Notify | None) -> None:
        self.done = self.known = 0
        self._notify = notify

    def expect(self, count: int) -> None:
        self.known += count

    def __call__(self, count: int) -> None:
        self.done += count
        if self._notify is not None:
            self._notify(self.done, self.known)


class _PixelShader:
    """Radiance where the pixels' rays hit."""

    def __init__(self, scene: Scene, pipeline: Pipeline, count: _Counter) -> None:
        self.scene, self.pipeline, self.count = scene, pipeline, count

    def __call__(self, hits: Hits, sub: npt.NDArray[np.int64]) -> npt.NDArray[np.floating]:
        scene = self.scene
        points = pixel_points(scene.mesh, scene.tracer, hits, sub, scene.two_sided)
        self.count.expect(len(points))
        return self.pipeline.radiance(scene.tracer, scene.single_material(points), progress=self.count)


class _VertexShader:
    """Radiance at vertices, interpolated over the faces the pixels see; each vertex is shaded once."""

    def __init__(self, scene: Scene, pipeline: Pipeline, count: _Counter) -> None:
        self.scene, self.pipeline, self.count = scene, pipeline, count
        self._radiance = np.zeros((len(scene.mesh.vertices), 3))
        self._known = np.zeros(len(scene.mesh.vertices), dtype=np.bool_)

    def __call__(self, hits: Hits, sub: npt.NDArray[np.int64]) -> npt.NDArray[np.floating]:
        corners = self.scene.mesh.faces[hits.face]
        seen = np.unique(corners)
        self._shade(seen[~self._known[seen]])
        return np.asarray(np.einsum("nc,ncx->nx", hits.barycentric, self._radiance[corners]))

    def _shade(self, vertices: npt.NDArray[np.int64]) -> None:
        scene = self.scene
        self.count.expect(len(vertices))
        bits = None
        if scene.bake is None:
            points = vertex_points(scene.mesh, scene.tracer, scene.camera.eye, vertices)
        else:
            points = vertex_points(scene.mesh, scene.tracer, None, vertices)
            points = with_eye(points, scene.mesh.vertices[vertices], scene.camera.eye)
            bits = scene.bake.bits[vertices]
        self._radiance[vertices] = self.pipeline.radiance(
            scene.tracer, scene.single_material(points), bits, progress=self.count
        )
        self._known[vertices] = True


_Shader = _PixelShader | _VertexShader

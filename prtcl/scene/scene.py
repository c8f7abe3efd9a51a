"""One scene: this mesh, under this light, of this material, seen from here."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.files.image import encode_png, write_exr, write_png
from prtcl.files.radiance import read_radiance, require_equirectangular
from prtcl.scene.bake import Bake, read_mesh_or_bake
from prtcl.scene.camera import Camera
from prtcl.scene.film import FIRST, FIRST_HARD, Film
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import check_eye, shoot
from prtcl.scene.report import covered, render_report
from prtcl.scene.shaders import Counter, Layer, Notify, PixelShader, VertexShader
from prtcl.scene.tint import Tints, colour_notes
from prtcl.transport.pipeline import Pipelines, Points
from prtcl.transport.settings import Settings, choose
from prtcl.transport.several import Several

BATCH = 1 << 17
"""Sub-pixel points in flight: bounds the host's memory whatever the image's size."""
MOST, MOST_HARD = 1024, 4096
"""Points that an adaptive pixel may end with: 32 × 32 of soft light; 64 × 64 of hard light, whose glints on facets
smaller than a pixel vary most, and whose points cost least."""

Path = str | os.PathLike[str]
Report = dict[str, Any]


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

    def _repr_png_(self) -> bytes:
        """What a notebook shows: the preview that `save` writes, at no exposure."""
        return encode_png(self.image)


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
    material : a SPEC (`prtcl.factors.material.FORMS`) or a `Material`; a list of one for each part of the mesh;
        or None for the mesh's own glTF materials and colours (lambert of albedo 0.5 where it has neither)
    camera : None frames the mesh
    device : None chooses one; of a list, all share the work (`prtcl.transport.several`)
    two_sided : seen from behind, a surface's normal is turned to the viewer
    smooth : replace normals by vertex normals averaged over the faces
    **settings : `Settings` fixed by hand: levels, rays, keep, views, method, hard, visibility,
        pixel_error

    Examples
    --------
    >>> Scene("bunny.ply", "sky.exr", "ggx:alpha=0.3,f0=0.04").render().save("bunny.exr")  # doctest: +SKIP
    """

    def __init__(
        self,
        mesh: Mesh | Bake | Path,
        light: Environment | Path | npt.NDArray[Any],
        material: str | Material | Sequence[str | Material] | None = None,
        camera: Camera | None = None,
        *,
        device: Device | Sequence[Device] | None = None,
        two_sided: bool = True,
        smooth: bool = False,
        **settings: float | str | None,
    ) -> None:
        mesh, self.bake = read_mesh_or_bake(mesh)
        if self.bake is not None:
            settings = {**settings, "rays": self.bake.rays}
        self.mesh = mesh.smooth() if smooth and self.bake is None else mesh
        self.environment, self.notes = read_environment(light)
        self.notes = [*self.mesh.notes, *self.notes]
        if isinstance(material, str | Material):
            self.materials, self._one_material = [Material.parse(material)], True
        else:
            own = own_materials(self.mesh) if material is None else [Material.parse(m) for m in material]
            if len(own) != len(self.mesh.materials):
                raise InputError(
                    f"material: expected one, or {len(self.mesh.materials)} for the mesh's parts, got {len(own)}"
                )
            self.materials, self._one_material = own, False
        self.notes += [note for m in self.materials for note in m.notes]
        self.notes += colour_notes(self.materials, self.mesh)
        self.tints = Tints(self.materials, self.mesh)
        self.camera = camera or Camera.framing(self.mesh.bounds)
        self.devices = [device or Device()] if device is None or isinstance(device, Device) else list(device)
        if not self.devices:
            raise InputError("device: expected a Device or several, got an empty list")
        self.device = self.devices[0]
        self.two_sided = two_sided
        self._by_hand = settings
        self.settings = self.choose_settings(vertex=self.bake is not None)
        with self.device.profile.host("build_bvh"):
            self.tracer = Tracer(self.mesh.vertices, self.mesh.faces)

    def choose_settings(self, vertex: bool) -> list[tuple[Settings, str]]:
        """What every material needs at vertices or pixels, with what was fixed by hand on top, and why."""
        out = []
        for material in self.materials:
            chosen, reason = choose(material, alone=vertex)
            if self.bake is not None and self._by_hand.get("levels") is None:
                chosen = replace(chosen, levels=max(chosen.levels, self.bake.rays))
            out.append((chosen.with_defaults(**self._by_hand), reason))
        return out

    def render(
        self, *, points: str = "pixel", samples: int | None = None, progress: Notify | None = None
    ) -> Render:
        """The image.

        Parameters
        ----------
        points : "pixel" computes radiance at what each pixel sees; "vertex" at the mesh's vertices, between
            which it is interpolated. A bake always renders its vertices.
        samples : N × N sub-pixel points a pixel; None adapts, from 2 × 2 up to 64 × 64
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
        for device in self.devices:
            device.profile.reset()
        check_eye(self.tracer, self.mesh, self.camera)
        vertex = points == "vertex" or self.bake is not None
        rays = self.tracer.rays
        self.settings = self.choose_settings(vertex)
        pipelines = [
            Pipelines(
                device,
                self.environment,
                self.tints.materials,
                [self.settings[parent][0] for parent in self.tints.parent],
                polar=self.bake is None,
            )
            for device in self.devices
        ]
        pipeline: Pipelines | Several = pipelines[0] if len(pipelines) == 1 else Several(pipelines)
        count = Counter(progress)
        layers = self._layers(pipeline, count, vertex)
        everything = np.arange(self.camera.size[0] * self.camera.size[1])
        for layer in layers:
            self._expose(layer, everything, 0, layer.first if samples is None else samples**2)
        if samples is None:
            self._refine(layers)
            self._complete(layers)
        rays = self.tracer.rays - rays
        report = render_report(self, pipeline, layers, count, vertex, rays, time.perf_counter() - start)
        return Render(self._develop(layers), report)

    def _repr_png_(self) -> bytes:
        """What a notebook shows: the image at 2 × 2 points a pixel."""
        return self.render(samples=2)._repr_png_()

    def _layers(self, pipeline: Pipelines | Several, count: Counter, vertex: bool) -> list[Layer]:
        """What is sampled on its own, and up to how many points a pixel.

        Soft light costs a hemisphere of rays a point and varies slowly; hard light costs a few rays and brings
        the sharp highlights and shadow edges. Apart, each gets only the points it needs. Hard light starts with
        more: four points that all miss a glint say nothing of it.
        """
        film = Film(self.camera.size)
        if vertex:
            return [Layer(film, VertexShader(self, pipeline, count), FIRST, MOST)]
        layers = [Layer(film, PixelShader(self, pipeline.soft, count, "soft"), FIRST, MOST)]
        if len(pipeline.light.hard):
            shader = PixelShader(self, pipeline.hard, count, "hard")
            layers.append(Layer(Film(self.camera.size), shader, FIRST_HARD, MOST_HARD))
        return layers

    def _refine(self, layers: list[Layer]) -> None:
        """Four times the points, again and again, where the estimated error is largest."""
        for reached in (4**k for k in range(1, 8)):
            active = [layer for layer in layers if reached < layer.most]
            if not active:
                return
            # The whole image's mean and the number of its pixels turn a relative error into a sum of squares.
            mean = np.sum([layer.film.mean().mean(axis=1) for layer in layers], axis=0)
            seen = covered(layers)
            # One number for the whole image: sharp highlights, where there are any, make most of its error.
            error = max(own.pixel_error for own, _ in self.settings)
            allowed = (error * mean[seen].mean()) ** 2 * seen.sum() / len(layers) if seen.any() else 0
            for layer in active:
                pixels = layer.film.worst(allowed)
                # A pixel that waited a round or more catches up round by round.
                pixels = pixels[layer.film.points[pixels] <= reached]
                for have in np.unique(layer.film.points[pixels]):
                    behind = pixels[layer.film.points[pixels] == have]
                    while have <= reached:
                        self._expose(layer, behind, int(have), 4 * int(have))
                        have *= 4

    def _complete(self, layers: list[Layer]) -> None:
        """Points where a layer saw nothing of the mesh but the one with most points did: its colour would be missing.

        Layers share their places in the pixel, so with as many points it sees the mesh too. Few of them do.
        """
        seen, most = self._coverage(layers), np.max([layer.film.points for layer in layers], axis=0)
        for layer in layers:
            film = layer.film
            while (blind := np.flatnonzero((seen > 0) & (film.coverage() == 0) & (film.points < most))).size:
                for have in np.unique(film.points[blind]):
                    self._expose(layer, blind[film.points[blind] == have], int(have), 4 * int(have))

    @staticmethod
    def _coverage(layers: list[Layer]) -> npt.NDArray[np.float64]:
        """(pixels,) the coverage that the layer with most points saw."""
        most = np.argmax([layer.film.points for layer in layers], axis=0)
        return np.stack([layer.film.coverage() for layer in layers])[most, np.arange(len(most))]

    def _develop(self, layers: list[Layer]) -> npt.NDArray[np.float32]:
        """The layers' sum, with the coverage that most points saw.

        Each layer's mean over the points that saw the mesh, times that one coverage: with its own, which differs where
        it has other points, colour and alpha would not belong together and silhouettes would get fringes.
        """
        width, height = self.camera.size
        rgba = np.zeros((height * width, 4))
        rgba[:, 3] = self._coverage(layers)
        for layer in layers:
            own = layer.film.coverage()
            # One where they agree, so that nothing is rounded then.
            scale = np.divide(rgba[:, 3], own, out=np.zeros_like(own), where=own > 0)
            rgba[:, :3] += layer.film.mean() * scale[:, None]
        return rgba.reshape(height, width, 4).astype(np.float32)

    def _expose(self, layer: Layer, pixels: npt.NDArray[np.int64], first: int, last: int) -> None:
        """Points first … last − 1 of each of the pixels."""
        each = last - first
        step = max(1, BATCH // each)
        for start in range(0, len(pixels), step):
            some = pixels[start : start + step]
            pixel, sub = np.repeat(some, each), np.tile(np.arange(first, last), len(some))
            with self.device.profile.host("camera_rays"):
                hits = shoot(self.tracer, self.camera, pixel, sub)
            layer.film.add(some, first, last, hits.ray, layer.shader(hits, sub[hits.ray]))

    def single_material(self, points: Points) -> Points:
        """The points as they are, or all of the one material that replaces the mesh's own."""
        return replace(points, material=np.zeros_like(points.material)) if self._one_material else points


def own_materials(mesh: Mesh) -> list[Material]:
    """A material for every part of the mesh: its metallic-roughness factors, or a Lambert one, grey or coloured."""
    out = []
    for part, coloured in zip(mesh.materials, mesh.coloured, strict=True):
        if part is None:
            out.append(Material.parse("lambert:albedo=mesh" if coloured else "lambert:albedo=0.5"))
        else:
            factors = part.base_color, part.metallic, part.roughness
            out.append(Material.from_metallic_roughness(*factors, mesh=bool(coloured)))
    return out

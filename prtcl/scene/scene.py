"""One scene: this mesh, under this light, of this material, seen from here."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Sequence
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
from prtcl.scene.adapt import MOST, MOST_HARD, Exposure, colours
from prtcl.scene.bake import Bake, read_mesh_or_bake
from prtcl.scene.camera import Camera
from prtcl.scene.film import FIRST, Film
from prtcl.scene.mesh import Mesh
from prtcl.scene.pilot import pipelines
from prtcl.scene.plan import Plan, check_error
from prtcl.scene.plan_vertices import plan_vertices
from prtcl.scene.planner import plan_pixels
from prtcl.scene.points import check_eye
from prtcl.scene.report import render_report
from prtcl.scene.shaders import Counter, Layer, Notify, PixelShader, VertexShader
from prtcl.scene.steer import SHARP, audited, expected_error, steer
from prtcl.scene.tint import Tints, colour_notes
from prtcl.transport.fine_levels import needed
from prtcl.transport.leave_out import parse
from prtcl.transport.pipeline import Pipelines, Points
from prtcl.transport.settings import Settings, settle
from prtcl.transport.several import Several

FITTED = 0.1
"""Of an error asked for, what levels that a material can do without may cost."""

Path = str | os.PathLike[str]
Report = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Render:
    """A finished image and what is known of how it was made.

    Attributes
    ----------
    image : (h, w, 4) float32 linear RGBA, colour premultiplied by coverage
    report : settings, device, seconds and points a second by stage, bytes a point, notes
    error : (h, w) float32 standard error expected of each pixel's grey mean, in its radiance, or None (a `Session`)
    plan : what it was rendered with, where an error was asked for
    """

    image: npt.NDArray[np.float32]
    report: Report = field(default_factory=dict)
    error: npt.NDArray[np.float32] | None = None
    plan: Plan | None = None

    def save(
        self, path: Path, *, png: Path | None = None, exposure: float = 0.0, error: bool = False
    ) -> None:
        """Write EXR, with `error` as a fifth channel of that name where asked, and an sRGB preview `png`.

        Raises
        ------
        InputError
            If `error` is asked of a picture that has none.
        """
        if error and self.error is None:
            raise InputError("error: this picture holds no estimate of it; Scene.render's do")
        extra = {"error": self.error} if error and self.error is not None else None
        write_exr(path, self.image, {"prtcl": str(self.report.get("settings", ""))}, extra)
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
    leave_out : names of `prtcl.transport.leave_out`, or a list of them such as "all", "none", "no-grey"; None is all
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
        leave_out: str | Iterable[str] | None = None,
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
        self._by_hand: dict[str, float | str | frozenset[str] | None] = dict(settings)
        if leave_out is not None:
            self._by_hand["leave_out"] = (
                parse(leave_out) if isinstance(leave_out, str) else frozenset(leave_out)
            )
        self.fitted: dict[int, float] = {}
        self.settings = self.choose_settings(vertex=self.bake is not None)
        with self.device.profile.host("build_bvh"):
            self.tracer = Tracer(self.mesh.vertices, self.mesh.faces)

    def choose_settings(self, vertex: bool) -> list[tuple[Settings, str]]:
        """What every material needs at vertices or pixels, with what was fixed by hand on top, and why."""
        baked = None if self.bake is None else self.bake.rays
        return [settle(material, vertex, baked, self._by_hand) for material in self.materials]

    def render(
        self, *, points: str = "pixel", samples: int | None = None, error: float | None = None,
        plan: Plan | None = None, progress: Notify | None = None,
    ) -> Render:  # fmt: skip
        """The image.

        Parameters
        ----------
        points : "pixel" computes radiance at what each pixel sees; "vertex" at the mesh's vertices, between
            which it is interpolated. A bake always renders its vertices.
        samples : N × N sub-pixel points a pixel; None adapts, from 2 × 2 up to 64 × 64
        error : relative RMSE to aim for: the fastest settings that meet it are found by a pilot, and pixels get
            points until audits find the image there (`prtcl.scene.planner`, `prtcl.scene.steer`)
        plan : settings found before, by `plan` or in a `Render`, in place of finding them
        progress : called with (points done, points known of so far), from worker threads

        Raises
        ------
        InputError
            If `points`, `samples` or `error` is out of range, if nothing meets the error, or the plan is of another
            scene.
        """
        if points not in ("pixel", "vertex"):
            raise InputError(f"points: expected pixel or vertex, got {points!r}")
        if samples is not None and not 1 <= samples <= 64:
            raise InputError(f"samples: expected 1 to 64 points along a pixel's side, got {samples}")
        if samples is not None and error is not None:
            raise InputError(
                "samples and error: points are fixed by the one or sought for the other; give one"
            )
        start, given = time.perf_counter(), plan
        check_eye(self.tracer, self.mesh, self.camera)
        vertex = points == "vertex" or self.bake is not None
        if plan is None and error is not None:
            plan = self._plan(error, vertex)
        for device in self.devices:  # what follows is the picture's alone
            device.profile.reset()
        rays = self.tracer.rays
        by_hand = samples is not None
        if plan is None:  # settings that no error was asked of have no level that a material could do without
            self.settings, self.fitted = self.choose_settings(vertex), {}
        else:
            planned = self._planned(plan, vertex)
            by_hand |= planned != list(plan.settings)
            self.settings, self.fitted = self._without_fine_levels(planned, plan.asked)
        each = [pipelines(self, [own for own, _ in self.settings], device) for device in self.devices]
        pipeline: Pipelines | Several = each[0] if len(each) == 1 else Several(each)
        count = Counter(progress)
        layers = self._layers(pipeline, count, vertex)
        exposure = Exposure(self.device, self.tracer, self.camera)
        for layer in layers:
            exposure.begin(layer, layer.first if samples is None else samples**2)
        steered = None
        if samples is None and plan is not None and not plan.steered and not vertex:
            steered = steer(
                exposure, layers, plan.asked, plan.bias, plan.bias_uncertain, self.settings[0][0].hard_error
            )
            plan = audited(plan, steered)
        elif samples is None:
            # One number for the whole image: sharp highlights, where there are any, make most of its error.
            exposure.refine(layers, max(own.pixel_error for own, _ in self.settings))
            exposure.complete(layers)
        rays = self.tracer.rays - rays
        report = render_report(self, pipeline, layers, count, vertex, rays, time.perf_counter() - start)
        if plan is not None:
            # A plan from before whose picture was audited is doubted no more than one of this picture.
            doubt = plan.doubt(self.names, by_hand) if given is plan else None
            report["plan"] = {
                **plan.summary(),
                "audits": 0 if steered is None else steered.audits,
                "doubt": self._missed(pipeline) or doubt,
            }
            if given is None:
                report["seconds"]["pilot"] = round(plan.pilot_seconds, 4)
        width, height = self.camera.size
        picture = colours(layers)
        error_picture = expected_error(layers, picture, plan)
        return Render(
            picture.reshape(height, width, 4).astype(np.float32),
            report,
            error_picture.reshape(height, width),
            plan,
        )

    def _missed(self, pipeline: Pipelines | Several) -> str | None:
        """What neither pilot nor audits are sure to see, in words."""
        alpha = min(own.roughness for own in self.materials)
        if alpha < SHARP and len(pipeline.light.hard):
            return f"highlights of alpha {alpha:.2g} may fall between the points that would tell"
        return None

    @property
    def names(self) -> dict[str, Any]:
        """What a plan says that it was made for."""
        return {
            "mesh": self.mesh.name,
            "environment": self.environment.name,
            "materials": [own.spec for own in self.materials],
        }

    def plan(self, error: float, *, points: str = "pixel") -> Plan:
        """The fastest settings that meet a relative RMSE, as a pilot finds them: `prtcl.scene.planner`.

        Raises
        ------
        InputError
            If `error` is not between 0 and 1, or nothing meets it.
        """
        check_eye(self.tracer, self.mesh, self.camera)
        return self._plan(error, points == "vertex" or self.bake is not None)

    def _plan(self, error: float, vertex: bool) -> Plan:
        check_error(error)
        base = [own for own, _ in self.choose_settings(vertex)]
        fixed = {name for name, value in self._by_hand.items() if value is not None}
        return (plan_vertices if vertex else plan_pixels)(self, error, base, fixed)

    def _without_fine_levels(
        self, settings: list[Settings], asked: float
    ) -> tuple[list[tuple[Settings, str]], dict[int, float]]:
        """A plan's settings without the levels of the product that a material has no use for, at the error asked for.

        Returns
        -------
        settings : and why
        lost : what leaving levels out may cost, by material, where any were
        """
        out: list[tuple[Settings, str]] = []
        lost: dict[int, float] = {}
        for number, own in enumerate(settings):
            keep = own.keep
            if own.leaves("levels") and self._by_hand.get("keep") is None:
                keep, without = needed(self.device, self.materials[number], own.keep, FITTED * asked)
                if keep < own.keep:
                    lost[number] = without
            out.append((replace(own, keep=keep), f"planned for an error of {asked:g}"))
        return out, lost

    def _planned(self, plan: Plan, vertex: bool) -> list[Settings]:
        """A plan's settings with what was fixed by hand on top."""
        if plan.points != ("vertex" if vertex else "pixel") or len(plan.settings) != len(self.materials):
            raise InputError(
                f"plan: made for the {plan.points} points of {len(plan.settings)} materials, got "
                f"{'vertex' if vertex else 'pixel'} points of {len(self.materials)}; make one for this scene"
            )
        return [own.with_defaults(**self._by_hand) for own in plan.settings]

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
            layers.append(Layer(Film(self.camera.size), shader, self.settings[0][0].hard_points, MOST_HARD))
            share = self.settings[0][0].hard_error
            layers = [
                replace(layer, share=own) for layer, own in zip(layers, (1 - share, share), strict=True)
            ]
        return layers

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

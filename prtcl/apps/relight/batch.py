"""A batch as the command line asks for it: mesh, lights, materials and views read, and its manifest."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any

from prtcl._version import __version__
from prtcl.apps.bake_options import read_bake
from prtcl.apps.relight import inputs, names
from prtcl.apps.relight.checks import check_options, refuse_inputs
from prtcl.apps.relight.manifest import MANIFEST, common, manifest_of
from prtcl.compute import tuning
from prtcl.compute.device import Device
from prtcl.factors.material import Material
from prtcl.scene.bake import Bake, is_bake
from prtcl.scene.camera import Camera, Triple
from prtcl.scene.camera_path import View, read_views, turntable
from prtcl.scene.engine_choice import BATCH, Choice, choose_engine
from prtcl.scene.factorization import FACTORIZATIONS, SAMPLES, engine_for
from prtcl.scene.frames_engine import Engine, with_rotation
from prtcl.scene.frames_looks import Looks
from prtcl.scene.frames_view import NOT_TAKEN, serves
from prtcl.scene.kept_visibility import KeptVisibility
from prtcl.scene.mesh import Mesh, read_mesh
from prtcl.scene.plan_frames import FramesPlan, plan_frames
from prtcl.scene.scene import Scene, read_environment
from prtcl.scene.view_points import SIDE


@dataclass(frozen=True, eq=False)
class Batch:
    """What is to be made of what.

    Attributes
    ----------
    source : the mesh, smooth if it was asked for, or a bake
    settings : fixed by hand, as `prtcl.scene.frames.relight` takes them
    manifest : of its folder; `inputs` in it is all that the images depend on
    notes : for people
    choice : why the factorization is what it is, and its engine where one was tried
    kept : where visibility is kept, if anywhere
    """

    source: Mesh | Bake
    lights: list[Path]
    rotations: list[float]
    materials: list[Material | None]
    views: list[View]
    points: str
    samples: int
    factorization: str
    settings: dict[str, Any]
    manifest: dict[str, Any]
    notes: list[str]
    choice: Choice
    kept: KeptVisibility | None

    def engine(self, device: Device, two_sided: bool) -> Engine:
        """What computes the images: that of the trial where there was one, otherwise a new one."""
        return self.choice.engine or engine_for(
            self.source, self.materials, device, points=self.points, samples=self.samples,
            factorization=self.factorization, two_sided=two_sided, kept=self.kept, **self.settings,
        )  # fmt: skip


def read(
    options: argparse.Namespace, device: Device, note: Callable[[str], object] | None = None,
    materials: list[Material | None] | None = None,
) -> Batch:  # fmt: skip
    """Everything but the pixels of the lights, which are read as they are needed.

    Parameters
    ----------
    note : called with what becomes of kept visibility
    materials : read already, no two of one SPEC; None reads those of the options

    Raises
    ------
    InputError
        If something is wrong with an option or a file.
    """
    check_options(options)
    lights = inputs.environments(options.env)
    if materials is None:
        given = dict.fromkeys(options.brdf or [None])
        materials = [None if spec is None else Material.parse(spec) for spec in given]
    rotations = list(dict.fromkeys(chain.from_iterable(options.env_rotate or [[0.0]])))
    if is_bake(options.mesh):
        source: Mesh | Bake = read_bake(options.mesh, options.rays, options.smooth)
        mesh, bits = source.mesh, source.bits  # type: ignore[union-attr]
    else:
        mesh, bits = read_mesh(options.mesh), None
        source = mesh = mesh.smooth() if options.smooth else mesh
    keep = options.keep_visibility
    kept = None if keep is None else KeptVisibility(keep, mesh, note)
    views, notes = views_of(options, mesh)
    settings = {
        "levels": options.levels, "rays": options.rays, "keep": options.keep, "views": options.views,
        "method": options.method, "hard": options.hard_light, "visibility": options.visibility,
    }  # fmt: skip
    samples, expected = options.samples, {}
    if options.error is not None:
        plan = planned(options, device, mesh, lights[0], rotations[0], materials, views[0], settings)
        settings["rays"], samples = plan.rays, plan.samples
        expected = {"error": {"asked": plan.asked, "predicted": plan.predicted}}
        notes = [
            *notes,
            f"{samples} x {samples} points a pixel, 4^{plan.rays} rays: images are expected to err by "
            f"{100 * plan.predicted:.2g} %",
        ]
    points = "vertex" if isinstance(source, Bake) else options.points or "pixel"
    light_names = names.unique(names.plain(path.stem) for path in lights)
    light_digests = [inputs.file_digest(path) for path in lights]
    specs = [(m.spec if m is not None else "own") for m in materials]
    view_names = names.unique(names.plain(view.name) for view in views)
    plain = {
        "version": __version__, "embreex": version("embreex"),
        "mesh": inputs.mesh_digest(mesh, bits),
        "environments": list(zip(light_names, light_digests, strict=True)),
        "rotations": rotations,
        "materials": [(spec, inputs.material_digest(m)) for spec, m in zip(specs, materials, strict=True)],
        "cameras": [(name, vars(view.camera)) for name, view in zip(view_names, views, strict=True)],
        "points": points, "env-up": options.env_up, "repair": options.repair,
        "one-sided": options.one_sided, "png": options.png, "exposure": options.exposure if options.png else None,
        **settings, "precision": options.precision,
        "device": f"{device.name}, driver {device.driver}", "kernels": tuning.forms_of(device),
    }  # fmt: skip

    def made_by(factorization: str) -> dict[str, Any]:
        """All that the images depend on."""
        usual = SAMPLES if factorization == "light" else SIDE
        own = {"factorization": factorization, "samples": usual if samples is None else samples}
        return dict(inputs.as_json({**plain, **own}))

    choice = Choice(options.factorization, "asked for")
    if choice.factorization == "auto":
        before = chosen_before(Path(options.output), made_by)
        if before is None:
            choice = choose(
                options, device, mesh, lights, rotations, materials, views, points, samples, settings, kept
            )
        else:
            choice, then = before
            if choice.factorization == "light" and then < MANY <= len(lights) * len(rotations):
                notes = [
                    *notes, f"{options.output} was begun with {then} lights, one by one, and goes on so\n"
                    "for many lights another folder (-o) may take less time: the order that suits them is tried there",
                ]  # fmt: skip
    factorization = choice.factorization
    made_of = made_by(factorization)
    manifest = manifest_of(made_of, lights, expected)
    refuse_inputs(Path(options.output), manifest, [*lights, Path(options.mesh)])
    return Batch(
        source, lights, rotations, materials, views, points, made_of["samples"], factorization, settings, manifest,
        [*mesh.notes, *notes], choice, kept,
    )  # fmt: skip


def planned(
    options: argparse.Namespace, device: Device, mesh: Mesh, light: Path, rotation: float,
    materials: list[Material | None], view: View, settings: dict[str, Any],
) -> FramesPlan:  # fmt: skip
    """Rays and points for --error, found under one light from one view."""
    environment, _ = read_environment(light, rotate=rotation, up=options.env_up, repair=options.repair)
    scenes = [
        Scene(mesh, environment, own, view.camera, device=device, two_sided=not options.one_sided, **settings)
        for own in materials
    ]
    return plan_frames(scenes, options.error)


MANY = 10
"""Lights from which it is worth trying both factorizations."""


def chosen_before(output: Path, made_by: Callable[[str], dict[str, Any]]) -> tuple[Choice, int] | None:
    """What a run of this job that was interrupted chose, or of the same job with other lights, and of how many.

    Time is no input.
    """
    try:
        was = json.loads((output / MANIFEST).read_bytes())["inputs"]
        chosen = was["factorization"]
        if chosen in FACTORIZATIONS and common(made_by(chosen)) == common(was):
            lights = len(was["environments"]) * len(was["rotations"])
            return Choice(chosen, f"as the run before, of {lights} lights"), lights
    except (OSError, ValueError, RecursionError, KeyError, TypeError, AttributeError):
        pass
    return None


def choose(
    options: argparse.Namespace, device: Device, mesh: Mesh, lights: list[Path], rotations: list[float],
    materials: list[Material | None], views: list[View], points: str, samples: int | None,
    settings: dict[str, Any], kept: KeptVisibility | None,
) -> Choice:  # fmt: skip
    """The factorization of a batch, and why: tried on pixels of its first view where there are many lights."""
    count = len(lights) * len(rotations)
    if points == "vertex":
        return Choice("light", "vertices are shaded so")
    if options.error is not None:
        return Choice("light", "an --error is planned for it")
    if count < MANY:
        return Choice("light", f"{count} lights are too few for a transport of their own")
    by_hand = [name for name in NOT_TAKEN if settings[name] is not None]
    if by_hand:
        return Choice("light", f"--{by_hand[0]} is its own")
    looks = Looks(materials, mesh, **settings)
    if not serves(looks):
        return Choice("light", "a material has the mesh's own colour")
    first, _ = read_environment(lights[0], up=options.env_up, repair=options.repair)
    turned = [with_rotation(first, degrees) for degrees in rotations[:BATCH]]
    # Of all lights only the number counts; the first stands for the others.
    environments = [turned[number % len(turned)] for number in range(count)]
    return choose_engine(
        mesh, looks, device, views[0].camera, environments, views=len(views), samples=samples,
        two_sided=not options.one_sided, hard=settings["hard"] or "auto", kept=kept,
    )  # fmt: skip


def views_of(options: argparse.Namespace, mesh: Mesh) -> tuple[list[View], list[str]]:
    """The views that the options ask for, and notes."""
    up: Triple = (0.0, 0.0, 1.0) if options.env_up == "z" else (0.0, 1.0, 0.0)
    up = up if options.up is None else tuple(options.up)
    target = None if options.target is None else tuple(options.target)
    if options.cameras:
        return read_views(options.cameras, size=options.size, up=up, fov=options.fov)
    if options.turntable is not None:
        elevation = 20.0 if options.elevation is None else options.elevation
        views = turntable(
            mesh.bounds, options.turntable, elevation=elevation, target=target, up=up, fov=options.fov,
            size=options.size,
        )  # fmt: skip
        return views, []
    eye = None if options.eye is None else tuple(options.eye)
    camera = Camera.framing(mesh.bounds, eye=eye, target=target, up=up, fov=options.fov, size=options.size)
    return [View("view", camera)], []

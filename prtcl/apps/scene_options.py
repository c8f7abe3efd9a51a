"""A scene from the options that `render` and `report` share."""

from __future__ import annotations

import argparse
import sys

from prtcl.apps.bake_options import read_bake
from prtcl.compute.device import Device
from prtcl.scene.bake import is_bake
from prtcl.scene.camera import Camera
from prtcl.scene.scene import Scene, read_environment


def scene_of(options: argparse.Namespace, devices: list[Device], brdf: str | None) -> Scene:
    """The scene, with the camera that was asked for; its notes go to standard error.

    Raises
    ------
    InputError
        If mesh, environment, material or a setting cannot be used.
    """
    mesh = read_bake(options.mesh, options.rays, options.smooth) if is_bake(options.mesh) else options.mesh
    environment, notes = read_environment(
        options.env, rotate=options.env_rotate, up=options.env_up, repair=options.repair
    )
    scene = Scene(
        mesh, environment, brdf, device=devices, two_sided=not options.one_sided,
        smooth=options.smooth, levels=options.levels, rays=options.rays, keep=options.keep, views=options.views,
        method=options.method, hard=options.hard_light, visibility=options.visibility,
        leave_out=options.leave_out,
    )  # fmt: skip
    scene.notes += notes
    default_up = (0.0, 0.0, 1.0) if options.env_up == "z" else (0.0, 1.0, 0.0)
    scene.camera = Camera.framing(
        scene.mesh.bounds,
        eye=None if options.eye is None else tuple(options.eye),
        target=None if options.target is None else tuple(options.target),
        up=default_up if options.up is None else tuple(options.up),
        fov=options.fov,
        size=options.size,
    )
    for note in scene.notes:
        print(f"prtcl {options.command}: {note}", file=sys.stderr)
    return scene

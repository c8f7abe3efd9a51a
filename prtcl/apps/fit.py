"""`prtcl fit`: a bivariate table from images of a mesh."""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.files.atomic import check_not_input, check_writable
from prtcl.files.image import read_image
from prtcl.scene.camera import Camera
from prtcl.scene.fit import View, fit
from prtcl.scene.mesh import read_mesh
from prtcl.scene.scene import read_environment

KEYS = {"image", "env", "eye", "target", "up", "fov", "env_rotate"}


def run(options: argparse.Namespace) -> int:
    """Read the views, fit, save, report. The output is checked before the work."""
    check_writable(options.output)
    check_not_input(options.output, options.mesh, options.views)
    entries = read_views(options.views)
    for entry in entries:
        check_not_input(options.output, entry["image"], entry["env"])
    mesh = read_mesh(options.mesh)
    mesh = mesh.smooth() if options.smooth else mesh
    lights: dict[tuple[str, float], Any] = {}
    views: list[View] = []
    for entry in entries:
        image = read_image(entry["image"])
        key = entry["env"], entry["env_rotate"]
        if key not in lights:
            lights[key], notes = read_environment(entry["env"], rotate=entry["env_rotate"])
            for note in notes:
                print(f"prtcl fit: {note}", file=sys.stderr)
        camera = Camera(
            entry["eye"], entry["target"], entry["up"], entry["fov"], (image.shape[1], image.shape[0])
        )
        views.append((camera, lights[key], image))
    nh, nd = options.nodes
    found = fit(
        mesh, views, theta_h=np.linspace(0.0, 1.0, nh) ** 2 * (np.pi / 2),
        theta_d=np.linspace(0.0, np.pi / 2, nd), smoothness=options.smoothness, robust=not options.plain,
        levels=options.levels, samples=options.samples, device=Device(options.device),
    )  # fmt: skip
    for note in found.notes:
        print(f"prtcl fit: {note}", file=sys.stderr)
    replace(found.table, name=os.fspath(options.output)).save(options.output)
    if options.json:
        print(json.dumps(found.report(), indent=2))
    elif not options.quiet:
        print(
            f"{options.output}: {nh}x{nd} nodes of {found.pixels} pixels in {len(views)} images, residual "
            f"{100 * found.residual:.2f} %, {100 * found.determined:.0f} % of the nodes determined\n"
            f"render with --brdf table:{options.output}"
        )
    return 0


def read_views(path: str) -> list[dict[str, Any]]:
    """The JSON list of views; its files' names are relative to its own folder.

    Raises
    ------
    InputError
        Naming the file, the entry and what of it is wrong.
    """
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected a JSON list of views ({error})") from error
    if not isinstance(found, list) or not found or not all(isinstance(entry, dict) for entry in found):
        raise InputError(f"{path}: expected a JSON list of views, {{image, env, eye, target, fov, …}} each")
    folder, out = Path(path).parent, []
    for number, entry in enumerate(found, start=1):
        where = f"{path}: view {number}"
        missing, unknown = [k for k in ("image", "env", "eye", "target") if k not in entry], set(entry) - KEYS
        if missing or unknown:
            what = f"{missing[0]} is missing" if missing else f"{sorted(unknown)[0]} is unknown"
            raise InputError(f"{where}: {what}\nit takes {', '.join(sorted(KEYS))}")
        for key in ("image", "env"):
            if not isinstance(entry[key], str) or not entry[key]:
                raise InputError(f"{where}: {key} expected a file's name, got {entry[key]}")
        own: dict[str, Any] = {key: str(folder / entry[key]) for key in ("image", "env")}
        for key, default in (("eye", None), ("target", None), ("up", (0.0, 1.0, 0.0))):
            value = entry.get(key, default)
            if not isinstance(value, list | tuple) or len(value) != 3 or not all(map(_number, value)):
                raise InputError(f"{where}: {key} expected three numbers, got {value}")
            own[key] = tuple(float(x) for x in value)
        for key, degrees in (("fov", 40.0), ("env_rotate", 0.0)):
            if not _number(entry.get(key, degrees)):
                raise InputError(f"{where}: {key} expected degrees, got {entry[key]}")
            own[key] = float(entry.get(key, degrees))
        out.append(own)
    return out


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e30

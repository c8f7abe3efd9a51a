"""`prtcl report`: error against run time for a scene; HTML, PNG, SVG and JSON."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from prtcl._version import __version__
from prtcl.apps import figures
from prtcl.apps.report import measure, plots
from prtcl.apps.report.page import page
from prtcl.apps.scene_options import scene_of
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.files.atomic import check_writable, made_folder, replacing
from prtcl.scene.bake import is_bake
from prtcl.scene.plan import check_error
from prtcl.scene.scene import Scene

FORMAT = "prtcl report 1"


def run(options: argparse.Namespace) -> int:
    """Measure, draw, write.

    Raises
    ------
    InputError
        If an option or a file cannot be used, or matplotlib is missing.
    """
    if is_bake(options.mesh) or options.points == "vertex":
        raise InputError("report: measures the points of pixels; give it the mesh, without --points vertex")
    if options.samples is not None:
        raise InputError("--samples: a report tries several; leave it out")
    check_error(options.error)
    figures.require()
    folder = made_folder(options.output)
    check_writable(folder / "report.html")
    device = Device(options.device, precision=options.precision)
    result: dict[str, Any] = {}
    drawn = []
    for number, brdf in enumerate(options.brdf or [None]):
        scene = scene_of(options, [device], brdf)
        result = result or _about(scene, device, options)
        if not options.quiet:
            print(f"prtcl report: {brdf or 'the mesh’s materials'} …", file=sys.stderr, flush=True)
        told, image, error = measure.material(scene, options.error)
        result["materials"].append(told)
        own = {
            "settings": plots.settings(told), "error": plots.error_picture(image, error),
            "factors": plots.factors(told), "stages": plots.stages(told),
        }  # fmt: skip
        figures.save({f"{name}_{number + 1}": figure for name, figure in own.items()}, folder)
        drawn.append(own)
    with replacing(folder / "report.json") as aside:
        aside.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    with replacing(folder / "report.html") as aside:
        aside.write_text(page(result, drawn), encoding="utf-8")
    if options.json:
        print(json.dumps(result, indent=1))
    elif not options.quiet:
        print(_summary(result, folder))
    return 0


def _about(scene: Scene, device: Device, options: argparse.Namespace) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "prtcl": __version__,
        "device": device.name,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "command": shlex.join(["prtcl", *_without_folders(options)]),
        "mesh": scene.mesh.name,
        "environment": Path(scene.environment.name).name,
        "size": list(options.size),
        "materials": [],
    }


def _without_folders(options: argparse.Namespace) -> list[str]:
    """The command line with files by their names alone: a report is shown to others."""
    return [
        Path(word).name if "/" in word and not word.startswith("-") else word for word in options.arguments
    ]


def _summary(result: dict[str, Any], folder: Path) -> str:
    return "\n".join([*(_line(told) for told in result["materials"]), str(folder / "report.html")])


def _line(told: dict[str, Any]) -> str:
    plan = told["plan"]
    predicted = (
        "refused; the usual settings:" if "refused" in plan else f"predicted {100 * plan['predicted']:.2g} %,"
    )
    return (
        f"{told['material']}: asked {100 * plan['asked']:.2g} %, {predicted} found {100 * plan['found']:.2g} % in "
        f"{plan['seconds']:.1f} s"
    )

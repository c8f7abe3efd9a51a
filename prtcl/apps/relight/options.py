"""The options of `prtcl relight`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any

from prtcl.apps.arguments import add_camera, add_device, add_fine, add_points, add_scheduler

MOST_ROTATIONS = 100_000
MOST_DEGREES = 36_000.0
"""A hundred turns: beyond, nobody means what is written."""


def register(commands: Any, run: Callable[[argparse.Namespace], int]) -> None:
    """Add the command, which runs `run`."""
    from prtcl.factors.material import FORMS

    command = commands.add_parser(
        "relight",
        help="many images: every environment x material x view",
        description="Images of a mesh under every environment, in every material, from every view. Interrupted, "
        "the same command makes what is missing.",
    )
    command.add_argument(
        "mesh", metavar="MESH|BAKE", help="OBJ, PLY, STL, GLB, glTF, or a bake (.npz, .zarr)"
    )
    command.add_argument(
        "--env", required=True, nargs="+", action="extend", metavar="ENV",
        help="equirectangular EXR or HDR maps, folders of them, or globs",
    )  # fmt: skip
    command.add_argument(
        "--brdf", nargs="+", action="extend", metavar="SPEC",
        help=f"{FORMS}; a number may be r/g/b (default: the mesh's glTF materials)",
    )  # fmt: skip
    command.add_argument(
        "-o", "--output", required=True, metavar="DIR", help="of the images and manifest.json"
    )
    command.add_argument(
        "--env-rotate", type=rotations, nargs="+", action="extend", metavar="DEG",
        help="turn each environment about the up axis, counter-clockwise from above: numbers, or START:STOP:STEP with "
        "both ends, but for STOP where it is a full turn from START: 0:360:90 is 0 90 180 270",
    )  # fmt: skip
    command.add_argument("--env-up", choices=("y", "z"), default="y", help="the up axis (default: y)")
    command.add_argument("--repair", action="store_true", help="replace NaN, infinite and negative radiance")
    _views(command)
    command.add_argument(
        "--samples", type=int, metavar="N",
        help="N x N sub-pixel points, traced once (default: 3, or 8 where views are factored)",
    )  # fmt: skip
    command.add_argument(
        "--factorization", choices=("auto", "light", "view"), default="auto",
        help="collapse light and visibility for each light, or visibility and reflectance for each view, which many "
        "lights then share (default: tries both where there are ten lights or more)",
    )  # fmt: skip
    command.add_argument("--explain", action="store_true", help="which factorization was chosen, and why")
    command.add_argument(
        "--error", type=float, metavar="E",
        help="relative RMSE to aim for: finds the rays and points that meet it in every material under the first light "
        "from the first view",
    )  # fmt: skip
    command.add_argument(
        "--keep-visibility", metavar="DIR",
        help="keep what each view sees, for other jobs with the same views of the same mesh (needs the extra `bake`)",
    )  # fmt: skip
    add_points(command)
    command.add_argument("--png", action="store_true", help="also 8-bit sRGB previews")
    command.add_argument(
        "--exposure", type=float, default=0.0, metavar="STOPS", help="of the previews (default: 0)"
    )
    command.add_argument(
        "--overwrite", action="store_true", help="replace the images of another job that DIR holds"
    )
    add_scheduler(
        command, "for each device, which its PRTCL_DEVICE names", "lights",
        "8, or 128 where views are factored, or fewer so that each worker has some",
    )  # fmt: skip
    add_fine(command)
    add_device(command)
    command.add_argument("--quiet", action="store_true", help="no progress bar, no summary")
    command.add_argument(
        "--json", action="store_true", help="events on standard output as they come, one JSON object a line"
    )
    command.set_defaults(run=run)


def _views(command: argparse.ArgumentParser) -> None:
    """Options that say what the images are seen from."""
    views = command.add_argument_group("views (default: one that frames the mesh)")
    views.add_argument(
        "--turntable", type=int, metavar="N", help="N views from a circle about the up axis, in equal steps"
    )
    views.add_argument(
        "--elevation",
        type=float,
        metavar="DEG",
        help="of the turntable's eye above the horizon (default: 20)",
    )
    views.add_argument(
        "--cameras", metavar="FILE",
        help="a JSON list of {eye, target[, up, fov, name]}, or the cameras of a .gltf or .glb, which bring their own "
        "field of view",
    )  # fmt: skip
    add_camera(views)


def rotations(text: str) -> list[float]:
    """Degrees of one argument: numbers between commas, or START:STOP:STEP."""
    return [degrees for part in text.split(",") for degrees in _range(part)]


def _range(text: str) -> list[float]:
    """START, START + STEP, … up to STOP; STOP itself is left out where it is START again, full turns on."""
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 3) or not all(math.isfinite(number) for number in numbers):
        raise argparse.ArgumentTypeError(
            f"expected degrees, or START:STOP:STEP such as 0:360:90, got {text!r}"
        )
    if max(map(abs, numbers)) > MOST_DEGREES:
        raise argparse.ArgumentTypeError(
            f"expected at most {MOST_DEGREES:g} degrees either way, got {text!r}"
        )
    if len(numbers) == 1:
        return numbers
    start, stop, step = numbers
    steps = (stop - start) / step if step else -1.0
    if not 0.0 <= steps < MOST_ROTATIONS:
        raise argparse.ArgumentTypeError(
            f"expected a step that leads from start to stop, {MOST_ROTATIONS} times at most, got {text!r}"
        )
    # A step of a third of a turn, written 33.333, is none: ends count as met to a millionth of a step.
    whole = math.floor(steps + 1e-6)
    turns = (stop - start) / 360.0
    closes = abs(steps - whole) < 1e-6 and whole > 0 and turns and abs(turns - round(turns)) < 1e-9
    return [start + step * number for number in range(whole if closes else whole + 1)]

"""Options that several commands share, and the types of arguments."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import Any


def add_device(command: argparse.ArgumentParser, several: bool = False) -> None:
    more = "; given again, the devices share the work" if several else ""
    command.add_argument(
        "--device",
        metavar="SPEC",
        action="append" if several else "store",
        help=f"platform or platform:device, by index or part of the name (or PRTCL_DEVICE){more}",
    )


def add_common(command: argparse.ArgumentParser) -> None:
    command.add_argument("--quiet", action="store_true", help="no progress bar, no summary")
    command.add_argument("--json", action="store_true", help="the run's report as JSON on standard output")


def add_scheduler(command: argparse.ArgumentParser, places: str, tasks: str, default: str) -> None:
    """Options that spread a command over machines.

    Parameters
    ----------
    places : what has a worker each, in words
    tasks : what a task takes several of, which its worker's death costs
    default : how many, in words
    """
    many = command.add_argument_group(
        "many machines (Dask.distributed: pip install 'prtcl[cluster]'; see docs/cluster.md)"
    )
    many.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT",
        help="have the workers of this scheduler do it: `dask scheduler` on one machine, then `dask worker "
        f"tcp://HOST:PORT --nthreads 1 --memory-limit 0` {places}; the result is the same, byte for byte (default: "
        "this process does it)",
    )  # fmt: skip
    many.add_argument(
        "--chunk", type=whole(1), metavar="N",
        help=f"{tasks} that a worker takes at once, and that have to be made again where it dies (default: {default})",
    )  # fmt: skip


def add_scene(
    command: argparse.ArgumentParser, several: bool = False, pixels: tuple[int, int] = (512, 512)
) -> None:
    """Options that say what is rendered and how finely.

    Parameters
    ----------
    several : whether --brdf takes more than one
    pixels : --size by default
    """
    from prtcl.factors.material import FORMS

    more: dict[str, Any] = {"nargs": "+", "action": "extend"} if several else {}
    command.add_argument(
        "--brdf", metavar="SPEC", **more,
        help=f"{FORMS}; a number may be r/g/b (default: the mesh's glTF materials)",
    )  # fmt: skip
    command.add_argument("--env-rotate", type=float, default=0.0, metavar="DEG",
                         help="turn the environment about the up axis, counter-clockwise from above")  # fmt: skip
    command.add_argument(
        "--env-up", choices=("y", "z"), default="y", help="the environment's up axis (default: y)"
    )
    command.add_argument("--repair", action="store_true", help="replace NaN, infinite and negative radiance")
    add_camera(command, pixels)
    command.add_argument("--samples", type=int, metavar="N", help="N x N sub-pixel points (default: adapts)")
    add_points(command)
    add_fine(command, "; see --explain").add_argument(
        "--leave-out", metavar="LIST",
        help="what the scene does not need: all, none, or names such as grey,rays or no-grey (default: all; see "
        "--explain)",
    )  # fmt: skip
    command.add_argument("--explain", action="store_true", help="what was chosen and left out, and why")


def add_camera(command: Any, pixels: tuple[int, int] = (512, 512)) -> None:
    """A view, to a parser or a group of one; `pixels` is --size by default."""
    for name in ("eye", "target", "up"):
        command.add_argument(f"--{name}", nargs=3, type=float, metavar=("X", "Y", "Z"))
    command.add_argument("--fov", type=float, default=40.0, metavar="DEG", help="horizontal (default: 40)")
    command.add_argument(
        "--size", type=size, default=pixels, metavar="WxH", help=f"pixels (default: {pixels[0]}x{pixels[1]})"
    )


def add_points(command: argparse.ArgumentParser) -> None:
    """Where radiance is computed, and on which side of what normals."""
    command.add_argument(
        "--points",
        choices=("pixel", "vertex"),
        help="where radiance is computed (default: pixel; vertex for a bake)",
    )
    command.add_argument("--one-sided", action="store_true", help="surfaces seen from behind are black")
    command.add_argument("--smooth", action="store_true", help="vertex normals averaged over the faces")


def add_fine(command: argparse.ArgumentParser, more: str = "") -> Any:
    fine = command.add_argument_group(f"resolution by hand (default: what the materials need{more})")
    fine.add_argument("--levels", type=int, metavar="R", help="light and product on 4^R directions")
    fine.add_argument("--rays", type=int, metavar="R", help="visibility on 4^R directions")
    fine.add_argument("--keep", type=int, metavar="K", help="levels kept of the product")
    fine.add_argument("--views", type=int, metavar="N", help="view angles stored for each material")
    fine.add_argument(
        "--method", choices=("auto", "pixel", "tree"), help="how light and visibility are multiplied"
    )
    fine.add_argument("--hard-light", choices=("auto", "off"), help="take the light's peaks out of the map")
    fine.add_argument(
        "--visibility", choices=("adaptive", "every"), help="rays where neighbours disagree, or all of them"
    )
    fine.add_argument("--precision", choices=("float32", "mixed", "float64"), default="float32")
    return fine


def add_plan(command: argparse.ArgumentParser) -> None:
    """Options that say how large the error may be."""
    plan = command.add_argument_group("error (default: what bench/accuracy.py found settings good for)")
    plan.add_argument(
        "--error", type=float, metavar="E",
        help="relative RMSE to aim for: finds the fastest settings that meet it",
    )  # fmt: skip
    plan.add_argument("--save-plan", metavar="FILE.json", help="keep what was found")
    plan.add_argument("--plan", metavar="FILE.json", help="use what was found before")


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() and 0 < int(part) <= 16384 for part in parts):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT in pixels such as 640x480, got {text!r}")
    return int(parts[0]), int(parts[1])


def whole(least: int, most: int | None = None) -> Callable[[str], int]:
    """A type of argument: whole numbers of a range."""

    def whole(text: str) -> int:
        value = int(text) if re.fullmatch(r"[0-9]{1,9}", text) else least - 1
        if value < least or (most is not None and value > most):
            up_to = "or more" if most is None else f"to {most}"
            raise argparse.ArgumentTypeError(f"expected a whole number, {least} {up_to}, got {text!r}")
        return value

    return whole


def nodes(text: str) -> tuple[int, int]:
    """Nodes of theta_h and theta_d; the fit solves for all at once, so that there are few thousand."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() and 2 <= int(part) <= 512 for part in parts):
        raise argparse.ArgumentTypeError(f"expected two numbers of nodes such as 45x23, got {text!r}")
    if int(parts[0]) * int(parts[1]) > 6000:
        raise argparse.ArgumentTypeError(f"expected at most 6000 nodes together, got {text}")
    return int(parts[0]), int(parts[1])


def gibibytes(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"expected GiB of memory, above 0, got {text!r}")
    return value

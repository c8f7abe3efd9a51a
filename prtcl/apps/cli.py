"""The command line: `prtcl demo | render | relight | bake | fit | view | brdf | bench | report | stress | devices`.

Exit status: 0 done, 1 the job failed, 2 the input or the command line was wrong. An error is one or two lines that
name the file or the option and say what to do.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any, NoReturn

from prtcl._version import __version__
from prtcl.apps.relight import options as relight
from prtcl.errors import InputError, PrtclError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    command = "prtcl"
    try:
        with deferred_interrupts():
            options = parser().parse_args(arguments)
            options.arguments = list(sys.argv[1:] if arguments is None else arguments)
        command = f"prtcl {options.command}"
        status: int = options.run(options)
        return status
    except PrtclError as error:
        print(f"{command}: {error}", file=sys.stderr)
        return error.exit_status
    except MemoryError as error:
        print(f"{command}: out of memory {error}; use fewer --levels or a smaller --size",
              file=sys.stderr)  # fmt: skip
        return 1
    except KeyboardInterrupt:
        print(f"{command}: interrupted; no output was left half written", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of our output (head, a pager) went away; keep the interpreter from complaining at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if os.environ.get("PRTCL_DEBUG"):
            raise
        if type(error).__module__.startswith("pyopencl"):
            print(
                f"{command}: the OpenCL device failed: {str(error).splitlines()[0]}\n"
                "try another --device, fewer --levels or a smaller --size; PRTCL_DEBUG=1 shows more",
                file=sys.stderr,
            )
            return 1
        print(
            f"{command}: {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}\n"
            "this is a bug in prtcl or its OpenCL driver; PRTCL_DEBUG=1 shows the traceback",
            file=sys.stderr,
        )
        return 1


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Hold Ctrl-C back until the block ends, for imports: some libraries catch whatever is raised within theirs.

    The second Ctrl-C is raised at once. Only Python's own handler is replaced: a job in the background ignores
    Ctrl-C, an application may have another answer to it, and threads but the main one may not change it.
    """
    main_thread = threading.current_thread() is threading.main_thread()
    if not main_thread or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    came = False

    def note(*_: object) -> None:
        nonlocal came
        if came:
            raise KeyboardInterrupt
        came = True

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if came:
            raise KeyboardInterrupt


class Parser(argparse.ArgumentParser):
    """Errors of two lines, without the usage of some thirty options before them."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        # What starts like a negative number is one: argparse takes -1e-3 for an option.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\nsee {self.prog} --help\n")


def parser() -> Parser:
    """The parser of all commands."""
    top = Parser(
        prog="prtcl",
        description="All-frequency relighting and material editing with 2D Haar wavelets on OpenCL.",
    )
    top.add_argument("--version", action="version", version=f"prtcl {__version__}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="a self-contained first run: its own scene, sky and materials")
    demo.add_argument("-o", "--output", default="demo-output", metavar="DIR", help="(default: %(default)s)")
    demo.add_argument(
        "--size", type=size, default=(288, 216), metavar="WxH", help="pixels (default: 288x216)"
    )
    _device(demo)
    _common(demo)
    demo.set_defaults(run=_demo)

    render = commands.add_parser("render", help="an image of a mesh under an environment")
    render.add_argument("mesh", metavar="MESH|BAKE", help="OBJ, PLY, STL, GLB, glTF, or a bake (.npz)")
    render.add_argument("--env", required=True, metavar="ENV", help="equirectangular EXR or HDR map")
    render.add_argument("-o", "--output", required=True, metavar="OUT.exr")
    render.add_argument(
        "--png", nargs="?", const="", metavar="FILE", help="also an 8-bit sRGB preview (default: OUT.png)"
    )
    render.add_argument(
        "--exposure", type=float, default=0.0, metavar="STOPS", help="of the preview (default: 0)"
    )
    render.add_argument(
        "--error-channel", action="store_true", help="write each pixel's expected error as a fifth channel"
    )
    _scene(render)
    _plan(render)
    _device(render, several=True)
    _common(render)
    render.set_defaults(run=_render)

    relight.register(commands, size, _fine, _device, _common, _relight)

    bake = commands.add_parser("bake", help="trace the visibility of a mesh's vertices once, for reuse")
    bake.add_argument("mesh", metavar="MESH")
    bake.add_argument("-o", "--output", required=True, metavar="BAKE.npz")
    bake.add_argument(
        "--rays", type=int, default=5, metavar="R", help="4^R rays a vertex (default: %(default)s)"
    )
    bake.add_argument("--smooth", action="store_true", help="vertex normals averaged over the faces")
    _common(bake)
    bake.set_defaults(run=_bake)

    _fit_parser(commands)
    _view_parser(commands)
    _brdf_parser(commands)
    _bench_parser(commands)
    _report_parser(commands)
    _stress_parser(commands)

    devices = commands.add_parser("devices", help="what OpenCL sees, which is used, why")
    devices.add_argument("--device", metavar="SPEC", help="see what a SPEC would choose")
    devices.add_argument("--json", action="store_true")
    devices.set_defaults(run=_devices)
    return top


def _fit_parser(commands: Any) -> None:
    fit = commands.add_parser("fit", help="a bivariate table from images of a mesh")
    fit.add_argument("mesh", metavar="MESH", help="OBJ, PLY, STL, GLB or glTF, of one material")
    fit.add_argument(
        "--views", required=True, metavar="VIEWS.json",
        help="a list of {image, env, eye, target[, up, fov, env_rotate]}: EXR images as `render` writes them, "
        "files relative to the list's folder",
    )  # fmt: skip
    fit.add_argument("-o", "--output", required=True, metavar="TABLE.npz", help="for --brdf table:TABLE.npz")
    fit.add_argument(
        "--nodes", type=_nodes, default=(45, 23), metavar="NHxND",
        help="of theta_h, at equal steps of its root, and of theta_d (default: 45x23)",
    )  # fmt: skip
    fit.add_argument(
        "--smoothness", type=float, default=1.0, metavar="S", help="larger is smoother (default: 1)"
    )
    fit.add_argument("--plain", action="store_true", help="weigh all pixels alike, outliers too")
    fit.add_argument(
        "--samples",
        type=_whole(1),
        default=2500,
        metavar="N",
        help="pixels of an image, at most (default: 2500)",
    )
    fit.add_argument(
        "--levels", type=_whole(2, 8), default=6, metavar="R", help="light on 4^R directions (default: 6)"
    )
    fit.add_argument("--smooth", action="store_true", help="vertex normals averaged over the faces")
    _device(fit)
    _common(fit)
    fit.set_defaults(run=_fit)


def _view_parser(commands: Any) -> None:
    from prtcl.factors.material import FORMS

    view = commands.add_parser("view", help="edit materials and light in the browser")
    view.add_argument("mesh", metavar="MESH|BAKE", help="OBJ, PLY, STL, GLB, glTF, or a bake (.npz)")
    view.add_argument(
        "--env", required=True, nargs="+", action="extend", metavar="ENV",
        help="equirectangular EXR or HDR maps, or folders of them: what the page may choose from",
    )  # fmt: skip
    view.add_argument(
        "-o",
        "--output",
        default=".",
        metavar="DIR",
        help="where the page saves (default: the current folder)",
    )
    view.add_argument("--brdf", metavar="SPEC", help=f"first material: {FORMS} (default: the mesh's own)")
    view.add_argument("--env-rotate", type=float, default=0.0, metavar="DEG", help="(default: 0)")
    view.add_argument("--env-up", choices=("y", "z"), default="y", help="the up axis (default: y)")
    view.add_argument("--repair", action="store_true", help="replace NaN, infinite and negative radiance")
    view.add_argument("--smooth", action="store_true", help="vertex normals averaged over the faces")
    view.add_argument(
        "--size",
        type=size,
        default=(1280, 800),
        metavar="WxH",
        help="of a picture at most (default: 1280x800)",
    )
    view.add_argument(
        "--levels", type=int, metavar="R",
        help="light and product on 4^R directions (default: 6, or what the device's memory holds)",
    )  # fmt: skip
    view.add_argument("--rays", type=int, metavar="R", help="visibility on 4^R directions (default: 5)")
    view.add_argument(
        "--error",
        type=float,
        metavar="E",
        help="relative RMSE to aim for: finds the levels and rays that meet it (default: --levels and --rays as they "
        "are, and cuts of 0.01; 0 takes every sample)",
    )
    view.add_argument(
        "--host", default="127.0.0.1", help="address to listen at (default: 127.0.0.1, this machine only)"
    )
    view.add_argument("--port", type=int, default=8080, help="0 takes any that is free (default: 8080)")
    view.add_argument("--open", action="store_true", help="open the page in the browser")
    view.add_argument("--quiet", action="store_true", help="no progress bar, no address")
    _device(view)
    view.set_defaults(run=_view)


def _brdf_parser(commands: Any) -> None:
    brdf = commands.add_parser(
        "brdf", help="what a material is like: albedo, extent, errors, plots; converts files"
    )
    brdf.add_argument(
        "material",
        metavar="FILE|SPEC",
        help="a measured BRDF (.binary, .bsdf, .bin), a table (.npz), or a --brdf SPEC",
    )
    brdf.add_argument("-o", "--output", metavar="DIR", help="plots, which take matplotlib (default: none)")
    brdf.add_argument(
        "--write",
        metavar="FILE",
        help="convert: two angles to a table (.npz), three angles to MERL's layout (.binary)",
    )
    brdf.add_argument("--quiet", action="store_true", help="no summary")
    brdf.add_argument("--json", action="store_true", help="the summary as JSON on standard output")
    brdf.set_defaults(run=_brdf)


def _bench_parser(commands: Any) -> None:
    bench = commands.add_parser(
        "bench", help="how fast every stage is, against this device's limits and other programs"
    )
    bench.add_argument(
        "--points", type=_whole(1), nargs="+", default=[40000], metavar="N",
        help="points; several give the curve of time against points (default: 40000)",
    )  # fmt: skip
    bench.add_argument(
        "--levels", type=_whole(2, 9), nargs="+", default=[5, 6], metavar="R",
        help="4^R directions, 2 to 9 (default: 5 6)",
    )  # fmt: skip
    bench.add_argument(
        "--channels", type=int, choices=(1, 3), nargs="+", default=[3], help="of the light (default: 3)"
    )
    bench.add_argument("--stages", nargs="+", metavar="NAME", help="only these (default: all)")
    bench.add_argument(
        "--memory", type=_gibibytes, metavar="GIB",
        help="of a stage's buffers; more points go in parts (default: a quarter of the device's)",
    )  # fmt: skip
    bench.add_argument(
        "--runs", type=_whole(5), default=5, metavar="N", help="timed runs, 5 at least (default: 5)"
    )
    bench.add_argument(
        "--rivals", action="store_true", help="other programs at the same work, in the same run"
    )
    bench.add_argument(
        "--compare", metavar="OLD.json", help="an earlier bench.json; exit status 1 if a stage became slower"
    )
    bench.add_argument(
        "--tune", action="store_true", help="first time every form of each kernel here, and keep the fastest"
    )
    bench.add_argument("-o", "--output", metavar="DIR", help="bench.json, bench.md and plots (default: none)")
    bench.add_argument("--no-plots", action="store_true", help="write no plots, which take matplotlib")
    _device(bench)
    bench.add_argument("--quiet", action="store_true", help="no table")
    bench.add_argument(
        "--json", action="store_true", help="the result as JSON on standard output, and no table"
    )
    bench.set_defaults(run=_bench)


def _report_parser(commands: Any) -> None:
    report = commands.add_parser("report", help="error against run time for a scene, material by material")
    report.add_argument("mesh", metavar="MESH", help="OBJ, PLY, STL, GLB, glTF")
    report.add_argument("--env", required=True, metavar="ENV", help="equirectangular EXR or HDR map")
    report.add_argument(
        "-o", "--output", required=True, metavar="DIR", help="report.html, report.json, and plots"
    )
    report.add_argument(
        "--error", type=float, default=0.02, metavar="E", help="that the plan aims for (default: %(default)s)"
    )
    _scene(report, several=True, pixels=(256, 256))
    _device(report)
    _common(report)
    report.set_defaults(run=_report)


def _stress_parser(commands: Any) -> None:
    stress = commands.add_parser(
        "stress", help="numerical stability: stiff and extreme cases against float64, with their bounds"
    )
    stress.add_argument("--cases", nargs="+", metavar="NAME", help="only these (default: all)")
    stress.add_argument(
        "--precision", nargs="+", choices=("float32", "mixed", "float64"),
        help="of the device (default: all that it has)",
    )  # fmt: skip
    stress.add_argument(
        "--levels", type=_whole(3, 9), default=9, metavar="R",
        help="of the deepest tree, 3 to 9 (default: %(default)s)",
    )  # fmt: skip
    stress.add_argument(
        "--points", type=_whole(2), default=1_000_000, metavar="N",
        help="points of identical data (default: %(default)s)",
    )  # fmt: skip
    stress.add_argument(
        "-o", "--output", metavar="DIR", help="stress.json, stress.md and plots (default: none)"
    )
    stress.add_argument("--no-plots", action="store_true", help="write no plots, which take matplotlib")
    _device(stress)
    stress.add_argument("--quiet", action="store_true", help="no table")
    stress.add_argument("--markdown", action="store_true", help="the table as Markdown on standard output")
    stress.add_argument(
        "--json", action="store_true", help="the result as JSON on standard output, and no table"
    )
    stress.set_defaults(run=_stress)


def _whole(least: int, most: int | None = None) -> Callable[[str], int]:
    """A type of argument: whole numbers of a range."""

    def whole(text: str) -> int:
        value = int(text) if re.fullmatch(r"[0-9]{1,9}", text) else least - 1
        if value < least or (most is not None and value > most):
            up_to = "or more" if most is None else f"to {most}"
            raise argparse.ArgumentTypeError(f"expected a whole number, {least} {up_to}, got {text!r}")
        return value

    return whole


def _nodes(text: str) -> tuple[int, int]:
    """Nodes of theta_h and theta_d; the fit solves for all at once, so that there are few thousand."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() and 2 <= int(part) <= 512 for part in parts):
        raise argparse.ArgumentTypeError(f"expected two numbers of nodes such as 45x23, got {text!r}")
    if int(parts[0]) * int(parts[1]) > 6000:
        raise argparse.ArgumentTypeError(f"expected at most 6000 nodes together, got {text}")
    return int(parts[0]), int(parts[1])


def _gibibytes(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"expected GiB of memory, above 0, got {text!r}")
    return value


def _device(command: argparse.ArgumentParser, several: bool = False) -> None:
    more = "; given again, the devices share the work" if several else ""
    command.add_argument(
        "--device",
        metavar="SPEC",
        action="append" if several else "store",
        help=f"platform or platform:device, by index or part of the name (or PRTCL_DEVICE){more}",
    )


def _common(command: argparse.ArgumentParser) -> None:
    command.add_argument("--quiet", action="store_true", help="no progress bar, no summary")
    command.add_argument("--json", action="store_true", help="the run's report as JSON on standard output")


def _scene(
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
    for name in ("eye", "target", "up"):
        command.add_argument(f"--{name}", nargs=3, type=float, metavar=("X", "Y", "Z"))
    command.add_argument("--fov", type=float, default=40.0, metavar="DEG", help="horizontal (default: 40)")
    command.add_argument(
        "--size", type=size, default=pixels, metavar="WxH", help=f"pixels (default: {pixels[0]}x{pixels[1]})"
    )
    command.add_argument("--samples", type=int, metavar="N", help="N x N sub-pixel points (default: adapts)")
    command.add_argument(
        "--points",
        choices=("pixel", "vertex"),
        help="where radiance is computed (default: pixel; vertex for a bake)",
    )
    command.add_argument("--one-sided", action="store_true", help="surfaces seen from behind are black")
    command.add_argument("--smooth", action="store_true", help="vertex normals averaged over the faces")
    _fine(command, "; see --explain").add_argument(
        "--leave-out", metavar="LIST",
        help="what the scene does not need: all, none, or names such as grey,rays or no-grey (default: all; see "
        "--explain)",
    )  # fmt: skip
    command.add_argument("--explain", action="store_true", help="what was chosen and left out, and why")


def _fine(command: argparse.ArgumentParser, more: str = "") -> Any:
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


def _plan(command: argparse.ArgumentParser) -> None:
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


# Commands are imported when they run: `prtcl --help` need not wait for OpenCL and trimesh.
_LATER = ("embreex.mesh_construction", "tqdm")
_LATER_ON_DEVICES = (*_LATER, "pyopencl.array")
"""What the commands themselves import where they first need it, brought forward so that Ctrl-C is safe."""


def _command(name: str, later: Sequence[str] = _LATER_ON_DEVICES) -> Callable[[argparse.Namespace], int]:
    """A command's `run`, imported with all that it takes."""
    with deferred_interrupts():
        run: Callable[[argparse.Namespace], int] = import_module(f"prtcl.apps.{name}").run
        for module in later:
            with suppress(ImportError):  # reported where it is needed
                import_module(module)
    return run


def _demo(options: argparse.Namespace) -> int:
    return _command("demo")(options)


def _render(options: argparse.Namespace) -> int:
    _require_ending(options.output, ".exr", "; --png adds a preview")
    return _command("render")(options)


def _relight(options: argparse.Namespace) -> int:
    return _command("relight.command")(options)


def _bake(options: argparse.Namespace) -> int:
    _require_ending(options.output, ".npz", ", by which `prtcl render` knows a bake")
    return _command("bake", _LATER)(options)


def _fit(options: argparse.Namespace) -> int:
    _require_ending(options.output, ".npz", ", by which --brdf table: reads it")
    return _command("fit")(options)


def _view(options: argparse.Namespace) -> int:
    return _command("view.command")(options)


def _brdf(options: argparse.Namespace) -> int:
    return _command("brdf", ())(options)


def _bench(options: argparse.Namespace) -> int:
    return _command("bench.command")(options)


def _report(options: argparse.Namespace) -> int:
    return _command("report.command")(options)


def _stress(options: argparse.Namespace) -> int:
    return _command("stress.command")(options)


def _devices(options: argparse.Namespace) -> int:
    return _command("devices", ())(options)


def _require_ending(output: str, ending: str, why: str) -> None:
    if not output.lower().endswith(ending):
        raise InputError(f"--output {output}: expected a name that ends in {ending}{why}")

"""The options of every command."""

from __future__ import annotations

import argparse
import re
from typing import Any, NoReturn

from prtcl._version import __version__
from prtcl.apps import commands, info, occlusion
from prtcl.apps.arguments import (
    add_common,
    add_device,
    add_plan,
    add_scene,
    add_scheduler,
    gibibytes,
    nodes,
    size,
    whole,
)  # fmt: skip
from prtcl.apps.relight import options as relight


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
    every = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = every.add_parser("demo", help="a self-contained first run: its own scene, sky and materials")
    demo.add_argument("-o", "--output", default="demo-output", metavar="DIR", help="(default: %(default)s)")
    demo.add_argument(
        "--size", type=size, default=(288, 216), metavar="WxH", help="pixels (default: 288x216)"
    )
    add_device(demo)
    add_common(demo)
    demo.set_defaults(run=commands.demo)

    render = every.add_parser("render", help="an image of a mesh under an environment")
    render.add_argument("mesh", metavar="MESH|BAKE", help="OBJ, PLY, STL, GLB, glTF, or a bake (.npz, .zarr)")
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
    add_scene(render)
    add_plan(render)
    add_device(render, several=True)
    add_common(render)
    render.set_defaults(run=commands.render)

    relight.register(every, commands.relight)

    bake = every.add_parser("bake", help="trace the visibility of a mesh's vertices once, for reuse")
    bake.add_argument("mesh", metavar="MESH")
    bake.add_argument("-o", "--output", required=True, metavar="BAKE.npz|BAKE.zarr")
    bake.add_argument(
        "--rays", type=int, default=5, metavar="R", help="4^R rays a vertex (default: %(default)s)"
    )
    bake.add_argument("--smooth", action="store_true", help="vertex normals averaged over the faces")
    add_scheduler(bake, "on each machine", "vertices", "four million rays")
    add_common(bake)
    bake.set_defaults(run=commands.bake)

    info.add_parser(every)
    occlusion.add_parser(every)
    _fit(every)
    _view(every)
    _brdf(every)
    _bench(every)
    _report(every)
    _stress(every)

    devices = every.add_parser("devices", help="what OpenCL sees, which is used, why")
    devices.add_argument("--device", metavar="SPEC", help="see what a SPEC would choose")
    devices.add_argument("--json", action="store_true")
    devices.set_defaults(run=commands.devices)
    return top


def _fit(every: Any) -> None:
    fit = every.add_parser("fit", help="a bivariate table from images of a mesh")
    fit.add_argument("mesh", metavar="MESH", help="OBJ, PLY, STL, GLB or glTF, of one material")
    fit.add_argument(
        "--views", required=True, metavar="VIEWS.json",
        help="a list of {image, env, eye, target[, up, fov, env_rotate]}: EXR images as `render` writes them, "
        "files relative to the list's folder",
    )  # fmt: skip
    fit.add_argument("-o", "--output", required=True, metavar="TABLE.npz", help="for --brdf table:TABLE.npz")
    fit.add_argument(
        "--nodes", type=nodes, default=(45, 23), metavar="NHxND",
        help="of theta_h, at equal steps of its root, and of theta_d (default: 45x23)",
    )  # fmt: skip
    fit.add_argument(
        "--smoothness", type=float, default=1.0, metavar="S", help="larger is smoother (default: 1)"
    )
    fit.add_argument("--plain", action="store_true", help="weigh all pixels alike, outliers too")
    fit.add_argument(
        "--samples",
        type=whole(1),
        default=2500,
        metavar="N",
        help="pixels of an image, at most (default: 2500)",
    )
    fit.add_argument(
        "--levels", type=whole(2, 8), default=6, metavar="R", help="light on 4^R directions (default: 6)"
    )
    fit.add_argument("--smooth", action="store_true", help="vertex normals averaged over the faces")
    add_device(fit)
    add_common(fit)
    fit.set_defaults(run=commands.fit)


def _view(every: Any) -> None:
    from prtcl.factors.material import FORMS

    view = every.add_parser("view", help="edit materials and light in the browser")
    view.add_argument("mesh", metavar="MESH|BAKE", help="OBJ, PLY, STL, GLB, glTF, or a bake (.npz, .zarr)")
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
    add_device(view)
    view.set_defaults(run=commands.view)


def _brdf(every: Any) -> None:
    brdf = every.add_parser(
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
    brdf.set_defaults(run=commands.brdf)


def _bench(every: Any) -> None:
    bench = every.add_parser(
        "bench", help="how fast every stage is, against this device's limits and other programs"
    )
    bench.add_argument(
        "--points", type=whole(1), nargs="+", default=[40000], metavar="N",
        help="points; several give the curve of time against points (default: 40000)",
    )  # fmt: skip
    bench.add_argument(
        "--levels", type=whole(2, 9), nargs="+", default=[5, 6], metavar="R",
        help="4^R directions, 2 to 9 (default: 5 6)",
    )  # fmt: skip
    bench.add_argument(
        "--channels", type=int, choices=(1, 3), nargs="+", default=[3], help="of the light (default: 3)"
    )
    bench.add_argument("--stages", nargs="+", metavar="NAME", help="only these (default: all)")
    bench.add_argument(
        "--memory", type=gibibytes, metavar="GIB",
        help="of a stage's buffers; more points go in parts (default: a quarter of the device's)",
    )  # fmt: skip
    bench.add_argument(
        "--runs", type=whole(5), default=5, metavar="N", help="timed runs, 5 at least (default: 5)"
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
    add_device(bench)
    bench.add_argument("--quiet", action="store_true", help="no table")
    bench.add_argument(
        "--json", action="store_true", help="the result as JSON on standard output, and no table"
    )
    bench.set_defaults(run=commands.bench)


def _report(every: Any) -> None:
    report = every.add_parser("report", help="error against run time for a scene, material by material")
    report.add_argument("mesh", metavar="MESH", help="OBJ, PLY, STL, GLB, glTF")
    report.add_argument("--env", required=True, metavar="ENV", help="equirectangular EXR or HDR map")
    report.add_argument(
        "-o", "--output", required=True, metavar="DIR", help="report.html, report.json, and plots"
    )
    report.add_argument(
        "--error", type=float, default=0.02, metavar="E", help="that the plan aims for (default: %(default)s)"
    )
    add_scene(report, several=True, pixels=(256, 256))
    add_device(report)
    add_common(report)
    report.set_defaults(run=commands.report)


def _stress(every: Any) -> None:
    stress = every.add_parser(
        "stress", help="numerical stability: stiff and extreme cases against float64, with their bounds"
    )
    stress.add_argument("--cases", nargs="+", metavar="NAME", help="only these (default: all)")
    stress.add_argument(
        "--precision", nargs="+", choices=("float32", "mixed", "float64"),
        help="of the device (default: all that it has)",
    )  # fmt: skip
    stress.add_argument(
        "--levels", type=whole(3, 9), default=9, metavar="R",
        help="of the deepest tree, 3 to 9 (default: %(default)s)",
    )  # fmt: skip
    stress.add_argument(
        "--points", type=whole(2), default=1_000_000, metavar="N",
        help="points of identical data (default: %(default)s)",
    )  # fmt: skip
    stress.add_argument(
        "-o", "--output", metavar="DIR", help="stress.json, stress.md and plots (default: none)"
    )
    stress.add_argument("--no-plots", action="store_true", help="write no plots, which take matplotlib")
    add_device(stress)
    stress.add_argument("--quiet", action="store_true", help="no table")
    stress.add_argument("--markdown", action="store_true", help="the table as Markdown on standard output")
    stress.add_argument(
        "--json", action="store_true", help="the result as JSON on standard output, and no table"
    )
    stress.set_defaults(run=commands.stress)

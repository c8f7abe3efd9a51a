"""What every command runs, imported when it does: `prtcl --help` need not wait for OpenCL and trimesh."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module

from prtcl.apps.interrupts import deferred_interrupts
from prtcl.errors import InputError

_LATER = ("embreex.mesh_construction", "tqdm")
_LATER_ON_DEVICES = (*_LATER, "pyopencl.array")
"""What the commands themselves import where they first need it, brought forward so that Ctrl-C is safe."""


def _run(name: str, later: Sequence[str] = _LATER_ON_DEVICES) -> Callable[[argparse.Namespace], int]:
    """A command's `run`, imported with all that it takes."""
    with deferred_interrupts():
        run: Callable[[argparse.Namespace], int] = import_module(f"prtcl.apps.{name}").run
        for module in later:
            with suppress(ImportError):  # reported where it is needed
                import_module(module)
    return run


def demo(options: argparse.Namespace) -> int:
    """`prtcl demo`."""
    return _run("demo")(options)


def render(options: argparse.Namespace) -> int:
    """`prtcl render`."""
    _require_ending(options.output, ".exr", "; --png adds a preview")
    return _run("render")(options)


def relight(options: argparse.Namespace) -> int:
    """`prtcl relight`."""
    return _run("relight.command")(options)


def bake(options: argparse.Namespace) -> int:
    """`prtcl bake`."""
    if not options.output.rstrip("/").lower().endswith(".zarr"):
        _require_ending(options.output, ".npz", " or .zarr, by which `prtcl render` knows a bake")
    return _run("bake", _LATER)(options)


def fit(options: argparse.Namespace) -> int:
    """`prtcl fit`."""
    _require_ending(options.output, ".npz", ", by which --brdf table: reads it")
    return _run("fit")(options)


def view(options: argparse.Namespace) -> int:
    """`prtcl view`."""
    return _run("view.command")(options)


def brdf(options: argparse.Namespace) -> int:
    """`prtcl brdf`."""
    return _run("brdf", ())(options)


def bench(options: argparse.Namespace) -> int:
    """`prtcl bench`."""
    return _run("bench.command")(options)


def report(options: argparse.Namespace) -> int:
    """`prtcl report`."""
    return _run("report.command")(options)


def stress(options: argparse.Namespace) -> int:
    """`prtcl stress`."""
    return _run("stress.command")(options)


def devices(options: argparse.Namespace) -> int:
    """`prtcl devices`."""
    return _run("devices", ())(options)


def _require_ending(output: str, ending: str, why: str) -> None:
    if not output.lower().endswith(ending):
        raise InputError(f"--output {output}: expected a name that ends in {ending}{why}")

"""`prtcl stress`: cases on one device in every precision; a table, JSON, Markdown and plots."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from datetime import datetime, timezone
from importlib import import_module
from pathlib import Path
from typing import Any

from prtcl._version import __version__
from prtcl.apps import figures
from prtcl.apps.stress import plots, table
from prtcl.apps.stress.registry import CASES, EVERY, Size
from prtcl.apps.stress.runner import GOOD, rows
from prtcl.compute.device import Device
from prtcl.errors import DeviceError, InputError
from prtcl.files.atomic import check_writable, made_folder, replacing

Row = dict[str, Any]
FORMAT = "prtcl stress 1"

# Cases enter themselves when they are imported, in the table's order.
for _module in ("transforms", "products", "reflectance", "light", "storage", "order", "extremes"):
    import_module(f"prtcl.apps.stress.{_module}")


def run(options: argparse.Namespace) -> int:
    """Run the cases; 1 if an error is beyond its bound and not explained, not finite, or not the same twice.

    Raises
    ------
    InputError
        If a case is unknown, the folder cannot be made, or matplotlib is missing.
    DeviceError
        If the device lacks a precision that was asked for.
    """
    names = _names(options.cases)
    folder = None if options.output is None else _folder(options.output, options.no_plots)
    result = _measured(names, options)
    if folder is not None:
        with replacing(folder / "stress.json") as aside:
            aside.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        with replacing(folder / "stress.md") as aside:
            aside.write_text(table.markdown(result), encoding="utf-8")
        if not options.no_plots:
            plots.write(result, folder)
    if options.json:
        print(json.dumps(result, indent=1))
    elif options.markdown:
        print(table.markdown(result), end="")
    elif not options.quiet:
        print(table.text(result))
    return _wrong(result)


def _names(asked: list[str] | None) -> list[str]:
    unknown = [name for name in asked or () if name not in CASES]
    if unknown:
        raise InputError(f"--cases: {unknown[0]} is none\nthere are: {', '.join(CASES)}")
    return [name for name in CASES if not asked or name in asked]


def _folder(output: str, no_plots: bool) -> Path:
    """The folder of the results, made; found out before any work."""
    if not no_plots:
        figures.require(plots.WAY_OUT)
    folder = made_folder(output)
    check_writable(folder / "stress.json")
    return folder


def _measured(names: list[str], options: argparse.Namespace) -> Row:
    size, about = Size(options.levels, options.points), {}
    found: list[Row] = []
    for precision in options.precision or EVERY:
        try:
            device = Device(options.device, precision=precision)
        except DeviceError:
            if options.precision:
                raise
            continue  # no float64 here, and none was asked for
        with device:
            about = {"device": device.name, "driver": device.driver, "platform": device.platform}
            for name in names:
                if precision in CASES[name].precisions:
                    if not options.quiet and sys.stderr.isatty():
                        print(f"{precision}: {CASES[name].title}", file=sys.stderr, flush=True)
                    found += rows(device, CASES[name], size)
    if not found:
        only = ", ".join(dict.fromkeys(p for name in names for p in CASES[name].precisions))
        raise InputError(f"--precision: {', '.join(names)}: measured in {only} only")
    return {
        "format": FORMAT,
        "prtcl": __version__,
        **about,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "command": shlex.join(["prtcl", *(getattr(options, "arguments", None) or ["stress"])]),
        "levels": size.levels,
        "points": size.points,
        "rows": found,
    }


def _wrong(result: Row) -> int:
    """1 if a verdict is bad, said on standard error."""
    bad = [row for row in result["rows"] if row["verdict"] not in GOOD]
    for row in bad:
        where = f" at {row['at']}" if row["at"] else ""
        print(
            f"prtcl stress: {row['case']}, {row['what']}{where}, {row['precision']}: {row['verdict']}: "
            f"error {table.quantity(row['error'])}, expected at most {table.quantity(row['bound'])}",
            file=sys.stderr,
        )
    return int(bool(bad))

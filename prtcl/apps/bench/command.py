"""`prtcl bench`: stages, limits, rivals; a table, JSON, Markdown and plots."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Iterator
from datetime import datetime, timezone
from importlib import import_module
from pathlib import Path
from typing import Any

from prtcl._version import __version__
from prtcl.apps import figures
from prtcl.apps.bench import compare, plots, table
from prtcl.apps.bench.registry import STAGES
from prtcl.apps.bench.runner import Limits, rows
from prtcl.apps.bench.tune import tune
from prtcl.compute import tuning
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.visibility import threads
from prtcl.files.atomic import check_writable, made_folder, replacing

Row = dict[str, Any]
ORDER = ("visibility", "bits_to_coefficients", "light", "light_times_visibility", "light_times_visibility_reduced",
         "light_times_visibility_packed", "packed_sums", "forward_haar", "inverse_haar", "parent_sums",
         "dense_reduction", "bits_reduction", "sparse_reduction", "product", "slices", "inner_product", "cut",
         "job")  # fmt: skip
"""How a table begins; stages that are not named here follow."""

# Stages and rivals enter themselves when they are imported.
for _module in (
    "light", "transforms", "shading", "relighting", "rivals_haar", "rivals_pixel", "rivals_shading",
):  # fmt: skip
    import_module(f"prtcl.apps.bench.{_module}")


def run(options: argparse.Namespace) -> int:
    """Run the bench; 1 if a result was wrong or, against an old result, slower.

    Raises
    ------
    InputError
        If a stage is unknown, the old result is none, the folder cannot be made, or matplotlib is missing.
    """
    names = _names(options.stages)
    old = None if options.compare is None else compare.read(options.compare)
    folder = None if options.output is None else _folder(options.output, options.no_plots)
    with Device(options.device) as device:
        memory = device.memory / 4 if options.memory is None else options.memory * 2**30
        if options.tune:
            _tune(device, memory, options)
        result = _measured(device, names, memory, options)
    if folder is not None:
        with replacing(folder / "bench.json") as aside:
            aside.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        with replacing(folder / "bench.md") as aside:
            aside.write_text(table.markdown(result), encoding="utf-8")
        if not options.no_plots:
            plots.write(result, folder)
    status = _wrong(result)
    out = None
    if old is not None:
        compared, unmatched = compare.compare(old, result)
        result["compared"] = compared
        out = compare.text(compared, unmatched)
        status |= int(any(row["regression"] for row in compared))
    if options.json:
        print(json.dumps(result, indent=1))
    elif not options.quiet:
        print("\n\n".join(part for part in (table.text(result), out) if part))
    elif out and "REGRESSION" in out:
        print(out, file=sys.stderr)
    return status


def _tune(device: Device, memory: float, options: argparse.Namespace) -> None:
    """Time every form of every kernel, and keep the fastest for this device."""
    found = tune(device, min(options.points[0], 10_000), options.runs, memory)
    path = tuning.save(device, {name: form for name, (form, _) in found.items()})
    if not options.quiet:
        for name, (form, ratios) in found.items():
            others = ", ".join(f"{own} {ratio:.2f}" for own, ratio in ratios.items())
            print(f"{name}: {form.name} {form.size} (seconds relative to it: {others})", file=sys.stderr)
        print(f"kept in {path}", file=sys.stderr)


def _names(asked: list[str] | None) -> list[str]:
    """Stages to run, in the table's order."""
    everything = [name for name in ORDER if name in STAGES] + [name for name in STAGES if name not in ORDER]
    unknown = [name for name in asked or () if name not in STAGES]
    if unknown:
        raise InputError(f"--stages: {unknown[0]} is none\nthere are: {', '.join(everything)}")
    return [name for name in everything if not asked or name in asked]


def _folder(output: str, no_plots: bool) -> Path:
    """The folder of the results, made; found out before any work."""
    if not no_plots:
        figures.require(plots.WAY_OUT)
    folder = made_folder(output)
    check_writable(folder / "bench.json")
    return folder


def _measured(device: Device, names: list[str], memory: float, options: argparse.Namespace) -> Row:
    top = Limits.of(device, options.runs)
    found = []
    for row in _rows(device, names, top, memory, options):
        found.append(row)
        if not options.quiet and sys.stderr.isatty():
            who = row["rival"] or "prtcl"
            print(f"{row['title']}, 4^{row['levels']}: {who}", file=sys.stderr, flush=True)
    return {
        "format": compare.FORMAT,
        "prtcl": __version__,
        "device": device.name,
        "driver": device.driver,
        "platform": device.platform,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "cpus": threads(),
        "command": shlex.join(["prtcl", *(getattr(options, "arguments", None) or ["bench"])]),
        "memory_bytes": int(memory),
        "runs": options.runs,
        "limits": top.as_json(),
        "rows": found,
    }


def _rows(
    device: Device, names: list[str], top: Limits, memory: float, options: argparse.Namespace
) -> Iterator[Row]:
    """Each stage at every size; one that channels make no difference to is run once for all of them."""
    done = set()
    for levels in options.levels:
        for channels in options.channels:
            for name in names:
                stage = STAGES[name]
                for points in options.points:
                    key = (name, levels, 1 if stage.grey else channels, points)
                    if key not in done:
                        done.add(key)
                        yield from rows(
                            device, stage, points, levels, channels, top, memory, options.runs, options.rivals
                        )


def _wrong(result: Row) -> int:
    """1 if one of our stages erred, said on standard error; a rival's error is in its row."""
    wrong = [row for row in result["rows"] if row["rival"] is None and not row["correct"]]
    for row in wrong:
        off = "not finite or of another shape" if row["error"] is None else f"off by {row['error']:.2g}"
        print(
            f"prtcl bench: {row['stage']} at {row['points']} points, 4^{row['levels']} directions, "
            f"{row['channels']} channels is wrong: {off}, expected at most {row['tolerance']:.2g}",
            file=sys.stderr,
        )
    return int(bool(wrong))

"""Pictures of a bench result: stages under the device's roofline, and time against points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from prtcl.apps import figures

Row = dict[str, Any]
WAY_OUT = ", or --no-plots"
MARKS = "os^vD<>ph*XP"


def write(result: Row, folder: Path) -> list[Path]:
    """Write roofline and, where there is more than one number of points or levels, scaling: .png and .svg of each.

    Raises
    ------
    InputError
        If matplotlib is not installed, or a file cannot be written.
    """
    figures.require(WAY_OUT)
    rows = [row for row in result["rows"] if row["rival"] is None]
    made = {"roofline": _roofline(result, rows)}
    if len({(row["points"], row["levels"]) for row in rows}) > 1:
        made["scaling"] = _scaling(result, rows)
    return figures.save(made, folder)


def _roofline(result: Row, rows: list[Row]) -> Any:
    """Operations a second against operations a byte; a mark a stage and size under both limits."""
    figure, top = figures.new(), result["limits"]
    axes = figure.add_subplot()
    inside = [row for row in rows if row["bound"] != "host"]
    intensity = [row["flops"] / row["bytes"] for row in inside]
    ends = (min([0.05, *intensity]) / 2, max([50.0, *intensity]) * 2)
    at = np.geomspace(*ends, 200)
    roof = np.minimum(at * top["copy_bytes_per_second"], top["fma_flops_per_second"])
    axes.loglog(at, roof / 1e9, color="black", label="copy beyond the caches, multiply-adds")
    names = list(dict.fromkeys(row["stage"] for row in inside))
    for number, name in enumerate(names):
        own = [row for row in inside if row["stage"] == name]
        axes.loglog(
            [row["flops"] / row["bytes"] for row in own],
            [row["flops_per_second"] / 1e9 for row in own],
            MARKS[number % len(MARKS)], color=f"C{number % 10}", label=own[0]["title"],
        )  # fmt: skip
    axes.set_xlabel("operations a byte that must move")
    axes.set_ylabel("GFLOP/s")
    axes.set_title(f"{result['device']}, {result['platform']}")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize="small")
    return figure


def _scaling(result: Row, rows: list[Row]) -> Any:
    """Seconds against points, a line a stage, levels and channels."""
    figure = figures.new()
    axes = figure.add_subplot()
    names = list(dict.fromkeys(row["stage"] for row in rows))
    styles = {
        size: ("-", "--", ":", "-.")[number % 4]
        for number, size in enumerate(dict.fromkeys((row["levels"], row["channels"]) for row in rows))
    }
    lines = list(dict.fromkeys((row["stage"], row["levels"], row["channels"]) for row in rows))
    for name, levels, channels in lines:
        own = sorted(
            (row["points"], row["points"] / row["points_per_second"], row["title"])
            for row in rows
            if (row["stage"], row["levels"], row["channels"]) == (name, levels, channels)
        )
        number = names.index(name)
        axes.loglog(
            [each[0] for each in own], [each[1] for each in own], styles[levels, channels],
            marker=MARKS[number % len(MARKS)], color=f"C{number % 10}", label=f"{own[0][2]}, 4^{levels} x {channels}",
        )  # fmt: skip
    axes.set_xlabel("points")
    axes.set_ylabel("seconds")
    axes.set_title(f"{result['device']}, {result['platform']}")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize="x-small", ncols=1 + len(lines) // 40)
    return figure

"""Pictures of a stress result: errors against bounds, and against the depth of the tree."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from prtcl.apps import figures

Row = dict[str, Any]
WAY_OUT = ", or --no-plots"
MARKS = {"float32": "o", "mixed": "s", "float64": "^"}


def write(result: Row, folder: Path) -> list[Path]:
    """Write bounds and, where some trials ran at several depths, depth: .png and .svg of each.

    Raises
    ------
    InputError
        If matplotlib is not installed, or a file cannot be written.
    """
    figures.require(WAY_OUT)
    rows = [row for row in result["rows"] if row["error"] and row["bound"]]
    made = {"bounds": _bounds(result, rows)}
    if len({_depth(row) for row in rows} - {None}) > 1:
        made["depth"] = _depths(result, rows)
    return figures.save(made, folder)


def _depth(row: Row) -> int | None:
    found = re.fullmatch(r"R = (\d+)", row["at"])
    return int(found[1]) if found else None


def _way(row: Row) -> str:
    """How it was computed, of a trial called "data: way"; else what it is called."""
    return str(row["what"]).rpartition(": ")[2]


def _bounds(result: Row, rows: list[Row]) -> Any:
    """Every trial's error against its bound; what lies above the line is beyond it."""
    figure = figures.new()
    axes = figure.add_subplot()
    for number, title in enumerate(dict.fromkeys(row["title"] for row in rows)):
        for precision, mark in MARKS.items():
            own = [row for row in rows if (row["title"], row["precision"]) == (title, precision)]
            axes.loglog(
                [row["bound"] for row in own], [row["error"] for row in own], mark, color=f"C{number % 10}",
                alpha=0.6, label=title if precision == "float32" else None,
            )  # fmt: skip
    ends = [1e-17, 10.0]
    axes.loglog(ends, ends, color="black", label="error = bound")
    axes.set_xlabel("bound, relative (round: float32, square: mixed, triangle: float64)")
    axes.set_ylabel("error, relative")
    axes.set_title(f"{result['device']}, {result['platform']}")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize="small")
    return figure


def _depths(result: Row, rows: list[Row]) -> Any:
    """Errors of float32 against the levels of the tree: a panel a case, a line a trial, its bound dotted."""
    figure = figures.new()
    deep = [row for row in rows if _depth(row) is not None and row["precision"] == "float32"]
    titles = [
        t
        for t in dict.fromkeys(row["title"] for row in deep)
        if len({_depth(r) for r in deep if r["title"] == t}) > 1
    ]
    panels = figure.subplots(1, max(1, len(titles)), squeeze=False)[0]
    for axes, title in zip(panels, titles, strict=False):
        inside = [row for row in deep if row["title"] == title]
        # Of "data: way" a colour a way: each data in its own would be more than can be told apart.
        ways = list(dict.fromkeys(_way(row) for row in inside))
        for what in dict.fromkeys(row["what"] for row in inside):
            own = [row for row in inside if row["what"] == what]
            way = _way(own[0])
            at, colour = [_depth(row) for row in own], f"C{ways.index(way) % 10}"
            label = way if colour not in {line.get_color() for line in axes.lines} else None
            axes.semilogy(at, [row["error"] for row in own], "o-", color=colour, label=label)
            axes.semilogy(at, [row["bound"] for row in own], ":", color=colour)
        axes.set_title(title, fontsize="x-small", wrap=True)
        axes.set_xlabel("levels of the tree")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="xx-small", loc="upper center", bbox_to_anchor=(0.5, -0.18))
    panels[0].set_ylabel("error of float32, relative; bounds are dotted")
    figure.suptitle(f"{result['device']}, {result['platform']}")
    return figure

"""A stress result as a table for people and as Markdown: one line for all trials of one kind in one precision."""

from __future__ import annotations

from itertools import groupby
from typing import Any

Row = dict[str, Any]
HEADS = ("trial", "precision", "error", "bound", "of bound", "relative to", "before", "verdict", "at")
NUMBERS = {2, 3, 4, 6}
"""Columns of the heads that stand on the right."""
RANK = {"ok": 0, "explained": 1, "exceeds": 2, "not the same bytes": 3, "not finite": 4}


def worst(rows: list[Row]) -> Row:
    """The row that speaks for a series: the worst verdict, and the largest error among those."""
    rank = max(RANK[row["verdict"]] for row in rows)
    return max((row for row in rows if RANK[row["verdict"]] == rank), key=_error)


def _error(row: Row) -> float:
    return float("inf") if row["error"] is None else float(row["error"])


def lines(rows: list[Row]) -> list[Row]:
    """One row for each case, trial and precision: the worst of its series, with where it stands; order is kept.

    Its ratio and what was before are the largest of the whole series.
    """
    series: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        series.setdefault((row["case"], row["what"], row["precision"]), []).append(row)
    out = []
    for own in series.values():
        speaker = dict(worst(own))
        if len(own) > 1:
            speaker["at"] = f"{own[0]['at']} … {own[-1]['at']}, here {speaker['at']}"
        ratios = [row["ratio"] for row in own]
        speaker["ratio"] = None if None in ratios else max(ratios)
        speaker["before_finite"] = all(row["before_finite"] for row in own)
        before = [row["before"] for row in own if row["before"] is not None]
        speaker["before"] = max(before) if before and speaker["before_finite"] else None
        out.append(speaker)
    return out


def quantity(value: float | None) -> str:
    """Two digits; 0 is exact, None is not finite."""
    return "not finite" if value is None else "0" if value == 0 else f"{value:.1e}"


def _ratio(value: float) -> str:
    return f"{value:.0e}" if value >= 100 else f"{value:.2f}" if value >= 0.005 else "0"


def cells(row: Row) -> tuple[str, ...]:
    """Cells of a line."""
    before = "" if row["before_finite"] and row["before"] is None else quantity(row["before"])
    ratio = "" if row["ratio"] is None else _ratio(row["ratio"])
    return (
        row["what"], row["precision"], quantity(row["error"]), quantity(row["bound"]), ratio, row["relative_to"],
        before, row["verdict"], row["at"],
    )  # fmt: skip


def heading(result: Row) -> str:
    """Which device, when, and how it went."""
    counts: dict[str, int] = {}
    for row in result["rows"]:
        counts[row["verdict"]] = counts.get(row["verdict"], 0) + 1
    said = ", ".join(f"{count} {name}" for name, count in sorted(counts.items(), key=lambda i: RANK[i[0]]))
    return (
        f"{result['device']}, {result['platform']}, driver {result['driver']}; {result['date']}, "
        f"prtcl {result['prtcl']}\n{len(result['rows'])} trials: {said}"
    )


def _sections(result: Row) -> list[tuple[str, list[Row]]]:
    in_order = sorted(lines(result["rows"]), key=lambda row: list(_titles(result)).index(row["title"]))
    return [(title, list(own)) for title, own in groupby(in_order, key=lambda row: str(row["title"]))]


def _titles(result: Row) -> dict[str, None]:
    return dict.fromkeys(row["title"] for row in result["rows"])


def _notes(rows: list[Row]) -> list[str]:
    """What was said of a section's trials, and the bounds' theory, each once."""
    notes: dict[str, list[str]] = {}
    for row in rows:
        if row["note"]:
            notes.setdefault(row["note"], [])
            if row["what"] not in notes[row["note"]]:
                notes[row["note"]].append(row["what"])
    everything = len({row["what"] for row in rows})
    return [note if len(who) == everything else f"{_names(who)}: {note}" for note, who in notes.items()]


def _names(who: list[str]) -> str:
    """Some names, and how many more there are."""
    return "; ".join(who[:3]) + (f" and {len(who) - 3} more" if len(who) > 3 else "")


def text(result: Row) -> str:
    """For a terminal."""
    parts = [heading(result)]
    for title, rows in _sections(result):
        table = [HEADS, *map(cells, rows)]
        widths = [max(len(line[i]) for line in table) for i in range(len(HEADS))]
        body = "\n".join(
            "  ".join(
                cell.rjust(width) if i in NUMBERS else cell.ljust(width)
                for i, (cell, width) in enumerate(zip(line, widths, strict=True))
            ).rstrip()
            for line in table
        )
        parts.append("\n".join([title.upper(), body, *(f"  {note}" for note in _notes(rows))]))
    return "\n\n".join(parts)


def markdown(result: Row) -> str:
    """For a document."""
    parts = [heading(result), f"`{result['command']}`"]
    for title, rows in _sections(result):
        body = [HEADS, ("---",) * len(HEADS), *map(cells, rows)]
        table = "\n".join("| " + " | ".join(c.replace("|", "\\|") for c in line) + " |" for line in body)
        theory = list(dict.fromkeys(row["theory"] for row in rows))
        said = "\n".join(f"- {note}" for note in _notes(rows))
        parts.append(f"## {title}\n\n{table}\n\nBound: {'; '.join(theory)}.\n\n{said}".rstrip())
    return "\n\n".join(parts) + "\n"

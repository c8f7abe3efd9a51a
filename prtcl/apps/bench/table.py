"""A bench result as a table for people and as Markdown."""

from __future__ import annotations

from typing import Any

Row = dict[str, Any]
HEADS = ("stage", "points", "directions", "channels", "points/s", "Gcoeff/s", "GB/s", "of copy", "of best", "GFLOP/s",
         "of FMA", "bound by", "spread", "note")  # fmt: skip
RIVAL_HEADS = ("stage", "points", "directions", "channels", "rival", "points/s", "ours is faster by", "note")
NUMBERS = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10}
RIVAL_NUMBERS = {1, 2, 3, 5, 6}
"""Columns of the heads that stand on the right."""


def _share(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.0f} %"


def _quantity(value: float) -> str:
    """Three digits at least, thousands parted."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _spread(row: Row) -> str:
    low, high, middle = (row["seconds"][key] for key in ("min", "max", "median"))
    return f"{100 * (low / middle - 1):+.0f} {100 * (high / middle - 1):+.0f} %"


def ours(row: Row) -> tuple[str, ...]:
    """Cells of one of our stages' rows."""
    wrong = "" if row["correct"] else "WRONG"
    unit = row["unit"] if row["unit"] != "points" else ""
    return (
        row["title"], f"{row['points']:,}", f"4^{row['levels']}", str(row["channels"]),
        _quantity(row["points_per_second"]), f"{row['coefficients_per_second'] / 1e9:.3g}",
        f"{row['bytes_per_second'] / 1e9:.3g}", _share(row["share_of_copy"]), _share(row["share_of_best_copy"]),
        f"{row['flops_per_second'] / 1e9:.3g}", _share(row["share_of_fma"]), row["bound"], _spread(row),
        "; ".join(word for word in (wrong, unit, row["note"]) if word),
    )  # fmt: skip


def rival(row: Row) -> tuple[str, ...]:
    """Cells of a rival's row."""
    start = (row["title"], f"{row['points']:,}", f"4^{row['levels']}", str(row["channels"]), row["rival"])
    if row["skipped"]:
        return (*start, "skipped", "", row["skipped"])
    note = "; ".join(word for word in ("" if row["correct"] else "WRONG", row["way"], row["note"]) if word)
    faster = "" if row["times_faster"] is None else f"{row['times_faster']:.3g}"
    return (*start, _quantity(row["points_per_second"]), faster, note)


def _heading(result: Row) -> str:
    top = result["limits"]
    return (
        f"{result['device']}, {result['platform']}, driver {result['driver']}; {result['date']}, "
        f"prtcl {result['prtcl']}\n"
        f"copy {top['copy_bytes_per_second'] / 1e9:.3g} GB/s ({top['copy_form']}), "
        f"multiply-adds {top['fma_flops_per_second'] / 1e9:.4g} GFLOP/s ({top['fma_form']})"
    )


def _parted(result: Row) -> tuple[list[Row], list[Row]]:
    rows = result["rows"]
    return [r for r in rows if r["rival"] is None], [r for r in rows if r["rival"] is not None]


def _aligned(heads: tuple[str, ...], lines: list[tuple[str, ...]], right: set[int]) -> str:
    widths = [max(len(cells[i]) for cells in (heads, *lines)) for i in range(len(heads))]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ).rstrip()
        for cells in (heads, *lines)
    )


def text(result: Row) -> str:
    """For a terminal."""
    stages, rivals = _parted(result)
    out = f"{_heading(result)}\n\n{_aligned(HEADS, [ours(row) for row in stages], NUMBERS)}"
    if rivals:
        out += f"\n\n{_aligned(RIVAL_HEADS, [rival(row) for row in rivals], RIVAL_NUMBERS)}"
    return out


def markdown(result: Row) -> str:
    """For a document."""

    def table(heads: tuple[str, ...], lines: list[tuple[str, ...]]) -> str:
        cells = [heads, ("---",) * len(heads), *lines]
        return "\n".join(
            "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in cells
        )

    stages, rivals = _parted(result)
    out = f"{_heading(result)}\n\n`{result['command']}`\n\n{table(HEADS, [ours(row) for row in stages])}\n"
    if rivals:
        out += f"\n{table(RIVAL_HEADS, [rival(row) for row in rivals])}\n"
    return out

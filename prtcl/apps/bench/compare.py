"""Two bench results beside each other: what became slower."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from prtcl.errors import InputError

Row = dict[str, Any]
FORMAT = "prtcl bench 1"
KEY = ("device", "stage", "points", "levels", "channels")
SLOWER = 0.9
"""A row is a regression below this share of what it was."""


def read(path: str) -> Row:
    """A result that `prtcl bench -o` wrote.

    Raises
    ------
    InputError
        If the file cannot be read or is something else.
    """
    try:
        result = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"--compare {path}: cannot be read ({error.strerror}); name a bench.json") from error
    except ValueError as error:
        raise InputError(
            f"--compare {path}: expected a bench.json that prtcl bench -o wrote, got no JSON ({error})"
        ) from error
    if not isinstance(result, dict) or result.get("format") != FORMAT:
        raise InputError(
            f"--compare {path}: expected a bench.json that prtcl bench -o wrote, got other JSON\n"
            f'it has no "format": "{FORMAT}"; make one with this version'
        )
    if not all(_complete(row) for row in _rows(result, path)):
        raise InputError(
            f"--compare {path}: expected whole rows, got some with numbers missing; make it anew"
        )
    return result


def _rows(result: Row, path: str) -> list[Row]:
    rows = result.get("rows")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"--compare {path}: expected rows in it, got {type(rows).__name__}; make it anew")
    return [row for row in rows if row.get("rival") is None]


def _complete(row: Row) -> bool:
    seconds = row.get("seconds")
    return (
        all(key in row for key in KEY)
        and isinstance(seconds, dict)
        and all(isinstance(seconds.get(key), (int, float)) for key in ("min", "median", "max"))
        and isinstance(row.get("points_per_second"), (int, float))
        and row["points_per_second"] > 0
        and "share_of_limit" in row
    )


def compare(old: Row, new: Row) -> tuple[list[Row], int]:
    """Rows that both have, side by side, and how many of the new ones are in no old one.

    Returns
    -------
    rows : key, `rate_ratio` (new over old points a second), `limit_ratio` (of the shares of the limit, None for
        the host's work), `regression`
    unmatched : int

    Notes
    -----
    A regression is slower by more than 10 %, with the slowest of the old runs still faster than the fastest of the new
    ones; and slower against the device's limit as well, since a machine that others share is slower itself at times.
    """
    before = {tuple(row[key] for key in KEY): row for row in old["rows"] if row.get("rival") is None}
    out, unmatched = [], 0
    for row in new["rows"]:
        if row["rival"] is not None:
            continue
        was = before.get(tuple(row[key] for key in KEY))
        if was is None:
            unmatched += 1
            continue
        rate = row["points_per_second"] / was["points_per_second"]
        limit = None
        if row["share_of_limit"] and was["share_of_limit"]:
            limit = row["share_of_limit"] / was["share_of_limit"]
        fastest, slowest = (_rate(row, "min"), _rate(was, "max"))
        slower = rate < SLOWER and fastest < slowest and (limit is None or limit < SLOWER)
        names = {key: row[key] for key in KEY}
        out.append({**names, "rate_ratio": rate, "limit_ratio": limit, "regression": slower})
    return out, unmatched


def _rate(row: Row, which: str) -> float:
    """Points a second of the fastest ("min" seconds) or slowest run."""
    return float(row["points_per_second"] * row["seconds"]["median"] / row["seconds"][which])


def text(rows: list[Row], unmatched: int) -> str:
    """A line a row."""
    lines = []
    for row in rows:
        limit = "" if row["limit_ratio"] is None else f", share of the limit x {row['limit_ratio']:.3f}"
        lines.append(
            f"{row['stage']}, {row['points']:,} points, 4^{row['levels']}, {row['channels']} channels: "
            f"points/s x {row['rate_ratio']:.3f}{limit}" + ("  REGRESSION" if row["regression"] else "")
        )
    if unmatched:
        lines.append(f"{unmatched} rows have none of the same device, stage and size to compare with")
    return "\n".join(lines)

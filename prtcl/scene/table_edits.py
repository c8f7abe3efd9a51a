"""Materials of a session edited as tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from prtcl.errors import InputError
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.material import Material
from prtcl.factors.table import Table


def edited(
    materials: tuple[Material, ...], change: Callable[[Table], Table], parts: range
) -> tuple[tuple[Material, ...], Table]:
    """Some of the materials changed as tables, the first of which is given as well.

    What was worn to begin with is what a new one is `like`, over any number of edits: its cut is tried first.
    """
    made: dict[int, tuple[Material, Table]] = {}
    out = list(materials)
    for part in parts:
        worn = materials[part]
        # Parts that wear the same wear the same afterwards.
        if id(worn) not in made:
            given = change(Table.of(worn))
            if not isinstance(given, Table | Bivariate):
                raise InputError(f"edit: expected the function to return a table, got {type(given).__name__}")
            table = Table.of(given)
            made[id(worn)] = replace(table.material(), like=worn.like or worn), table
        out[part] = made[id(worn)][0]
    return tuple(out), made[id(materials[parts[0]])][1]

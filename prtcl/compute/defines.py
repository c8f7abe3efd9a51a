"""Build-time constants of a program: `Defines(LEVELS=5, REAL="float")` instead of glued option strings."""

from __future__ import annotations

import re
from collections.abc import Iterator

_NAME = re.compile(r"^[A-Z][A-Z0-9_]*$")
_WORD = re.compile(r"^[A-Za-z_][A-Za-z0-9_]*$")


class Defines:
    """Sorted, checked `-D NAME=value` options; equal and hashable by value.

    Parameters
    ----------
    **values : int, float or a single C word. Floats are written in full as hexadecimal, so no digit is lost.

    Raises
    ------
    ValueError
        If a name is not UPPER_CASE or a value is neither a number nor one word.

    Examples
    --------
    >>> Defines(LEVELS=5, REAL="float").options
    ['-DLEVELS=5', '-DREAL=float']
    """

    def __init__(self, **values: int | float | str) -> None:
        self._items = tuple(sorted((name, self._format(name, value)) for name, value in values.items()))

    @staticmethod
    def _format(name: str, value: int | float | str) -> str:
        if not _NAME.fullmatch(name):
            raise ValueError(f"define {name}: expected an UPPER_CASE name")
        if isinstance(value, bool):
            return str(int(value))
        if isinstance(value, int):
            return str(value)
        if isinstance(value, float):
            return value.hex()
        if isinstance(value, str) and _WORD.fullmatch(value):
            return value
        raise ValueError(f"define {name}: expected a number or one C word, got {value!r}")

    @property
    def options(self) -> list[str]:
        return [f"-D{name}={value}" for name, value in self._items]

    def __iter__(self) -> Iterator[tuple[str, str]]:
        return iter(self._items)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Defines) and self._items == other._items

    def __hash__(self) -> int:
        return hash(self._items)

    def __repr__(self) -> str:
        return " ".join(self.options)

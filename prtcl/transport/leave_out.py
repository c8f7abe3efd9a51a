"""What a scene does not need and is therefore left out: each by a name, which a user may take back.

Nothing of it changes a picture beyond the error stated with it in a render's report.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from dataclasses import dataclass

from prtcl.errors import InputError

WHAT = {
    "unseen": "vertices that no pixel sees: neither traced nor shaded",
    "rays": "rays between neighbours that agree (uniform squares of visibility)",
    "unlit": "points that see nothing of the sky, or are seen from behind: no product, no slices",
    "unshadowed": "the rays' weights of points that see all of their sky: L ⊕ V = L",
    "normals": "matt points that see all of their sky, of a normal that another has: one product for all",
    "grey": "two of three channels, where light and material are grey",
    "levels": "levels of the product at which f_v has no energy",
    "views": "slices of f_v at views that no point has",
    "horizon": "rays to hard light below a point's horizon",
    "terms": "kinds and terms of materials that no material has",
}
"""Name to what is left out."""
EVERYTHING = frozenset(WHAT)


def parse(text: str) -> frozenset[str]:
    """Names from a list such as "all", "none", "grey,rays", or "no-grey": all but that.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    names = [name.strip() for name in text.split(",")]
    unknown = [name for name in names if name.removeprefix("no-") not in (*WHAT, "all", "none")]
    if unknown:
        raise InputError(
            f"leave-out: {unknown[0] or 'an empty name'!s} is none; expected all, none, or names with or without no- "
            f"before them\nthere are: {', '.join(WHAT)}"
        )
    added = {name for name in names if not name.startswith("no-") and name not in ("all", "none")}
    taken = {name.removeprefix("no-") for name in names if name.startswith("no-")}
    start = EVERYTHING if "all" in names or (not added and "none" not in names) else frozenset[str]()
    return (start | added) - taken


@dataclass(frozen=True)
class Item:
    """What one name left out in a render.

    Attributes
    ----------
    count, of : how many of how many, in `unit`
    seconds : saved, about: the number left out times what those that were not left out took
    bytes : of memory saved, about
    error : relative, at most, that it may have cost
    """

    name: str
    count: int
    of: int
    unit: str
    seconds: float = 0.0
    bytes: int = 0
    error: float = 0.0


class Tally:
    """Counts what is left out while a render runs; several threads add to it."""

    def __init__(self) -> None:
        self._count: defaultdict[str, int] = defaultdict(int)
        self._of: defaultdict[str, int] = defaultdict(int)
        self._lock = threading.Lock()

    def add(self, name: str, count: int, of: int) -> None:
        """`count` of `of` were left out by that name."""
        with self._lock:
            self._count[name] += int(count)
            self._of[name] += int(of)

    def set(self, name: str, count: int, of: int) -> None:
        """`count` of `of` are left out so far."""
        with self._lock:
            self._count[name], self._of[name] = int(count), int(of)

    def __getitem__(self, name: str) -> tuple[int, int]:
        return self._count[name], self._of[name]

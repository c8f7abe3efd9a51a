"""File names of a batch: readable, deterministic, no two alike."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from prtcl.factors.material import MEASURED

LONGEST = 60
"""Characters of one part: three of them, a rotation and what a file written aside is called stay below 255 bytes."""


def plain(text: str) -> str:
    """A text without what a file system, or a shell, takes for more than a name."""
    name = re.sub(r"[^\w.+-]+", "-", text, flags=re.ASCII).strip("-.")
    return name[:LONGEST].rstrip("-.") or "unnamed"


def material_name(spec: str) -> str:
    """A SPEC as part of a file name: ``ggx:alpha=0.3,f0=0.04`` is ggx-alpha-0.3-f0-0.04, a file is its stem."""
    kind, _, rest = spec.partition(":")
    if kind == "table" or kind in MEASURED:
        return plain(f"{kind}-{Path(rest.split(',')[0]).stem}")
    return plain(spec)


def unique(names: Iterable[str]) -> list[str]:
    """The same names, those that were there before numbered: sky, sky-2. Case makes no difference, as on some disks."""
    taken: set[str] = set()
    out = []
    for name in names:
        found, number = name, 2
        while found.casefold() in taken:
            found, number = f"{name}-{number}", number + 1
        taken.add(found.casefold())
        out.append(found)
    return out


def rotation_names(rotations: Sequence[float]) -> list[str]:
    """Degrees in names of one width, so that they sort as numbers do: rot005, rot012.5. Of a lone 0 nothing is said."""
    if list(rotations) == [0.0]:
        return [""]
    texts = [f"{degrees:.4f}".rstrip("0").rstrip(".") for degrees in rotations]
    width = max(len(text.split(".")[0]) for text in texts)
    padded = [text.zfill(len(text) + max(3, width) - len(text.split(".")[0])) for text in texts]
    return unique(f"rot{text}" for text in padded)


def file_stem(environment: str, rotation: str, material: str, view: str) -> str:
    """env[_rotDEG]_material_view."""
    return "_".join(part for part in (environment, rotation, material, view) if part)

"""Kernel sources: found, and their includes expanded, as one string each.

`#include "x.clh"` is expanded here rather than by the OpenCL compiler: `-I` with a space in the path fails on
PoCL, and one string is an exact cache key. `#line` markers keep build messages true.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from prtcl.errors import PrtclError

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')


def kernel_folder() -> Path:
    """The folder of the .cl files: inside the installed package, or beside it in a checkout.

    Raises
    ------
    PrtclError
        If neither exists: the installation is broken.
    """
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "kernels", package.parent / "kernels"):
        if (folder / "common.clh").is_file():
            return folder
    raise PrtclError(f"{package}: the OpenCL sources (kernels/*.cl) are missing\nreinstall prtcl")


@cache
def expand(name: str) -> str:
    """The source of kernels/NAME with every include in place, each file at most once."""
    return "\n".join(_expand(name, kernel_folder(), set())) + "\n"


def _expand(name: str, folder: Path, included: set[str]) -> list[str]:
    included.add(name)
    lines = [f'#line 1 "{name}"']
    for number, line in enumerate((folder / name).read_text(encoding="utf-8").splitlines(), start=1):
        match = _INCLUDE.match(line)
        if match is None:
            lines.append(line)
        elif match.group(1) not in included:
            lines += [*_expand(match.group(1), folder, included), f'#line {number + 1} "{name}"']
        else:
            lines.append("")
    return lines

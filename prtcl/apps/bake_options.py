"""A bake in place of a mesh on the command line, and options that it has decided already."""

from __future__ import annotations

from prtcl.errors import InputError
from prtcl.scene.bake import Bake


def read_bake(path: str, rays: int | None, smooth: bool) -> Bake:
    """The bake at a path, unless --rays or --smooth ask for other than what it was made with.

    Raises
    ------
    InputError
        If it cannot be read, or asks for what it does not hold.
    """
    bake = Bake.load(path)
    if rays not in (None, bake.rays):
        raise InputError(f"--rays {rays}: {path} was traced with {bake.rays}; bake again with --rays {rays}")
    if smooth:
        raise InputError(f"--smooth: {path} keeps the normals it was traced with; bake again with --smooth")
    return bake

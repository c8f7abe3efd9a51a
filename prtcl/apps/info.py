"""`prtcl info`: what a bake or kept visibility holds, and whether it is whole."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prtcl.apps import info_kept
from prtcl.errors import InputError

if TYPE_CHECKING:
    from prtcl.scene.mesh import Mesh


def add_parser(commands: Any) -> None:
    """Register the command."""
    info = commands.add_parser(
        "info", help="what a bake or kept visibility holds; with --verify, whether all of it is whole"
    )
    info.add_argument(
        "bake", metavar="BAKE|DIR", help="a bake (.npz, .zarr), or what `relight --keep-visibility DIR` keeps"
    )
    info.add_argument("--verify", action="store_true", help="read every chunk (an .npz is always read whole)")
    info.add_argument("--json", action="store_true", help="the same as JSON on standard output")
    info.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print what is known of a bake, or of kept visibility."""
    if info_kept.is_kept(options.bake):
        return _run_kept(options)
    found = describe(options.bake, options.verify)
    if options.json:
        print(json.dumps(found, indent=2))
        return 0
    rays, vertices = found["rays"], found["vertices"]
    lines = [
        ("mesh", f"{found['mesh']}, {vertices} vertices, {found['faces']} faces"),
        ("hash", found["mesh_sha256"]),
        ("rays", f"4^{rays} = {4**rays} a vertex, {vertices * 4**rays} in all"),
        ("place", f"{found['parameterisation']['place']} of each cell; no seed"),
        ("frames", found["parameterisation"]["frames"]),
        ("map", f"{found['parameterisation']['hemisphere']}; {found['parameterisation']['order']} order"),
        ("bytes", f"{found['bytes']['disk']} on disk, {found['bytes']['raw']} in memory"),
        ("made by", f"prtcl {found['prtcl']}, format {found['format']}"),
    ]
    if found["chunks"] is not None:
        lines.append(("chunks", f"{found['chunks']['number']} of {found['chunks']['vertices']} vertices"))
    if found["verified"]:
        lines.append(("verified", "whole: everything was read"))
    _print(options.bake, lines)
    return 0


def _run_kept(options: argparse.Namespace) -> int:
    stores = info_kept.describe(options.bake, options.verify)
    if options.json:
        print(json.dumps(stores, indent=2))
        return 0
    for store in stores:
        _print(store["path"], info_kept.lines(store))
    return 0


def _print(title: str, lines: list[tuple[str, str]]) -> None:
    print(title)
    for name, value in lines:
        print(f"  {name:9s} {value}")


def describe(path: str, verify: bool = False) -> dict[str, Any]:
    """What `prtcl info --json` prints.

    Raises
    ------
    InputError
        If it is no bake, or damaged where it was read: the metadata and the mesh, and everything with `verify`.
    """
    # Late: the command line's help need not wait for NumPy and trimesh.
    from prtcl.scene.bake import is_bake
    from prtcl.scene.bake_store import StoredBake, is_store

    if not is_bake(path):
        raise InputError(f"{path}: expected a bake, whose name ends in .npz or .zarr")
    if not is_store(path):
        return _describe_npz(path)
    stored = StoredBake(path)
    if verify:
        stored.store.verify()
    found, bits = stored.store.attributes, stored.store.arrays["bits"]
    rows = int(bits.chunks[0])
    return {
        **_mesh(stored.mesh, stored.rays),
        "parameterisation": found["parameterisation"],
        "bytes": {"disk": stored.store.disk_bytes, "raw": stored.store.raw_bytes},
        "chunks": {"vertices": rows, "number": -(-len(stored) // rows)},
        "prtcl": found["prtcl"],
        "format": found["format"],
        "verified": verify,
    }


def _describe_npz(path: str) -> dict[str, Any]:
    from prtcl.files.npz import read_npz
    from prtcl.scene.bake import Bake
    from prtcl.scene.bake_layout import mesh_arrays, text_of
    from prtcl.scene.bake_store import PARAMETERISATION, WHAT

    bake = Bake.load(path)
    raw = bake.bits.nbytes + sum(array.nbytes for array in mesh_arrays(bake.mesh).values())
    data = read_npz(path, WHAT)
    return {
        **_mesh(bake.mesh, bake.rays),
        "parameterisation": PARAMETERISATION,
        "bytes": {"disk": Path(path).stat().st_size, "raw": raw},
        "chunks": None,
        "prtcl": text_of(path, data, "prtcl") or "unknown",
        "format": int(data["format"]),
        "verified": True,
    }


def _mesh(mesh: Mesh, rays: int) -> dict[str, Any]:
    from prtcl.scene.bake_layout import mesh_hash

    return {
        "mesh": mesh.name,
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "mesh_sha256": mesh_hash(mesh),
        "rays": rays,
    }

"""`prtcl info` of visibility that `prtcl relight --keep-visibility` keeps: one store, or a folder of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from prtcl.errors import InputError


def is_kept(path: str) -> bool:
    """Whether a path is a store of kept visibility, or a folder that is no store."""
    from prtcl.files.array_store import ArrayStore
    from prtcl.scene.bake_store import is_store
    from prtcl.scene.kept_visibility import KIND

    if not is_store(path):
        return Path(path).is_dir()
    what = "a bake made by `prtcl bake`, or visibility kept by `prtcl relight`"
    return ArrayStore(path, what).attributes.get("kind") == KIND


def describe(path: str, verify: bool = False) -> list[dict[str, Any]]:
    """What `prtcl info --json` prints: an object for each store.

    Raises
    ------
    InputError
        If there is none, or one is damaged where it was read: its metadata, and everything with `verify`.
    """
    from prtcl.scene.bake_store import is_store
    from prtcl.scene.kept_visibility import open_store

    folder = Path(path)
    if is_store(path):
        stores = [folder]
    else:
        stores = sorted(p for p in folder.glob("*.zarr") if not p.name.startswith("."))
        if not stores:
            raise InputError(
                f"{path}: expected a folder with visibility kept by `prtcl relight`, it holds none"
            )
    found = []
    for own in stores:
        store = open_store(own)
        if verify:
            store.verify()
        bits = store.arrays["bits"]
        rows = int(bits.chunks[0])
        found.append(
            {
                "path": str(own),
                **store.attributes["made_of"],
                "rows": int(bits.shape[0]),
                "bytes": {"disk": store.disk_bytes, "raw": store.raw_bytes},
                "chunks": {"rows": rows, "number": -(-int(bits.shape[0]) // rows)},
                "format": store.attributes["format"],
                "verified": verify,
            }
        )
    return found


def lines(found: dict[str, Any]) -> list[tuple[str, str]]:
    """One store's names and values for people."""
    try:
        camera, rays, rows = found["camera"], found["rays"], found["rows"]
        width, height = camera["size"]
        disk, unit = found["bytes"]["disk"], rays["of"].removesuffix("s")
        told = [
            ("mesh", str(found["mesh"])),
            ("hash", found["mesh_sha256"]),
            ("view", f"{width} x {height} from {camera['eye']} to {camera['target']}, fov {camera['fov']:g}"),
            ("rays", f"of {rows} {rays['of']}, 4^{rays['levels']} a hemisphere"),
            ("bytes", f"{disk} on disk, {disk / rows:.0f} a {unit}; {found['bytes']['raw']} in memory"),
            ("chunks", f"{found['chunks']['number']} of {found['chunks']['rows']} {rays['of']}"),
            ("made by", f"prtcl {found['prtcl']}, embreex {found['embreex']}, format {found['format']}"),
        ]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{found['path']}: does not say what its visibility is of; delete it") from error
    return [*told, ("verified", "whole: everything was read")] if found["verified"] else told

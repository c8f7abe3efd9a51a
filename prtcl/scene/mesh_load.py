"""Loads a mesh file's raw geometry: chooses the reader, and checks what trimesh lets pass."""

from __future__ import annotations

import io
import logging
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.exchange.ply import load_ply
from trimesh.exchange.stl import load_stl
from trimesh.geometry import triangulate_quads

from prtcl.errors import InputError
from prtcl.scene.mesh_gltf import load_gltf_scene
from prtcl.scene.mesh_obj import load_obj
from prtcl.scene.mesh_raw import RawMesh, concatenate, not_read, single

# trimesh logs tracebacks of what it survives. Where the application sets up no logging, Python would print
# them to stderr beside our own message; this handler keeps them for applications that do.
logging.getLogger("trimesh").addHandler(logging.NullHandler())


def load_raw(path: Path) -> RawMesh:
    """Load a file by the reader of its extension.

    trimesh's format readers are called directly: they return the arrays as stored, so that normals are there
    exactly when the file has them, and nothing is merged, reordered or computed.

    Parameters
    ----------
    path : pathlib.Path
        A non-empty file with one of `EXTENSIONS`.

    Returns
    -------
    RawMesh
        Unchecked, see `mesh_check.check_raw`.

    Raises
    ------
    InputError
        The file cannot be read as what its extension says.
    """
    suffix = path.suffix.lower()
    with _damage_is_ours(path, suffix):
        return _READERS[suffix](path, path.read_bytes())


@contextmanager
def _damage_is_ours(path: Path, suffix: str) -> Iterator[None]:
    """Turn whatever a reader raises on a damaged file into one message."""
    kind = suffix.lstrip(".").upper()
    try:
        with warnings.catch_warnings():
            # numpy stops at the first bad number of a text with no more than this warning, and casts NaN to
            # an integer with a RuntimeWarning; either way the file is damaged.
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            warnings.filterwarnings("error", category=RuntimeWarning)
            yield
    except InputError:
        raise
    except Exception as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0][:160]
        raise InputError(
            f"{path}: cannot be read as a {kind} mesh, it is damaged, cut off or something else ({reason}); "
            "export it again"
        ) from error


def _read_ply(path: Path, data: bytes) -> RawMesh:
    """Read an ASCII or binary PLY."""
    end = re.search(rb"^end_header\s*?$\n?", data, re.MULTILINE)
    if not data.startswith(b"ply") or end is None:
        raise InputError(
            f"{path}: expected a PLY mesh, got no PLY header; the file is cut off or something else"
        )
    header = data[: end.start()]
    lengths = {
        name: int(count) for name, count in re.findall(rb"^element\s+(\S+)\s+(\d+)", header, re.MULTILINE)
    }
    ascii_rows = bool(re.search(rb"^format\s+ascii", header, re.MULTILINE))
    # In a text file trimesh takes fewer rows than announced without a word.
    rows = data.count(b"\n", end.end()) + (not data.endswith(b"\n"))
    if ascii_rows and rows < sum(lengths.values()):
        raise InputError(
            f"{path}: incomplete PLY mesh, the header announces {sum(lengths.values())} lines, got {rows}; "
            "copy or export it again"
        )
    try:
        # Splitting vertices for texture coordinates (fix_texture) would change their order.
        loaded = load_ply(io.BytesIO(data), fix_texture=False, skip_materials=True)
    except ValueError as error:
        if "unexpected length" not in str(error):
            raise
        raise InputError(
            f"{path}: binary PLY of another length than its header says: cut off, or mixing triangles "
            "with larger polygons; copy it again, or export triangles"
        ) from error
    if "vertices" not in loaded or loaded.get("faces") is None:
        count = lengths.get(b"vertex", 0)
        raise InputError(f"{path}: expected a mesh, got {count} vertices and no faces (a point cloud?)")
    _same_polygons(path, loaded)
    faces = np.asarray(loaded["faces"])
    if faces.ndim == 2 and faces.shape[1] > 3:
        faces = triangulate_quads(faces)
    mesh = single(loaded["vertices"], faces, loaded.get("vertex_normals"))
    if re.search(rb"^property\s+\S+\s+(diffuse_)?r(ed)?\s*$", header, re.MULTILINE):
        mesh.notes.append(not_read("vertex or face colours"))
    if re.search(rb"^comment\s+TextureFile\s", header, re.MULTILINE):
        mesh.notes.append(not_read("textures"))
    return mesh


def _same_polygons(path: Path, loaded: dict[str, Any]) -> None:
    """Refuse a binary PLY whose faces differ in size: trimesh takes the first one's size for all."""
    rows = loaded.get("metadata", {}).get("_ply_raw", {}).get("face", {}).get("data")
    for name in getattr(getattr(rows, "dtype", None), "names", None) or ():
        field = rows[name]
        if field.dtype.names == ("f0", "f1") and (field["f0"] != field["f1"].shape[1]).any():
            raise InputError(f"{path}: mixes polygons of several sizes in a binary PLY; export triangles")


def _read_stl(path: Path, data: bytes) -> RawMesh:
    """Read an ASCII or binary STL. Its normals belong to faces and follow from them, so none are returned."""
    if not data.lstrip().startswith(b"solid") and len(data) >= 84:
        count = int.from_bytes(data[80:84], "little")
        if len(data) != 84 + 50 * count:
            raise InputError(
                f"{path}: expected {84 + 50 * count} bytes for the {count} triangles of the binary STL, got "
                f"{len(data)}; the file is cut off or something else"
            )
    loaded = load_stl(io.BytesIO(data))
    solids = [loaded] if "vertices" in loaded else list(loaded.get("geometry", {}).values())
    if not solids:
        raise InputError(f"{path}: expected a mesh, got an STL without triangles, or one that is cut off")
    pieces = [single(solid["vertices"], solid["faces"]) for solid in solids]
    whole = concatenate(pieces)
    # A text file cut off in its second solid would otherwise come back as its first.
    binary = len(data) == 84 + 50 * len(whole.faces)
    rows = len(re.findall(rb"^\s*vertex\b", data, re.MULTILINE | re.IGNORECASE))
    if not binary and rows != len(whole.vertices):
        raise InputError(
            f"{path}: {rows} vertex lines, of which {len(whole.vertices)} lie in complete solids; "
            "the STL is cut off, export it again"
        )
    return whole


_READERS: dict[str, Callable[[Path, bytes], RawMesh]] = {
    ".obj": load_obj,
    ".ply": _read_ply,
    ".stl": _read_stl,
    ".glb": load_gltf_scene,
    ".gltf": load_gltf_scene,
}
EXTENSIONS = tuple(_READERS)

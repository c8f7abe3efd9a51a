"""Loads a mesh file's raw geometry: chooses the reader, and checks what trimesh lets pass."""

from __future__ import annotations

import io
import logging
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trimesh.exchange.ply import load_ply
from trimesh.exchange.stl import load_stl
from trimesh.geometry import triangulate_quads

from prtcl.errors import InputError
from prtcl.files.image import linear
from prtcl.scene.mesh_gltf import load_gltf_scene
from prtcl.scene.mesh_obj import load_obj
from prtcl.scene.mesh_raw import PartMaterial, RawMesh, concatenate, not_read, single
from prtcl.scene.texture import Texture, beside_by_name, decode_image, unread

# What exporters call the columns of a PLY.
_PLY_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_PLY_UV = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))

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
    notes: list[str] = []
    # trimesh's own picks of colours lose the type that tells sRGB from linear, and of texture coordinates those of
    # faces before those of vertices, so both are taken from the columns it read.
    elements = loaded.get("metadata", {}).get("_ply_raw", {})
    colours = _ply_colours(elements, notes)
    uv = _ply_uv(elements, notes)
    material = _ply_texture(path, header, uv is not None, notes)
    mesh = single(loaded["vertices"], faces, loaded.get("vertex_normals"), material, colours, uv)
    mesh.notes += notes
    return mesh


def _ply_columns(element: dict[str, Any], names: Sequence[str]) -> list[NDArray[Any]] | None:
    """Return the columns of these names as (n,) arrays, None where one is missing."""
    data = element.get("data")
    present = data if isinstance(data, dict) else (getattr(getattr(data, "dtype", None), "names", None) or ())
    if data is None or not all(name in present for name in names):
        return None
    return [np.asarray(data[name]).reshape(len(data[name])) for name in names]


def _ply_colours(elements: dict[str, Any], notes: list[str]) -> NDArray[np.float64] | None:
    """Return vertex colours as linear RGB: integers are sRGB, floats are taken as linear."""
    for names in _PLY_COLOURS:
        columns = _ply_columns(elements.get("vertex", {}), names)
        if columns is not None:
            values = np.stack(columns, axis=1)
            if values.dtype.kind == "f":
                return values.astype(np.float64)
            # Integers of any other size hold what bytes would.
            return linear(values / (65535.0 if values.dtype.itemsize == 2 else 255.0))
    if any(_ply_columns(elements.get("face", {}), names) is not None for names in _PLY_COLOURS):
        notes.append(not_read("colours of faces"))
    return None


def _ply_uv(elements: dict[str, Any], notes: list[str]) -> NDArray[np.float64] | None:
    """Return the texture coordinates of vertices, v turned to point down."""
    for names in _PLY_UV:
        columns = _ply_columns(elements.get("vertex", {}), names)
        if columns is not None:
            return np.stack((columns[0], 1.0 - columns[1]), axis=1).astype(np.float64)
    if "texcoord" in elements.get("face", {}).get("properties", {}):
        notes.append(not_read("texture coordinates of faces"))
    return None


def _ply_texture(path: Path, header: bytes, has_uv: bool, notes: list[str]) -> PartMaterial | None:
    """Return a material of the image that the header names: PLY has none, so it is white, rough and no metal."""
    names = re.findall(rb"^comment\s+TextureFile\s+(.*?)\s*$", header, re.MULTILINE | re.IGNORECASE)
    if not names:
        return None
    name = names[0].decode("utf-8", errors="replace")
    try:
        if not has_uv:
            raise ValueError("its vertices have no texture coordinates")
        if len(names) > 1:
            raise ValueError(f"it is one of {len(names)}, and nothing says which is where")
        image = decode_image(beside_by_name(path.parent, name))
    except Exception as error:  # whatever is wrong with an image, the geometry is good
        notes.append(unread("", name, error))
        return None
    return PartMaterial("", (1.0, 1.0, 1.0), 0.0, 1.0, Texture(image))


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

"""Reads glTF 2.0: trimesh decodes the accessors, this module places the parts and keeps exact factors.

trimesh's own scene rounds colour factors to 8 bits and passes over sparse, quantised and compressed geometry,
which comes out as zeros or unscaled integers; such files are refused here. It leaves colours as the integers that
are stored, drops those of another length without a word, and returns texture coordinates only with materials.
"""

from __future__ import annotations

import io
import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trimesh.exchange.gltf import load_glb, load_gltf
from trimesh.resolvers import FilePathResolver

from prtcl.errors import InputError
from prtcl.scene.mesh_gltf_nodes import Materials, Resources, placements
from prtcl.scene.mesh_raw import PartMaterial, RawMesh, concatenate, single

_JSON_CHUNK = 0x4E4F534A
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_FLOAT = 5126
_BYTE, _SHORT = 5121, 5123  # unsigned
_INDEX_TYPES = (_BYTE, _SHORT, 5125)
_COLOURS, _UV = "COLOR_0", "TEXCOORD_0"
# Required extensions that leave the geometry alone; any other may change it.
_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_xmp", "KHR_animation_")


def load_gltf_scene(path: Path, data: bytes) -> RawMesh:
    """Read a GLB or glTF file, flattened to one mesh.

    Parameters
    ----------
    path : pathlib.Path
        Where it lies; external buffers and images are looked up beside it.
    data : bytes
        Its contents.

    Returns
    -------
    RawMesh
        One part for each primitive of each node of the default scene, in depth-first file order, in world
        space. Normals, colours and texture coordinates are None where no part stores any.

    Raises
    ------
    InputError
        Damaged, or with geometry that cannot be decoded. Other exceptions of trimesh pass through.
    """
    binary = path.suffix.lower() == ".glb"
    text, rest = split_glb(path, data) if binary else (data, b"")
    tree = json.loads(text)
    if not isinstance(tree, dict):
        raise InputError(f"{path}: expected a glTF scene, got other JSON")
    version = str(tree.get("asset", {}).get("version", "2.0"))
    if not version.startswith("2"):
        raise InputError(f"{path}: expected glTF version 2, got {version}; export it as glTF 2.0")
    required = [name for name in tree.get("extensionsRequired", []) if not name.startswith(_HARMLESS)]
    if required:
        raise InputError(
            f"{path}: needs {', '.join(required)}, which is not supported; export it uncompressed"
        )
    notes: list[str] = []
    kept = _triangle_primitives(path, tree, notes)
    decoded = iter(_decode(path, tree, kept, rest, binary))
    materials = Materials(tree, Resources(path, tree, rest), notes)
    shapes = [[_shape(tree, primitive, next(decoded), materials) for primitive in mesh] for mesh in kept]
    pieces = [
        _placed(path, arrays, matrix, material)
        for mesh, matrix in placements(tree)
        for arrays, material in shapes[mesh]
    ]
    if not pieces:
        raise InputError(f"{path}: expected a mesh, got a glTF scene without triangles")
    whole = concatenate(pieces)
    whole.notes += list(dict.fromkeys(notes))  # instances repeat them
    return whole


def split_glb(path: Path, data: bytes) -> tuple[bytes, bytes]:
    """Return the JSON of a GLB and the chunks after it."""
    if data[:4] != b"glTF":
        raise InputError(f"{path}: expected a GLB mesh, got something else (the first bytes are not 'glTF')")
    version, length, size, kind = struct.unpack_from("<4I", data, 4)
    if version != 2 or kind != _JSON_CHUNK:
        raise InputError(f"{path}: expected GLB version 2, got version {version}; export it as glTF 2.0")
    if length > len(data) or 20 + size > length:
        raise InputError(
            f"{path}: incomplete GLB mesh, expected {length} bytes, got {len(data)}; copy or export it again"
        )
    return data[20 : 20 + size], data[20 + size : length]


def _triangle_primitives(path: Path, tree: dict[str, Any], notes: list[str]) -> list[list[dict[str, Any]]]:
    """Return each mesh's triangle primitives, with those attributes that are read and that trimesh can decode."""
    kept: list[list[dict[str, Any]]] = []
    skipped = 0
    for mesh in tree.get("meshes", []):
        triangles = []
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", _TRIANGLES)
            if mode == _FAN:
                raise InputError(f"{path}: holds triangle fans, which are not supported; export triangles")
            if mode not in (_TRIANGLES, _STRIP):
                skipped += 1
                continue
            attributes = primitive["attributes"]
            read = {"POSITION": attributes["POSITION"]}
            if "NORMAL" in attributes:
                read["NORMAL"] = attributes["NORMAL"]
            for accessor in read.values():
                _check_accessor(path, tree, accessor, (_FLOAT,), ("VEC3",))
            if "indices" in primitive:
                _check_accessor(path, tree, primitive["indices"], _INDEX_TYPES, ("SCALAR",))
            for name, kinds in ((_COLOURS, ("VEC3", "VEC4")), (_UV, ("VEC2",))):
                if name in attributes:
                    try:
                        _check_accessor(path, tree, attributes[name], (_FLOAT, _BYTE, _SHORT), kinds)
                        read[name] = attributes[name]
                    except InputError:  # no reason to refuse the geometry
                        notes.append(f"dropped a {name} that is sparse, compressed or of an unknown type")
            triangles.append(primitive | {"attributes": read})
        kept.append(triangles)
    if skipped:
        notes.append(f"left out {skipped} groups of points or lines")
    if tree.get("skins"):
        notes.append("skinning is not applied")
    return kept


def _check_accessor(
    path: Path, tree: dict[str, Any], index: int, types: tuple[int, ...], kinds: tuple[str, ...]
) -> None:
    """Refuse an accessor that trimesh would decode to zeros or to unscaled integers."""
    accessor = tree["accessors"][index]
    if accessor["componentType"] not in types or accessor["type"] not in kinds:
        raise InputError(f"{path}: holds quantised geometry, which is not supported; export it uncompressed")
    if "sparse" in accessor or "bufferView" not in accessor:
        raise InputError(f"{path}: holds sparse or compressed geometry; export it uncompressed")
    if "EXT_meshopt_compression" in tree["bufferViews"][accessor["bufferView"]].get("extensions", {}):
        raise InputError(f"{path}: holds meshopt compressed geometry; export it uncompressed")


def _decode(
    path: Path, tree: dict[str, Any], kept: list[list[dict[str, Any]]], rest: bytes, binary: bool
) -> list[dict[str, Any]]:
    """Return trimesh's arrays of every kept primitive, in order."""
    # Only what the arrays take: textures, cameras and names would be work, and reasons to fail. An underscore
    # marks an attribute of one's own, which trimesh hands through as it is stored.
    names = {"POSITION": "POSITION", "NORMAL": "NORMAL", _COLOURS: "_" + _COLOURS, _UV: "_" + _UV}
    reduced: dict[str, Any] = {
        key: tree[key] for key in ("asset", "accessors", "bufferViews", "buffers") if key in tree
    }
    reduced["meshes"] = [
        {
            "primitives": [
                {
                    "attributes": {names[name]: index for name, index in p["attributes"].items()},
                    **{key: p[key] for key in ("indices", "mode") if key in p},
                }
                for p in mesh
            ]
        }
        for mesh in kept
    ]
    text = json.dumps(reduced).encode()
    resolver = FilePathResolver(str(path))
    if binary:
        text += b" " * (-len(text) % 4)  # chunks are multiples of 4 bytes
        head = struct.pack("<5I", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), _JSON_CHUNK)
        loaded = load_glb(io.BytesIO(head + text + rest), resolver=resolver)
    else:
        loaded = load_gltf(io.BytesIO(text), resolver=resolver)
    arrays = list(loaded["geometry"].values())
    if len(arrays) != sum(len(mesh) for mesh in kept):
        raise ValueError("some of its parts cannot be decoded")
    return arrays


def _shape(
    tree: dict[str, Any], primitive: dict[str, Any], arrays: dict[str, Any], materials: Materials
) -> tuple[dict[str, Any], PartMaterial | None]:
    """Return a primitive's arrays with its "colours" and "uv" in the units of a RawMesh, and its material."""
    stored = arrays.get("vertex_attributes") or {}
    colours, uv = (stored.get("_" + name) for name in (_COLOURS, _UV))
    material, transform = materials.of(primitive)
    if colours is not None:
        # Linear, and fractions where they are integers: those have no other meaning in colours.
        arrays["colours"] = _fractions(colours)[:, :3]
    if uv is not None:
        if tree["accessors"][primitive["attributes"][_UV]].get("normalized", False):
            uv = _fractions(uv)
        with np.errstate(invalid="ignore", over="ignore"):  # infinite ones are dealt with later
            arrays["uv"] = uv.astype(np.float64) @ transform[:, :2].T + transform[:, 2]
    return arrays, material


def _fractions(stored: NDArray[Any]) -> NDArray[np.float64]:
    """Return unsigned integers as fractions of the largest, and floats as they are."""
    largest = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1.0
    return np.asarray(stored, dtype=np.float64) / largest


def _placed(
    path: Path, arrays: dict[str, Any], matrix: NDArray[np.float64], material: PartMaterial | None
) -> RawMesh:
    """Move one primitive to world space."""
    vertices = np.asarray(arrays["vertices"], dtype=np.float64)
    faces = np.asarray(arrays["faces"], dtype=np.int64)
    # Checked before parts are joined, where an index too high would reach into the next part.
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise InputError(
            f"{path}: a face points at vertex {faces.max()} of {len(vertices)}; the file is damaged"
        )
    notes: list[str] = []
    normals, colours, uv = (arrays.get(name) for name in ("vertex_normals", "colours", "uv"))
    if normals is not None and np.shape(normals) != vertices.shape:
        notes.append(f"dropped stored normals: {len(normals)} for {len(vertices)} vertices")
        normals = None
    if colours is not None and len(colours) != len(vertices):
        notes.append(f"dropped vertex colours: {len(colours)} for {len(vertices)} vertices")
        colours = None
    if uv is not None and len(uv) != len(vertices):
        notes.append(f"dropped texture coordinates: {len(uv)} for {len(vertices)} vertices")
        uv = None
        material = None if material is None else replace(material, texture=None)
    linear = matrix[:3, :3]
    mirrored = np.linalg.det(linear) < 0
    if normals is not None:
        # The cofactors are the inverse transpose times the determinant, and exist for flattening scales too.
        cofactors = np.stack([np.cross(linear[(i + 1) % 3], linear[(i + 2) % 3]) for i in range(3)])
        normals = np.asarray(normals, dtype=np.float64) @ cofactors.T * (-1.0 if mirrored else 1.0)
    if mirrored:
        faces = faces[:, ::-1]  # a mirror image turns the winding, as the glTF specification says
    piece = single(vertices @ linear.T + matrix[:3, 3], faces, normals, material, colours, uv)
    piece.notes += notes
    return piece

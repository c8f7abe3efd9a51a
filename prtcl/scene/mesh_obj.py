"""Reads Wavefront OBJ, its vertices in file order, with vertex colours, texture coordinates and materials.

trimesh's reader is not used for this format: it copies or drops vertices where there are several materials,
reverses the parts, mixes normals where a vertex has several, and counts relative indices from the end.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.files.image import linear
from prtcl.scene.mesh_mtl import joined_lines, materials_of
from prtcl.scene.mesh_raw import PartMaterial, RawMesh


class _Lines:
    """What the lines of an OBJ hold, gathered in order."""

    def __init__(self) -> None:
        self.vertices: list[tuple[float, float, float]] = []
        self.normals: list[tuple[float, float, float]] = []
        self.uv: list[tuple[float, float]] = []
        self.colours: list[tuple[float, float, float]] = []  # up to the last vertex that has one
        self.corners: list[int] = []  # vertex index of each triangle corner, from 0
        self.corner_normals: list[int] = []  # normal index likewise, -1 for none
        self.corner_uv: list[int] = []  # index of the texture coordinates likewise
        self.parts: list[int] = []
        self.keys: dict[tuple[str, str | None], int] = {}  # (object, material) to part
        self.libraries: list[str] = []
        self.known: dict[
            str, tuple[int, int, int]
        ] = {}  # corners parsed before, as each occurs about six times


def load_obj(path: Path, data: bytes) -> RawMesh:
    """Parse an OBJ file; polygons are cut into fans.

    Parameters
    ----------
    path : pathlib.Path
        Where it lies; material libraries are looked up beside it, and images beside those.
    data : bytes
        Its contents.

    Returns
    -------
    RawMesh
        A part for each pair of object and material. Vertices are those of the file; one that is used with
        several pairs of normal and texture coordinates appears once for each, next to each other.

    Raises
    ------
    InputError
        A line that cannot be parsed, or an index out of range.
    """
    if b"\0" in data:
        raise InputError(f"{path}: expected an OBJ mesh, which is text, got binary data")
    lines = _Lines()
    _parse(path, data, lines)
    vertices = np.array(lines.vertices, dtype=np.float64).reshape(-1, 3)
    corners = np.array(lines.corners, dtype=np.int64)
    outside = (corners < 0) | (corners >= len(vertices))
    if outside.any():
        face = int(outside.argmax()) // 3
        raise InputError(
            f"{path}: a face points outside the {len(vertices)} vertices, triangle {face} (from 0); "
            "the file is damaged"
        )
    notes: list[str] = []
    used = {material for _, material in lines.keys if material is not None}
    known = materials_of(path, lines.libraries, used, notes)
    materials: list[PartMaterial | None] = []
    for _, material in lines.keys:
        if material is not None and material not in known:
            notes.append(f"material '{material}' has no definition in an .mtl file")
        materials.append(known.get(material) if material is not None else None)
    raw = RawMesh(
        vertices, corners.reshape(-1, 3), None, np.array(lines.parts, dtype=np.int32), materials, notes
    )
    if lines.colours:
        white = [(1.0, 1.0, 1.0)] * (len(vertices) - len(lines.colours))
        raw.colours = linear(lines.colours + white)
    return _split(raw, lines)


def _parse(path: Path, data: bytes, lines: _Lines) -> None:
    """Gather the lines that matter."""
    current_object = ""
    material: str | None = None
    text = data.decode("utf-8", errors="replace")
    for number, line in joined_lines(text):
        words = line.split()
        if not words:
            continue
        try:
            match words[0]:
                case "v":
                    lines.vertices.append((float(words[1]), float(words[2]), float(words[3])))
                    if len(words) >= 7:
                        missing = len(lines.vertices) - 1 - len(lines.colours)
                        lines.colours += [(1.0, 1.0, 1.0)] * missing
                        lines.colours.append((float(words[4]), float(words[5]), float(words[6])))
                case "vn":
                    lines.normals.append((float(words[1]), float(words[2]), float(words[3])))
                case "vt":
                    # From the bottom of the image there, from the top in a Mesh.
                    lines.uv.append((float(words[1]), 1.0 - float(words[2]) if len(words) > 2 else 1.0))
                case "f":
                    part = lines.keys.setdefault((current_object, material), len(lines.keys))
                    _face(words[1:], part, lines)
                case "o":
                    current_object = line[1:].strip()
                case "usemtl":
                    material = line[6:].strip()
                case "mtllib":
                    lines.libraries.append(line[6:].strip())
        except (ValueError, IndexError) as error:
            raise InputError(
                f"{path}: line {number} cannot be read as OBJ: '{line[:60]}'; the file is damaged or cut off"
            ) from error


def _face(words: list[str], part: int, lines: _Lines) -> None:
    """Add a polygon as a fan of triangles."""
    if len(words) < 3:
        raise ValueError("fewer than three corners")
    corners = [lines.known.get(word) or _corner(word, lines) for word in words]
    first = corners[0]
    for second, third in pairwise(corners[1:]):
        lines.corners += (first[0], second[0], third[0])
        lines.corner_normals += (first[1], second[1], third[1])
        lines.corner_uv += (first[2], second[2], third[2])
        lines.parts.append(part)


def _corner(word: str, lines: _Lines) -> tuple[int, int, int]:
    """Return the vertex, normal and texture indices of one corner, such as "3", "3/1", "3//2" or "3/1/2"."""
    fields = word.split("/")
    stored = len(fields) > 2 and fields[2] != ""
    corner = (
        _index(fields[0], len(lines.vertices)),
        _index(fields[2], len(lines.normals)) if stored else -1,
        _texture_index(fields[1], len(lines.uv)) if len(fields) > 1 else -1,
    )
    if "-" not in word:  # a relative index means something else on the next line
        lines.known[word] = corner
    return corner


def _index(word: str, count: int) -> int:
    """Return an index from 0; negative ones count back from what was read so far."""
    value = int(word)
    if value == 0 or value < -count or value > 2**31:
        raise ValueError("index out of range")
    return value - 1 if value > 0 else count + value


def _texture_index(word: str, count: int) -> int:
    """Return an index like `_index`, but -1 for what is none: no reason to refuse the geometry."""
    try:
        return _index(word, count)
    except ValueError:
        return -1


def _split(raw: RawMesh, lines: _Lines) -> RawMesh:
    """Give each vertex one of its own for every pair of normal and texture coordinates, in file order."""
    corners = raw.faces.reshape(-1)
    normals, normal = _stored(lines.normals, lines.corner_normals, 3, "normal", raw.notes)
    uv, texel = _stored(lines.uv, lines.corner_uv, 2, "texture coordinate", raw.notes)
    if normals is None and uv is None:
        return raw
    loose = np.setdiff1d(np.arange(len(raw.vertices)), corners)  # kept, so that the order is the file's
    # The last rows serve -1, none, and come last among the copies of a vertex.
    steps = [1 if stored is None else len(stored) for stored in (normals, uv)]
    pairs = (normal % steps[0]) * steps[1] + texel % steps[1]
    pairs = np.concatenate((pairs, np.full(len(loose), steps[0] * steps[1] - 1)))
    # Numbered anew, as a product of all three counts may pass 64 bits.
    kinds, kind = np.unique(pairs, return_inverse=True)
    keys = np.concatenate((corners, loose)) * len(kinds) + kind.reshape(-1)
    unique, inverse = np.unique(keys, return_inverse=True)
    vertex, pair = unique // len(kinds), kinds[unique % len(kinds)]
    raw.vertices = raw.vertices[vertex]
    raw.colours = None if raw.colours is None else raw.colours[vertex]
    raw.normals = None if normals is None else normals[pair // steps[1]]
    raw.faces = inverse.reshape(-1)[: len(corners)].reshape(-1, 3)
    if uv is not None:
        raw.uv = uv[pair % steps[1]]
        same = np.zeros(len(unique), dtype=np.bool_)
        same[1:] = (np.diff(vertex) == 0) & (np.diff(pair // steps[1]) == 0)
        if same.any():
            raw.twins = np.maximum.accumulate(np.where(same, 0, np.arange(len(unique))))
        _note_bare_corners(raw, texel)
    return raw


def _stored(
    rows: list[Any], index: list[int], columns: int, what: str, notes: list[str]
) -> tuple[NDArray[np.float64] | None, NDArray[np.int64]]:
    """Return stored rows, then one of zeros, and each corner's index; None where they are not used or do not fit."""
    used = np.array(index, dtype=np.int64)
    if not len(used) or used.max() < 0:
        return None, np.zeros(len(used), dtype=np.int64)
    if used.max() >= len(rows):
        notes.append(f"dropped stored {what}s: a face names {what} {used.max() + 1} of {len(rows)}")
        return None, np.zeros(len(used), dtype=np.int64)
    return np.vstack((rows, np.zeros(columns))), used


def _note_bare_corners(raw: RawMesh, texel: NDArray[np.int64]) -> None:
    """Tell of triangles of a textured part that have no texture coordinates."""
    bare = (texel < 0).reshape(-1, 3).any(axis=1)
    for part, material in enumerate(raw.materials):
        count = int((bare & (raw.parts == part)).sum())
        if material is not None and material.texture is not None and count:
            raw.notes.append(
                f"material '{material.name}': {count} triangles without texture coordinates take those of (0, 0)"
            )

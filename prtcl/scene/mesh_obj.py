"""Reads Wavefront OBJ with its vertices in file order.

trimesh's reader is not used for this format: it copies or drops vertices where there are several materials,
reverses the parts, mixes normals where a vertex has several, and counts relative indices from the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.scene.mesh_raw import PartMaterial, RawMesh, not_read


class _Lines:
    """What the lines of an OBJ hold, gathered in order."""

    def __init__(self) -> None:
        self.vertices: list[tuple[float, float, float]] = []
        self.normals: list[tuple[float, float, float]] = []
        self.corners: list[int] = []  # vertex index of each triangle corner, from 0
        self.corner_normals: list[int] = []  # normal index likewise, -1 for none
        self.parts: list[int] = []
        self.keys: dict[tuple[str, str | None], int] = {}  # (object, material) to part
        self.libraries: list[str] = []
        self.coloured = False  # a vertex line has red, green and blue after its position
        self.known: dict[str, tuple[int, int]] = {}  # corners parsed before, as each occurs about six times


def load_obj(path: Path, data: bytes) -> RawMesh:
    """Parse an OBJ file; polygons are cut into fans.

    Parameters
    ----------
    path : pathlib.Path
        Where it lies; material libraries are looked up beside it.
    data : bytes
        Its contents.

    Returns
    -------
    RawMesh
        A part for each pair of object and material. Vertices are those of the file; one that is used with
        several normals appears once for each, next to each other.

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
    notes = [not_read("vertex colours")] if lines.coloured else []
    known = _materials(path, lines.libraries, notes)
    materials: list[PartMaterial | None] = []
    for _, material in lines.keys:
        if material is not None and material not in known:
            notes.append(f"material '{material}' has no definition in an .mtl file")
        materials.append(known.get(material) if material is not None else None)
    raw = RawMesh(
        vertices, corners.reshape(-1, 3), None, np.array(lines.parts, dtype=np.int32), materials, notes
    )
    return _with_normals(raw, lines)


def _parse(path: Path, data: bytes, lines: _Lines) -> None:
    """Gather the lines that matter."""
    current_object = ""
    material: str | None = None
    text = data.decode("utf-8", errors="replace")
    for number, line in _joined(text):
        words = line.split()
        if not words:
            continue
        try:
            match words[0]:
                case "v":
                    lines.vertices.append((float(words[1]), float(words[2]), float(words[3])))
                    lines.coloured |= len(words) >= 7
                case "vn":
                    lines.normals.append((float(words[1]), float(words[2]), float(words[3])))
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


def _joined(text: str) -> Iterator[tuple[int, str]]:
    """Yield numbered lines without comments, those ending in a backslash joined with the next."""
    held = ""
    for number, line in enumerate(text.split("\n"), start=1):
        line = held + line.split("#", 1)[0].strip()
        held = ""
        if line.endswith("\\"):
            held = line[:-1] + " "
            continue
        yield number, line
    if held:
        yield number, held


def _face(words: list[str], part: int, lines: _Lines) -> None:
    """Add a polygon as a fan of triangles."""
    if len(words) < 3:
        raise ValueError("fewer than three corners")
    corners = [lines.known.get(word) or _corner(word, lines) for word in words]
    first = corners[0]
    for second, third in pairwise(corners[1:]):
        lines.corners += (first[0], second[0], third[0])
        lines.corner_normals += (first[1], second[1], third[1])
        lines.parts.append(part)


def _corner(word: str, lines: _Lines) -> tuple[int, int]:
    """Return the vertex and normal indices of one corner, such as "3", "3/1", "3//2" or "3/1/2"."""
    fields = word.split("/")
    stored = len(fields) > 2 and fields[2] != ""
    corner = (
        _index(fields[0], len(lines.vertices)),
        _index(fields[2], len(lines.normals)) if stored else -1,
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


def _with_normals(raw: RawMesh, lines: _Lines) -> RawMesh:
    """Give each pair of vertex and normal a vertex of its own, in file order."""
    used = np.array(lines.corner_normals, dtype=np.int64)
    if not len(used) or used.max() < 0:
        return raw
    if used.max() >= len(lines.normals):
        raw.notes.append(
            f"dropped stored normals: a face names normal {used.max() + 1} of {len(lines.normals)}"
        )
        return raw
    stored: NDArray[Any] = np.vstack((lines.normals, np.zeros(3)))  # the last row serves -1, none
    step = len(stored)
    corners = raw.faces.reshape(-1)
    loose = np.setdiff1d(np.arange(len(raw.vertices)), corners)  # kept, so that the order is the file's
    pairs = np.concatenate((corners * step + used % step, loose * step + step - 1))
    unique, inverse = np.unique(pairs, return_inverse=True)
    raw.vertices = raw.vertices[unique // step]
    raw.normals = stored[unique % step]
    raw.faces = inverse[: len(corners)].reshape(-1, 3)
    return raw


def _materials(path: Path, libraries: list[str], notes: list[str]) -> dict[str, PartMaterial]:
    """Read the factors of every material of the libraries that exist."""
    found: dict[str, PartMaterial] = {}
    for library in dict.fromkeys(libraries):
        try:
            text = (path.parent / library).read_text(encoding="utf-8", errors="replace")
        except (OSError, ValueError):
            notes.append(f"material library '{library}' is not there or cannot be read")
            continue
        entries: dict[str, dict[str, list[str]]] = {}
        for _, line in _joined(text):
            words = line.split()
            if len(words) < 2:
                continue
            if words[0] == "newmtl":
                entry = entries.setdefault(line[6:].strip(), {})
            elif entries:
                entry[words[0]] = words[1:]
        for name, entry in entries.items():
            found.setdefault(name, _material(name, entry))
            if any(key.startswith("map_") for key in entry):
                notes.append(f"material '{name}': textures are not read, its factors are used alone")
    return found


def _material(name: str, entry: dict[str, list[str]]) -> PartMaterial:
    """Map an MTL entry to metallic-roughness: Kd, Pm and Pr, or roughness from the exponent Ns."""
    try:
        red, green, blue = (min(max(float(word), 0.0), 1.0) for word in (entry.get("Kd", []) * 3)[:3])
    except ValueError:
        red = green = blue = 0.8  # the format's usual default; also for spectral colours
    exponent = _number(entry, "Ns", 0.0)
    # alpha = sqrt(2 / (Ns + 2)) matches the width of a Blinn-Phong lobe, and alpha = roughness squared.
    roughness = _number(entry, "Pr", (2.0 / (max(exponent, 0.0) + 2.0)) ** 0.25)
    return PartMaterial(name, (red, green, blue), _number(entry, "Pm", 0.0), min(max(roughness, 0.0), 1.0))


def _number(entry: dict[str, list[str]], key: str, default: float) -> float:
    """Return the first number of a key, or the default."""
    try:
        value = float(entry[key][0])
    except (KeyError, IndexError, ValueError):
        return default
    return value if np.isfinite(value) else default

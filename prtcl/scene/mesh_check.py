"""Checks raw geometry: refuses what cannot be rendered, repairs what can, and notes each repair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.scene.mesh_normals import face_vectors, normalised, vertex_normals
from prtcl.scene.mesh_raw import PartMaterial, RawMesh

# Twice the area below which a triangle counts as having none, in units of the squared bounding box diagonal.
# An edge of 1e-7 diagonals is what float32 positions resolve.
DEGENERATE = 1e-14
OVERSHOOT = 1e-3  # of a colour beyond 0 to 1, above which clipping it is worth a note
LARGEST = 1e30  # rays are traced in float32, which a product of larger coordinates overflows


def check_raw(raw: RawMesh, where: str) -> RawMesh:
    """Return the mesh with float64 vertices, int32 faces and parts, float32 unit normals, colours and uv, all valid.

    Parameters
    ----------
    raw : RawMesh
        Unchecked; not modified.
    where : str
        The file or the name that messages begin with.

    Returns
    -------
    RawMesh
        Vertices are those of `raw`; degenerate triangles are dropped; colours are 0 to 1; textures are dropped where
        there are no texture coordinates. `notes` tell of every change.

    Raises
    ------
    InputError
        No vertices or faces, wrong shapes, vertices that are not finite or beyond 1e30, indices out of range,
        or only degenerate triangles.
    """
    vertices = _vertices(raw.vertices, where)
    faces = _faces(raw.faces, len(vertices), where)
    parts = np.asarray(raw.parts, dtype=np.int32)
    notes = list(raw.notes)

    keep = ~_degenerate(vertices, faces)
    dropped = int((~keep).sum())
    if dropped == len(faces):
        raise InputError(f"{where}: all {dropped} triangles are degenerate (no area); export the mesh again")
    if dropped:
        notes.append(f"dropped {dropped} degenerate triangles of {len(faces)}")
        faces, parts = faces[keep], parts[keep]

    twins = None if raw.twins is None else np.asarray(raw.twins, dtype=np.int32)
    normals = None if raw.normals is None else _normals(raw.normals, vertices, faces, twins, notes)
    colours = None if raw.colours is None else _colours(raw.colours, len(vertices), notes)
    uv = None if raw.uv is None else _uv(raw.uv, len(vertices), notes)
    return replace(
        raw,
        vertices=vertices,
        faces=faces,
        normals=normals,
        parts=parts,
        materials=raw.materials if uv is not None else _untextured(raw.materials, notes),
        notes=notes,
        colours=colours,
        uv=uv,
        twins=twins,
    )


def _vertices(raw: NDArray[Any], where: str) -> NDArray[np.float64]:
    """Return the vertices as (n, 3) float64, all finite."""
    if raw.size == 0:
        raise InputError(f"{where}: expected a mesh, got no vertices; check what was exported")
    if raw.ndim != 2 or raw.shape[1] != 3 or raw.dtype.kind not in "fiu":
        raise InputError(f"{where}: expected vertices of shape (n, 3), got {raw.shape} of {raw.dtype}")
    with np.errstate(over="ignore"):  # beyond float64 is infinite, and refused below
        vertices = np.ascontiguousarray(raw, dtype=np.float64)
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise InputError(
            f"{where}: {int(bad.sum())} of {len(vertices)} vertices are NaN or infinite, the first is vertex "
            f"{int(bad.argmax())} (from 0); export the mesh again"
        )
    far = np.abs(vertices) > LARGEST
    if far.any():
        raise InputError(
            f"{where}: vertex {int(far.any(axis=1).argmax())} (from 0) has a coordinate beyond {LARGEST:g}; "
            "the file is damaged or needs scaling down"
        )
    return vertices


def _faces(raw: NDArray[Any], count: int, where: str) -> NDArray[np.int32]:
    """Return the faces as (m, 3) int32, all within `count` vertices."""
    if raw.size == 0:
        raise InputError(f"{where}: expected a mesh, got {count} vertices and no faces (a point cloud?)")
    if raw.ndim != 2 or raw.shape[1] != 3 or raw.dtype.kind not in "iu":
        raise InputError(
            f"{where}: expected triangles, integers of shape (m, 3), got {raw.shape} of "
            f"{raw.dtype}; triangulate it"
        )
    if count > np.iinfo(np.int32).max:
        raise InputError(f"{where}: {count} vertices are more than 32-bit indices reach; split the mesh")
    bad = ((raw < 0) | (raw >= count)).any(axis=1)
    if bad.any():
        first = int(bad.argmax())
        raise InputError(
            f"{where}: {int(bad.sum())} of {len(raw)} faces point outside the {count} vertices, the first is "
            f"face {first} (from 0) with {raw[first].tolist()}; the file is damaged"
        )
    return np.ascontiguousarray(raw, dtype=np.int32)


def _degenerate(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Mark triangles that repeat a vertex or have no area relative to the size of the mesh."""
    a, b, c = faces.T
    used = vertices[faces.reshape(-1)]
    low, high = used.min(axis=0), used.max(axis=0)
    scale = float(np.linalg.norm(high - low))
    if scale == 0.0:
        return np.ones(len(faces), dtype=np.bool_)
    # Scaled to the unit box first, so that tiny and huge meshes neither under- nor overflow.
    doubled = np.linalg.norm(face_vectors((vertices - low) / scale, faces), axis=1)
    return np.asarray((a == b) | (b == c) | (c == a) | (doubled <= DEGENERATE))


def _normals(
    raw: NDArray[Any],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    twins: NDArray[np.int32] | None,
    notes: list[str],
) -> NDArray[np.float32] | None:
    """Return stored normals as float32 units, with missing ones filled in; None where they do not fit."""
    if raw.shape != vertices.shape or raw.dtype.kind not in "fiu":
        notes.append(f"dropped stored normals: {len(raw)} for {len(vertices)} vertices")
        return None
    with np.errstate(over="ignore"):
        stored = np.array(raw, dtype=np.float64)
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces.reshape(-1)] = True
    finite = np.isfinite(stored).all(axis=1)
    stored[~finite] = 0.0
    units = normalised(stored)
    bad = ~units.any(axis=1)
    if bad.any():
        one = np.arange(len(vertices)) if twins is None else twins
        units[bad] = vertex_normals(vertices, one[faces], "area")[one[bad]]
        # A vertex that no triangle uses is never seen; only the others are worth a word.
        count = int((bad & used).sum())
        if count:
            notes.append(f"replaced {count} zero or NaN normals of {len(units)} by those of the geometry")
    mean = units[faces].sum(axis=1)
    against = int((np.einsum("ij,ij->i", face_vectors(vertices, faces), mean) < 0).sum())
    if 2 * against > len(faces):
        notes.append(
            f"the stored normals point against the winding of {against} of {len(faces)} triangles; "
            "both are kept"
        )
    return units.astype(np.float32)


def _colours(raw: NDArray[Any], count: int, notes: list[str]) -> NDArray[np.float32] | None:
    """Return vertex colours as float32 in 0 to 1; None where they do not fit."""
    colours = _fitting(raw, (count, 3), "vertex colours", notes)
    if colours is None:
        return None
    bad = np.isnan(colours)
    if bad.any():
        notes.append(f"replaced {int(bad.any(axis=1).sum())} NaN vertex colours of {count} by 1")
        colours[bad] = 1.0
    beyond = ((colours < -OVERSHOOT) | (colours > 1.0 + OVERSHOOT)).any(axis=1)
    if beyond.any():
        notes.append(
            f"clipped {int(beyond.sum())} vertex colours of {count} to 0 to 1; they go from "
            f"{colours.min():g} to {colours.max():g}"
        )
    return np.clip(colours, 0.0, 1.0)


def _uv(raw: NDArray[Any], count: int, notes: list[str]) -> NDArray[np.float32] | None:
    """Return texture coordinates as finite float32; None where they do not fit."""
    uv = _fitting(raw, (count, 2), "texture coordinates", notes)
    if uv is None:
        return None
    bad = ~np.isfinite(uv).all(axis=1)
    if bad.any():
        notes.append(f"replaced {int(bad.sum())} NaN or infinite texture coordinates of {count} by 0")
        uv[bad] = 0.0
    return uv


def _fitting(
    raw: NDArray[Any], shape: tuple[int, int], what: str, notes: list[str]
) -> NDArray[np.float32] | None:
    """Return a float32 copy of numbers of this shape; None and a note for others."""
    if raw.shape != shape or raw.dtype.kind not in "fiu":
        notes.append(f"dropped {what}: expected shape {shape}, got {raw.shape} of {raw.dtype}")
        return None
    with np.errstate(over="ignore"):  # beyond float32 is infinite, and dealt with as that
        return np.array(raw, dtype=np.float32, order="C")


def _untextured(materials: Sequence[PartMaterial | None], notes: list[str]) -> list[PartMaterial | None]:
    """Return the materials without their textures, which need coordinates."""
    if any(material is not None and material.texture is not None for material in materials):
        notes.append(
            "has no texture coordinates that its textures could be read with; the factors are used alone"
        )
    return [None if material is None else replace(material, texture=None) for material in materials]

"""What a mesh file holds before it is checked: arrays in file order, parts, materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PartMaterial:
    """The metallic-roughness factors a file gives a part of a mesh.

    Attributes
    ----------
    name : str
        The material's name in the file, empty where it has none.
    base_color : tuple of 3 floats
        Linear RGB.
    metallic, roughness : float
        0 to 1, as glTF defines them.
    """

    name: str
    base_color: tuple[float, float, float]
    metallic: float
    roughness: float


@dataclass
class RawMesh:
    """Unchecked geometry.

    Attributes
    ----------
    vertices : (n, 3) array
        Positions in the file's units.
    faces : (m, 3) int array
        Vertex indices; they may be out of range.
    normals : (k, 3) array or None
        Stored normals, None where the file has none. Rows of zeros mark vertices without one.
    parts : (m,) int array
        Index into `materials` of each face.
    materials : sequence of PartMaterial or None
        One entry a part.
    notes : list of str
        What the reader found worth telling.
    """

    vertices: NDArray[Any]
    faces: NDArray[Any]
    normals: NDArray[Any] | None
    parts: NDArray[Any]
    materials: Sequence[PartMaterial | None] = (None,)
    notes: list[str] = field(default_factory=list)


def not_read(what: str) -> str:
    """The note on a file's vertex colours or textures."""
    return f"has {what}, which are not read yet; --brdf or the file's material factors say what colour it is"


def single(vertices: Any, faces: Any, normals: Any = None, material: PartMaterial | None = None) -> RawMesh:
    """Wrap the arrays of one part.

    Parameters
    ----------
    vertices : (n, 3) array
    faces : (m, 3) int array
    normals : (k, 3) array, optional
    material : PartMaterial, optional

    Returns
    -------
    RawMesh
    """
    triangles = np.asarray(faces)
    return RawMesh(
        np.asarray(vertices),
        triangles,
        None if normals is None else np.asarray(normals),
        np.zeros(len(triangles) if triangles.ndim else 0, dtype=np.int32),
        (material,),
    )


def concatenate(pieces: Sequence[RawMesh]) -> RawMesh:
    """Join single-part meshes into one, a part each, in order.

    Where some pieces store normals and others do not, the others get rows of zeros, to be filled in later.

    Parameters
    ----------
    pieces : sequence of RawMesh
        At least one, with (n, 3) arrays; normals, if any, as many as vertices.

    Returns
    -------
    RawMesh
    """
    counts = [len(piece.vertices) for piece in pieces]
    offsets = np.concatenate(([0], np.cumsum(counts)[:-1]))
    normals: NDArray[Any] | None = None
    notes = [note for piece in pieces for note in piece.notes]
    bare = sum(piece.normals is None for piece in pieces)
    if bare < len(pieces):
        normals = np.concatenate(
            [
                np.zeros((count, 3)) if p.normals is None else p.normals
                for p, count in zip(pieces, counts, strict=True)
            ]
        )
        if bare:
            notes.append(f"{bare} of {len(pieces)} parts store no normals and take those of their geometry")
    return RawMesh(
        np.concatenate([piece.vertices for piece in pieces]),
        np.concatenate([piece.faces.astype(np.int64) + o for piece, o in zip(pieces, offsets, strict=True)]),
        normals,
        np.repeat(np.arange(len(pieces), dtype=np.int32), [len(piece.faces) for piece in pieces]),
        tuple(piece.materials[0] for piece in pieces),
        notes,
    )

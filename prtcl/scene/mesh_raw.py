"""What a mesh file holds before it is checked: arrays in file order, parts, materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prtcl.scene.texture import Texture


@dataclass(frozen=True)
class PartMaterial:
    """The metallic-roughness factors a file gives a part of a mesh, and its base colour texture.

    Attributes
    ----------
    name : str
        The material's name in the file, empty where it has none.
    base_color : tuple of 3 floats
        Linear RGB.
    metallic, roughness : float
        0 to 1, as glTF defines them.
    texture : Texture or None
        What multiplies `base_color` over the part, at the mesh's texture coordinates.
    """

    name: str
    base_color: tuple[float, float, float]
    metallic: float
    roughness: float
    texture: Texture | None = None


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
    colours : (k, 3) array or None
        Linear RGB of each vertex, None where the file has none.
    uv : (k, 2) array or None
        Texture coordinates of each vertex, v down from the top of the image.
    twins : (n,) int array or None
        See `prtcl.scene.mesh.Mesh`.
    """

    vertices: NDArray[Any]
    faces: NDArray[Any]
    normals: NDArray[Any] | None
    parts: NDArray[Any]
    materials: Sequence[PartMaterial | None] = (None,)
    notes: list[str] = field(default_factory=list)
    colours: NDArray[Any] | None = None
    uv: NDArray[Any] | None = None
    twins: NDArray[Any] | None = None


def not_read(what: str) -> str:
    """The note on colours that a file has in a way that is not read."""
    return f"has {what}, which are not read yet; --brdf or the file's material factors say what colour it is"


def single(
    vertices: Any,
    faces: Any,
    normals: Any = None,
    material: PartMaterial | None = None,
    colours: Any = None,
    uv: Any = None,
) -> RawMesh:
    """Wrap the arrays of one part.

    Parameters
    ----------
    vertices : (n, 3) array
    faces : (m, 3) int array
    normals : (k, 3) array, optional
    material : PartMaterial, optional
    colours : (k, 3) array, optional
    uv : (k, 2) array, optional

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
        colours=None if colours is None else np.asarray(colours),
        uv=None if uv is None else np.asarray(uv),
    )


def concatenate(pieces: Sequence[RawMesh]) -> RawMesh:
    """Join single-part meshes into one, a part each, in order.

    Where some pieces store normals and others do not, the others get rows of zeros, to be filled in later;
    likewise white for colours, and zeros for texture coordinates, which a part without a texture never uses.

    Parameters
    ----------
    pieces : sequence of RawMesh
        At least one, with (n, 3) arrays; normals, colours and texture coordinates, if any, as many as vertices.

    Returns
    -------
    RawMesh
    """
    offsets = np.concatenate(([0], np.cumsum([len(piece.vertices) for piece in pieces])[:-1]))
    notes = [note for piece in pieces for note in piece.notes]
    bare = sum(piece.normals is None for piece in pieces)
    if 0 < bare < len(pieces):
        notes.append(f"{bare} of {len(pieces)} parts store no normals and take those of their geometry")
    return RawMesh(
        np.concatenate([piece.vertices for piece in pieces]),
        np.concatenate([piece.faces.astype(np.int64) + o for piece, o in zip(pieces, offsets, strict=True)]),
        _filled(pieces, [piece.normals for piece in pieces], (3, 0.0)),
        np.repeat(np.arange(len(pieces), dtype=np.int32), [len(piece.faces) for piece in pieces]),
        tuple(piece.materials[0] for piece in pieces),
        notes,
        _filled(pieces, [piece.colours for piece in pieces], (3, 1.0)),
        _filled(pieces, [piece.uv for piece in pieces], (2, 0.0)),
    )


def _filled(
    pieces: Sequence[RawMesh], arrays: Sequence[NDArray[Any] | None], otherwise: tuple[int, float]
) -> NDArray[Any] | None:
    """Join what belongs to the vertices, with (columns, value) where a piece has none; None where all have none."""
    if all(array is None for array in arrays):
        return None
    columns, value = otherwise
    return np.concatenate(
        [
            np.full((len(piece.vertices), columns), value) if array is None else array
            for piece, array in zip(pieces, arrays, strict=True)
        ]
    )

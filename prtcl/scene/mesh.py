"""Triangle meshes as the renderer takes them, and reading them from files."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prtcl.errors import InputError
from prtcl.files.source import check_source
from prtcl.scene.mesh_check import check_raw
from prtcl.scene.mesh_load import EXTENSIONS, load_raw
from prtcl.scene.mesh_normals import vertex_normals
from prtcl.scene.mesh_raw import PartMaterial, RawMesh, single

__all__ = ["EXTENSIONS", "Mesh", "PartMaterial", "read_mesh"]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh that passed the checks of `from_arrays` or `read_mesh`.

    Attributes
    ----------
    name : str
        The file's name without its extension, or what the caller chose.
    vertices : (n, 3) float64
        Positions in the file's units, in file order, finite.
    faces : (m, 3) int32
        Vertex indices, m of at least 1, no triangle degenerate.
    normals : (n, 3) float32 or None
        Unit vertex normals as stored, None where the file has none.
    parts : (m,) int32
        Index into `materials` of each face.
    materials : tuple of PartMaterial or None
        One entry a part, None where the file names no material. A part may have no faces left.
    notes : tuple of str
        What was repaired or left out, a line each.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32] | None
    parts: NDArray[np.int32]
    materials: tuple[PartMaterial | None, ...]
    notes: tuple[str, ...]

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) float64: the lowest and highest coordinates of the vertices that triangles use."""
        used = self.vertices[self.faces.reshape(-1)]
        return np.stack((used.min(axis=0), used.max(axis=0)))

    @property
    def scale(self) -> float:
        """The diagonal of the bounding box, in the file's units, above 0."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    def smooth(self) -> Mesh:
        """Return the mesh with vertex normals averaged over its triangles, in place of any stored ones.

        Triangles weigh by their angle at the vertex. Vertices are not merged, so edges stay hard where the
        file has several vertices in one place (as STL has everywhere).

        Returns
        -------
        Mesh
            A new mesh that shares the other arrays.
        """
        normals = vertex_normals(self.vertices, self.faces, "angle").astype(np.float32)
        return replace(self, normals=normals)

    @classmethod
    def from_arrays(
        cls, vertices: ArrayLike, faces: ArrayLike, normals: ArrayLike | None = None, name: str = "mesh"
    ) -> Mesh:
        """Make a mesh of one part without a material, checked like a file.

        Parameters
        ----------
        vertices : (n, 3) array of numbers
            Positions.
        faces : (m, 3) array of int
            Vertex indices.
        normals : (n, 3) array of numbers, optional
            Vertex normals of any length.
        name : str
            Name of the mesh, which error messages begin with.

        Returns
        -------
        Mesh

        Raises
        ------
        InputError
            See `read_mesh`, which makes the same checks.
        """
        try:
            raw = single(vertices, faces, normals)
        except ValueError as error:  # numpy's word for rows of different lengths
            raise InputError(
                f"{name}: vertices, faces and normals must be rectangular arrays: {error}"
            ) from error
        return _mesh(raw, name, name)


def read_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read an OBJ, PLY, STL, GLB or glTF file.

    Vertices keep the order and the number of the file, and nothing is merged; two exceptions are needed: an
    OBJ vertex with several normals becomes several vertices, and STL has three vertices a triangle. Scenes
    are flattened with the transforms of their nodes, one part for each object and material.

    Parameters
    ----------
    path : str or os.PathLike
        The file.

    Returns
    -------
    Mesh
        Polygons cut into triangles, degenerate triangles dropped, normals of zero length or NaN replaced.

    Raises
    ------
    InputError
        The file is missing, of an unknown kind, truncated or damaged; has no vertices or no faces; has
        vertices that are not finite, faces that point outside the vertices, or only degenerate triangles.
    """
    source = check_source(path, EXTENSIONS, "a mesh")
    return _mesh(load_raw(source), source.stem, str(source))


def _mesh(raw: RawMesh, name: str, where: str) -> Mesh:
    """Check raw geometry and make it a Mesh."""
    checked = check_raw(raw, where)
    return Mesh(
        name=name,
        vertices=checked.vertices,
        faces=checked.faces,
        normals=checked.normals,
        parts=checked.parts,
        materials=tuple(checked.materials),
        notes=tuple(checked.notes),
    )

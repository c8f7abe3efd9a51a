"""Triangle meshes as the renderer takes them, and reading them from files."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from prtcl.errors import InputError
from prtcl.files.source import check_source
from prtcl.scene.mesh_check import check_raw
from prtcl.scene.mesh_load import EXTENSIONS, load_raw
from prtcl.scene.mesh_normals import vertex_normals
from prtcl.scene.mesh_raw import PartMaterial, RawMesh, single
from prtcl.scene.texture import Texture

__all__ = ["EXTENSIONS", "Mesh", "PartMaterial", "Texture", "read_mesh"]


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
    colours : (n, 3) float32 or None
        Linear RGB of each vertex, 0 to 1; None where the file has none.
    uv : (n, 2) float32 or None
        Texture coordinates of each vertex: u to the right, v down, (0, 0) at the image's top left corner.
    twins : (n,) int32 or None
        For each vertex the first of those that an OBJ's texture seams made of one, itself where nothing was split;
        `smooth` takes them as one. None where no vertex was.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32] | None
    parts: NDArray[np.int32]
    materials: tuple[PartMaterial | None, ...]
    notes: tuple[str, ...]
    colours: NDArray[np.float32] | None = None
    uv: NDArray[np.float32] | None = None
    twins: NDArray[np.int32] | None = None

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
        file has several vertices in one place (as STL has everywhere). What a texture seam split stays smooth.

        Returns
        -------
        Mesh
            A new mesh that shares the other arrays.
        """
        faces = self.faces if self.twins is None else self.twins[self.faces]
        normals = vertex_normals(self.vertices, faces, "angle").astype(np.float32)
        return replace(self, normals=normals if self.twins is None else normals[self.twins])

    @cached_property
    def coloured(self) -> NDArray[np.bool_]:
        """(parts,) bool: whether a part has colours of its own: vertex colours not all of them white, or a texture."""
        varies = np.zeros(len(self.materials), dtype=np.bool_)
        if self.colours is not None:
            other = (self.colours != 1.0).any(axis=1)
            varies[self.parts[other[self.faces].any(axis=1)]] = True
        if self.uv is not None:
            varies |= [material is not None and material.texture is not None for material in self.materials]
        return varies

    def base_colour(
        self, faces: NDArray[np.integer[Any]], barycentric: NDArray[np.floating[Any]]
    ) -> NDArray[np.float32]:
        """Return the colour that multiplies a part's base colour factor: vertex colours times texture.

        Parameters
        ----------
        faces : (k,) int
            The face of each point.
        barycentric : (k, 3) float
            The weights of its corners, which sum to 1.

        Returns
        -------
        (k, 3) float32
            Linear RGB, 0 to 1; 1 where there is neither.
        """
        corners = self.faces[faces]
        colours, uv = (
            None if values is None else np.einsum("nc,ncx->nx", barycentric, values[corners])
            for values in (self.colours, self.uv)
        )
        return self._colour(self.parts[faces], colours, uv)

    def vertex_colour(self, vertices: NDArray[np.integer[Any]]) -> NDArray[np.float32]:
        """Return what `base_colour` does, at vertices.

        Parameters
        ----------
        vertices : (k,) int
            Vertex indices. A vertex that several parts share belongs to that of its last face.

        Returns
        -------
        (k, 3) float32
        """
        colours, uv = (None if values is None else values[vertices] for values in (self.colours, self.uv))
        return self._colour(self.vertex_part[vertices], colours, uv)

    @cached_property
    def vertex_part(self) -> NDArray[np.int32]:
        """(n,) int32: the part of the last face that uses each vertex, 0 where none does."""
        part = np.zeros(len(self.vertices), dtype=np.int32)
        part[self.faces.reshape(-1)] = np.repeat(self.parts, 3)
        return part

    def _colour(
        self,
        parts: NDArray[np.int32],
        colours: NDArray[np.floating[Any]] | None,
        uv: NDArray[np.floating[Any]] | None,
    ) -> NDArray[np.float32]:
        """Multiply the vertex colours of points by the textures of their parts."""
        # Weights that rounding left just outside 0 to 1 would take colours there as well.
        whole = (
            np.ones((len(parts), 3), dtype=np.float32)
            if colours is None
            else np.clip(colours, 0.0, 1.0).astype(np.float32)
        )
        if uv is not None:
            for part in np.unique(parts):
                material = self.materials[part]
                if material is not None and material.texture is not None:
                    rows = np.flatnonzero(parts == part)
                    whole[rows] *= material.texture.lookup(uv[rows])
        return whole

    @classmethod
    def from_arrays(
        cls,
        vertices: ArrayLike,
        faces: ArrayLike,
        normals: ArrayLike | None = None,
        name: str = "mesh",
        colours: ArrayLike | None = None,
        uv: ArrayLike | None = None,
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
        colours : (n, 3) array of numbers, optional
            Linear RGB of each vertex, 0 to 1.
        uv : (n, 2) array of numbers, optional
            Texture coordinates of each vertex, v down.

        Returns
        -------
        Mesh

        Raises
        ------
        InputError
            See `read_mesh`, which makes the same checks.
        """
        try:
            raw = single(vertices, faces, normals, None, colours, uv)
        except ValueError as error:  # numpy's word for rows of different lengths
            raise InputError(
                f"{name}: vertices, faces, normals, colours and uv must be rectangular arrays: {error}"
            ) from error
        return _mesh(raw, name, name)


def read_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read an OBJ, PLY, STL, GLB or glTF file.

    Vertices keep the order and the number of the file, and nothing is merged; two exceptions are needed: an
    OBJ vertex with several normals or texture coordinates becomes several vertices, and STL has three vertices
    a triangle. Scenes are flattened with the transforms of their nodes, one part for each object and material.
    Vertex colours and base colour textures are kept; a texture that cannot be read is a note.

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
        colours=checked.colours,
        uv=checked.uv,
        twins=checked.twins,
    )

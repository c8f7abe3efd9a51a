"""A bake: the visibility of a mesh's vertices, traced once and reused under any light, material and view."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl._version import __version__
from prtcl.errors import InputError
from prtcl.factors.visibility import Progress, Tracer
from prtcl.files.atomic import replacing
from prtcl.files.npz import read_npz
from prtcl.scene import bake_store
from prtcl.scene.bake_layout import LAYOUT, check, mesh_arrays, mesh_of, require_mesh, text_of
from prtcl.scene.mesh import Mesh, read_mesh
from prtcl.scene.points import vertex_points

FORMAT = 1


@dataclass(frozen=True, eq=False)
class Bake:
    """Visibility bits of all vertices, with the mesh they belong to.

    Attributes
    ----------
    mesh : Mesh, with vertex normals
    bits : (n_vertices, words) uint32, as `Tracer.visibility` gives them, in frames that depend on the normal alone
    rays : levels of the visibility grid: 4**rays rays a vertex
    """

    mesh: Mesh
    bits: npt.NDArray[np.uint32]
    rays: int

    @classmethod
    def trace(cls, mesh: Mesh, rays: int = 5, progress: Progress | None = None) -> Bake:
        """Trace 4**rays rays from every vertex."""
        mesh = ready(mesh, rays)
        tracer = Tracer(mesh.vertices, mesh.faces)
        return cls(mesh, visible(mesh, tracer, rays, progress=progress), rays)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz, or a Zarr store where the name ends in .zarr, aside and then renamed.

        Raises
        ------
        InputError
            If it cannot be written there, or the zarr package is not installed.
        """
        if bake_store.is_store(path):
            bake_store.write(path, self.mesh, self.bits, self.rays)
            return
        with replacing(path) as aside, aside.open("wb") as file:
            np.savez(
                file,
                format=FORMAT,
                prtcl=__version__,
                name=self.mesh.name,
                **mesh_arrays(self.mesh),  # type: ignore[arg-type]  # keywords, none of them allow_pickle
                rays=self.rays,
                bits=self.bits,
            )

    @classmethod
    def load(cls, path: str | os.PathLike[str], mesh: Mesh | None = None) -> Bake:
        """Read what `save` wrote.

        Parameters
        ----------
        path : str or os.PathLike
            An .npz or a .zarr.
        mesh : Mesh, optional
            What it must have been made of, by the hash of vertices, faces and normals. It is then the bake's mesh,
            with the materials and colours it has now.

        Raises
        ------
        InputError
            If the file is missing, damaged, no bake, of a newer format, or of another mesh.
        """
        name = os.fspath(path)
        if bake_store.is_store(path):
            stored = bake_store.StoredBake(path)
            own = stored.mesh if mesh is None else require_mesh(name, stored.mesh, mesh)
            return cls(own, stored.bits(), stored.rays)
        data = read_npz(path, "a bake made by `prtcl bake`")
        missing = (LAYOUT.keys() | {"format"}) - data.keys()
        if missing:
            raise InputError(
                f"{name}: is no bake: {', '.join(sorted(missing))} missing; make one: prtcl bake"
            )
        given = data["format"]
        number = int(given) if given.shape == () and given.dtype.kind in "iu" else None
        if number != FORMAT:
            raise InputError(
                f"{name}: a bake of format {number or 'unknown'}; this prtcl reads format {FORMAT}: bake it again"
            )
        check(name, data)
        own = mesh_of(text_of(name, data, "name") or "bake", data)
        own = own if mesh is None else require_mesh(name, own, mesh)
        return cls(own, data["bits"], int(data["rays"]))


def ready(mesh: Mesh, rays: int) -> Mesh:
    """The mesh as it is baked: with normals.

    Raises
    ------
    InputError
        If `rays` is out of range.
    """
    if not 1 <= rays <= quadtree.MAX_LEVELS:
        raise InputError(f"rays: expected 1 to {quadtree.MAX_LEVELS} levels, got {rays}")
    return mesh if mesh.normals is not None else mesh.smooth()


def visible(
    mesh: Mesh, tracer: Tracer, rays: int, only: npt.NDArray[np.integer] | None = None, progress: Progress | None = None
) -> npt.NDArray[np.uint32]:  # fmt: skip
    """Visibility bits of a mesh's vertices, as `Bake.bits` has them; each depends on no other.

    Parameters
    ----------
    mesh : as `ready` gives it; tracer : of it
    only : indices of the vertices wanted; None is all
    progress : called with the number of vertices done, from worker threads
    """
    points = vertex_points(mesh, tracer, only=only)
    return tracer.visibility(points.origins, points.frames, rays, progress=progress)


def is_bake(path: str | os.PathLike[str]) -> bool:
    """Whether a path names a bake rather than a mesh."""
    return os.fspath(path).lower().endswith(".npz") or bake_store.is_store(path)


def read_mesh_or_bake(source: Mesh | Bake | str | os.PathLike[str]) -> tuple[Mesh, Bake | None]:
    """A mesh from any of what scenes and sessions take, and the bake it came with.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    if not isinstance(source, Mesh | Bake):
        source = Bake.load(source) if is_bake(source) else read_mesh(source)
    return (source.mesh, source) if isinstance(source, Bake) else (source, None)

"""A bake: the visibility of a mesh's vertices, traced once and reused under any light, material and view."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl._version import __version__
from prtcl.errors import InputError
from prtcl.factors.visibility import Progress, Tracer
from prtcl.files.atomic import replacing
from prtcl.files.npz import read_npz
from prtcl.scene.mesh import Mesh, PartMaterial
from prtcl.scene.points import vertex_points

FORMAT = 1
_LAYOUT = {
    "format": ("i", ()),
    "rays": ("i", ()),
    "vertices": ("f8", ("vertices", 3)),
    "faces": ("i4", ("faces", 3)),
    "normals": ("f4", ("vertices", 3)),
    "parts": ("i4", ("faces",)),
    "materials": ("f8", ("parts", 5)),
    "bits": ("u4", ("vertices", "words")),
}
"""Each array's dtype, or its kind, and shape; lengths of one name agree."""


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
        if not 1 <= rays <= quadtree.MAX_LEVELS:
            raise InputError(f"rays: expected 1 to {quadtree.MAX_LEVELS} levels, got {rays}")
        mesh = mesh if mesh.normals is not None else mesh.smooth()
        tracer = Tracer(mesh.vertices, mesh.faces)
        points = vertex_points(mesh, tracer)
        return cls(mesh, tracer.visibility(points.origins, points.frames, rays, progress=progress), rays)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz, aside and then renamed."""
        assert self.mesh.normals is not None
        factors = np.full((len(self.mesh.materials), 5), np.nan)
        for row, part in enumerate(self.mesh.materials):
            if part is not None:
                factors[row] = (*part.base_color, part.metallic, part.roughness)
        with replacing(path) as aside, aside.open("wb") as file:
            np.savez(
                file,
                format=FORMAT,
                prtcl=__version__,
                name=self.mesh.name,
                vertices=self.mesh.vertices,
                faces=self.mesh.faces,
                normals=self.mesh.normals,
                parts=self.mesh.parts,
                materials=factors,
                rays=self.rays,
                bits=self.bits,
            )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Bake:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is missing, damaged, no bake, or of a newer format.
        """
        name = os.fspath(path)
        data = read_npz(path, "a bake made by `prtcl bake`")
        missing = _LAYOUT.keys() - data.keys()
        if missing:
            raise InputError(
                f"{name}: is no bake: {', '.join(sorted(missing))} missing; make one: prtcl bake"
            )
        if data["format"].shape != () or data["format"] != FORMAT:
            raise InputError(
                f"{name}: a bake of format {data['format']}; this prtcl reads format {FORMAT}: bake it again"
            )
        _check(name, data)
        rays = int(data["rays"])
        materials = tuple(
            None if np.isnan(row).any() else PartMaterial("", tuple(row[:3]), float(row[3]), float(row[4]))
            for row in data["materials"]
        )
        mesh = Mesh(
            str(data.get("name", "bake")), data["vertices"], data["faces"], data["normals"], data["parts"],
            materials, (),
        )  # fmt: skip
        return cls(mesh, data["bits"], rays)


def _check(name: str, data: dict[str, npt.NDArray[Any]]) -> None:
    """Refuse arrays that do not fit each other or would lead a kernel or embree out of bounds."""
    rays = int(data["rays"]) if data["rays"].shape == () else 0
    lengths = {"words": quadtree.visibility_words(rays) if 1 <= rays <= quadtree.MAX_LEVELS else -1}
    for key, (kind, shape) in _LAYOUT.items():
        array = data[key]
        fits = array.dtype.str[1:].startswith(kind) and array.ndim == len(shape)
        if fits:
            for length, got in zip(shape, array.shape, strict=True):
                fits &= got == (lengths.setdefault(length, got) if isinstance(length, str) else length)
        if not fits:
            wanted = ", ".join(str(lengths.get(str(length), length)) for length in shape)
            raise InputError(
                f"{name}: {key} expected {kind} of shape ({wanted}), got {array.dtype} of {array.shape}; "
                "the bake is damaged: make it again"
            )
    for key, below in (("faces", lengths["vertices"]), ("parts", lengths["parts"])):
        if not data[key].size or data[key].min() < 0 or data[key].max() >= below:
            raise InputError(
                f"{name}: {key} expected from 0 to {below - 1}; the bake is damaged: make it again"
            )
    for key in ("vertices", "normals"):
        if not np.isfinite(data[key]).all():
            raise InputError(f"{name}: {key} are NaN or infinite; the bake is damaged: make it again")

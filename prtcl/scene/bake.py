"""A bake: the visibility of a mesh's vertices, traced once and reused under any light, material and view."""

from __future__ import annotations

import os
import zipfile
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl._version import __version__
from prtcl.errors import InputError
from prtcl.factors.visibility import Progress, Tracer
from prtcl.files.atomic import replacing
from prtcl.scene.mesh import Mesh, PartMaterial
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
        try:
            with np.load(path, allow_pickle=False) as file:
                data = {key: file[key] for key in file.files}
        except FileNotFoundError as error:
            raise InputError(f"{name}: no such file") from error
        except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError, TypeError) as error:
            raise InputError(
                f"{name}: cannot be read as a bake ({error}); make it again: prtcl bake"
            ) from error
        missing = {
            "format",
            "vertices",
            "faces",
            "normals",
            "parts",
            "materials",
            "rays",
            "bits",
        } - data.keys()
        if missing:
            raise InputError(
                f"{name}: is no bake: {', '.join(sorted(missing))} missing; make one: prtcl bake"
            )
        if int(data["format"]) != FORMAT:
            raise InputError(
                f"{name}: a bake of format {int(data['format'])}; this prtcl reads format {FORMAT}: bake it again"
            )
        rays = int(data["rays"])
        expected = (len(data["vertices"]), quadtree.visibility_words(rays) if 1 <= rays <= 9 else -1)
        if data["bits"].shape != expected or data["bits"].dtype != np.uint32:
            raise InputError(
                f"{name}: bits expected {expected} uint32, got {data['bits'].shape}: bake it again"
            )
        materials = tuple(
            None if np.isnan(row).any() else PartMaterial("", tuple(row[:3]), float(row[3]), float(row[4]))
            for row in data["materials"]
        )
        mesh = Mesh(
            str(data.get("name", "bake")), data["vertices"], data["faces"], data["normals"], data["parts"],
            materials, (),
        )  # fmt: skip
        return cls(mesh, data["bits"], rays)

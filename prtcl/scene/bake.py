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
from prtcl.scene.mesh import Mesh, PartMaterial, read_mesh
from prtcl.scene.points import vertex_points
from prtcl.scene.texture import WRAPS, Texture

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
_OPTIONAL = {
    "colours": ("f4", ("vertices", 3)),
    "uv": ("f4", ("vertices", 2)),
    "textures": ("i4", ("parts",)),
    "wraps": ("i4", ("images", 2)),
}
"""Of meshes with colours: each part's texture, -1 for none, and the indices in WRAPS of texture_0, texture_1, …"""


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
        extras: dict[str, Any] = {**_textures(self.mesh)}
        extras |= {key: a for key in ("colours", "uv") if (a := getattr(self.mesh, key)) is not None}
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
                **extras,
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
        wraps = data.get("wraps", ())
        textures: list[Texture | None] = [
            Texture(data[f"texture_{number}"], (WRAPS[across], WRAPS[down]))
            for number, (across, down) in enumerate(wraps)
        ]
        textures.append(None)  # which -1 stands for
        numbers = data.get("textures", np.full(len(data["materials"]), -1))
        materials = tuple(
            None
            if np.isnan(row).any()
            else PartMaterial("", tuple(row[:3]), float(row[3]), float(row[4]), textures[number])
            for row, number in zip(data["materials"], numbers, strict=True)
        )
        mesh = Mesh(
            str(data.get("name", "bake")), data["vertices"], data["faces"], data["normals"], data["parts"],
            materials, (), data.get("colours"), data.get("uv"),
        )  # fmt: skip
        return cls(mesh, data["bits"], rays)


def is_bake(path: str | os.PathLike[str]) -> bool:
    """Whether a path names a bake rather than a mesh."""
    return os.fspath(path).lower().endswith(".npz")


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


def _textures(mesh: Mesh) -> dict[str, npt.NDArray[Any]]:
    """The arrays that hold a mesh's textures, each once however many parts share it; none where there are none."""
    found: dict[int, tuple[int, Texture]] = {}
    numbers = np.full(len(mesh.materials), -1, dtype=np.int32)
    for part, material in enumerate(mesh.materials):
        if material is not None and material.texture is not None:
            numbers[part], _ = found.setdefault(id(material.texture), (len(found), material.texture))
    if not found:
        return {}
    wraps = [[WRAPS.index(mode) for mode in texture.wrap] for _, texture in found.values()]
    images = {f"texture_{number}": texture.image for number, texture in found.values()}
    return {"textures": numbers, "wraps": np.array(wraps, dtype=np.int32), **images}


def _check(name: str, data: dict[str, npt.NDArray[Any]]) -> None:
    """Refuse arrays that do not fit each other or would lead a kernel or embree out of bounds."""
    rays = int(data["rays"]) if data["rays"].shape == () else 0
    lengths = {"words": quadtree.visibility_words(rays) if 1 <= rays <= quadtree.MAX_LEVELS else -1}
    layout: dict[str, tuple[str, tuple[str | int, ...]]] = {**_LAYOUT}
    layout |= {key: value for key, value in _OPTIONAL.items() if key in data}
    images = [key for key in data if key.startswith("texture_")]
    layout |= {key: ("u1", (f"{key} height", f"{key} width", 3)) for key in images}
    for key, (kind, shape) in layout.items():
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
    lengths["wrap modes"] = len(WRAPS)
    for key, low, count in (
        ("faces", 0, "vertices"),
        ("parts", 0, "parts"),
        ("textures", -1, "images"),
        ("wraps", 0, "wrap modes"),
    ):
        if key not in data:
            continue
        array, below = data[key], lengths.get(count, 0)
        if not array.size or array.min() < low or array.max() >= below:
            raise InputError(
                f"{name}: {key} expected from {low} to {below - 1}; the bake is damaged: make it again"
            )
    wanted_images = {f"texture_{number}" for number in range(lengths.get("images", 0))}
    if wanted_images != set(images) or ("textures" in data) != ("wraps" in data):
        raise InputError(f"{name}: textures are not complete; the bake is damaged: make it again")
    if not all(data[key].size for key in images):
        raise InputError(f"{name}: textures without texels; the bake is damaged: make it again")
    for key in ("vertices", "normals", "colours", "uv"):
        if key in data and not np.isfinite(data[key]).all():
            raise InputError(f"{name}: {key} are NaN or infinite; the bake is damaged: make it again")

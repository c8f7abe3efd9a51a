"""A bake in a Zarr store: opened without reading it, its visibility fetched by ranges of vertices."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl._version import __version__
from prtcl.errors import InputError
from prtcl.factors import hemisphere
from prtcl.files.array_store import ArrayStore, write_store
from prtcl.scene.bake_layout import check, mesh_arrays, mesh_hash, mesh_of
from prtcl.scene.mesh import Mesh

FORMAT = 1
KIND = "prtcl bake"
WHAT = "a bake made by `prtcl bake`"
PARAMETERISATION = {
    "hemisphere": "concentric square (Shirley and Chiu 1997), z = 1 - r^2: cells of equal solid angle",
    "order": "Morton",
    "frames": "tangent, bitangent, normal of the vertex normal alone (Duff et al. 2017)",
    "bits": "sample s is bit s % 32 of word s // 32; 1 is visible",
    "place": list(hemisphere.CENTRE),
    "seed": None,
}
"""What the bits mean. `place` is each ray's in its cell, (column, row); no random number is drawn, so no seed."""


def is_store(path: str | os.PathLike[str]) -> bool:
    """Whether a path names a Zarr store."""
    return os.fspath(path).rstrip("/\\").lower().endswith(".zarr")


def write(path: str | os.PathLike[str], mesh: Mesh, bits: npt.NDArray[np.uint32], rays: int) -> None:
    """Write a bake, aside and then renamed; see `Bake.save`."""
    attributes = {
        "kind": KIND,
        "format": FORMAT,
        "prtcl": __version__,
        "name": mesh.name,
        "mesh_sha256": mesh_hash(mesh),
        "rays": rays,
        "parameterisation": PARAMETERISATION,
    }
    # Zarr has no chunks of no rows. All of these have some: a mesh has a face, and so a part and vertices.
    write_store(path, {**mesh_arrays(mesh), "bits": bits}, attributes)


class StoredBake:
    """A bake in a Zarr store, of which the mesh is in memory and the visibility is read as it is asked for.

    Attributes
    ----------
    mesh : Mesh, with vertex normals
    rays : levels of the visibility grid: 4**rays rays a vertex
    store : ArrayStore

    Raises
    ------
    InputError
        If it is missing, damaged, no bake, or of a newer format.

    Examples
    --------
    >>> baked = StoredBake("bunny.zarr")  # doctest: +SKIP
    >>> for start, bits in baked.parts(10_000):  # doctest: +SKIP
    ...     ambient_occlusion(bits, baked.rays)
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        name = os.fspath(path)
        self.store = ArrayStore(path, WHAT)
        found = self.store.attributes
        if found.get("kind") != KIND:
            raise InputError(f"{name}: expected {WHAT}, got a Zarr store of something else")
        if found.get("format") != FORMAT:
            raise InputError(
                f"{name}: a bake of format {found.get('format')}, made by prtcl {found.get('prtcl')}; this prtcl "
                f"{__version__} reads format {FORMAT}: bake it again, or take the newer prtcl"
            )
        if found.get("parameterisation") != PARAMETERISATION:
            raise InputError(f"{name}: hemispheres are parameterised in another way; bake it again")
        data: dict[str, Any] = {
            key: array if key == "bits" else self.store.read(key) for key, array in self.store.arrays.items()
        }
        data["rays"] = np.array(found.get("rays") if isinstance(found.get("rays"), int) else 0)
        check(name, data)
        self.rays = int(data["rays"])
        self.mesh = mesh_of(str(found.get("name", "bake")), data)
        if mesh_hash(self.mesh) != found.get("mesh_sha256"):
            raise InputError(f"{name}: the mesh does not match its own hash; bake it again")

    def __len__(self) -> int:
        return len(self.mesh.vertices)

    def bits(self, start: int = 0, stop: int | None = None) -> npt.NDArray[np.uint32]:
        """Visibility of vertices start … stop − 1: (stop − start, words) uint32; reads their chunks only.

        Raises
        ------
        InputError
            A chunk is missing or damaged.
        IndexError
            start or stop lie outside the vertices.
        """
        stop = len(self) if stop is None else stop
        if not 0 <= start <= stop <= len(self):
            raise IndexError(f"vertices {start} to {stop}: expected from 0 to {len(self)}")
        return self.store.read("bits", start, stop)

    def parts(self, count: int) -> Iterator[tuple[int, npt.NDArray[np.uint32]]]:
        """All visibility, `count` vertices at a time: the first vertex of each part, and its bits.

        Each chunk is decoded once where `count` is a multiple of a chunk's vertices (`store.arrays["bits"].chunks`).
        """
        for start in range(0, len(self), count):
            yield start, self.bits(start, min(start + count, len(self)))

"""The arrays that hold a bake, whatever file they lie in: what they are, and the checks before they are used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.errors import InputError
from prtcl.files.digest import arrays_sha256
from prtcl.scene.mesh import Mesh, PartMaterial
from prtcl.scene.texture import WRAPS, Texture

LAYOUT = {
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


def mesh_arrays(mesh: Mesh) -> dict[str, npt.NDArray[Any]]:
    """The arrays of a mesh with normals, as `LAYOUT` and `_OPTIONAL` name them."""
    assert mesh.normals is not None
    factors = np.full((len(mesh.materials), 5), np.nan)
    for row, part in enumerate(mesh.materials):
        if part is not None:
            factors[row] = (*part.base_color, part.metallic, part.roughness)
    arrays: dict[str, npt.NDArray[Any]] = {
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "normals": mesh.normals,
        "parts": mesh.parts,
        "materials": factors,
        **_textures(mesh),
    }
    return arrays | {key: a for key in ("colours", "uv") if (a := getattr(mesh, key)) is not None}


def mesh_of(name: str, data: Mapping[str, npt.NDArray[Any]]) -> Mesh:
    """The mesh of arrays that passed `check`."""
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
    return Mesh(
        name, data["vertices"], data["faces"], data["normals"], data["parts"],
        materials, (), data.get("colours"), data.get("uv"),
    )  # fmt: skip


def text_of(name: str, data: Mapping[str, npt.NDArray[Any]], key: str) -> str:
    """A text that a bake may hold, and "" where it does not.

    Raises
    ------
    InputError
        What is there is no text.
    """
    given = data.get(key, np.array(""))
    try:
        if given.shape != () or given.dtype.kind != "U":
            raise ValueError
        text = str(given)
        text.encode()  # lone surrogates, which cannot be printed
        return text
    except (SystemError, ValueError) as error:  # the former for numbers that are no characters
        raise InputError(f"{name}: {key} expected a text; the bake is damaged: make it again") from error


def mesh_hash(mesh: Mesh) -> str:
    """SHA-256 of what visibility depends on: shapes and little-endian bytes of vertices, faces and normals, in hex."""
    assert mesh.normals is not None
    return arrays_sha256({
        "vertices": mesh.vertices.astype("<f8", copy=False),
        "faces": mesh.faces.astype("<i4", copy=False),
        "normals": mesh.normals.astype("<f4", copy=False),
    })  # fmt: skip


def require_mesh(name: str, baked: Mesh, mesh: Mesh) -> Mesh:
    """`mesh`, with normals, if visibility traced for `baked` is its own.

    Raises
    ------
    InputError
        Vertices, faces or normals differ.
    """
    mesh = mesh if mesh.normals is not None else mesh.smooth()
    if mesh_hash(mesh) == mesh_hash(baked):
        return mesh
    differ = [
        key
        for key in ("vertices", "faces", "normals")
        if not np.array_equal(getattr(baked, key), getattr(mesh, key))
    ]
    raise InputError(
        f"{name}: was baked from another mesh than {mesh.name}: {', '.join(differ) or 'zeros'} differ; bake it again"
    )


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


def check(name: str, data: dict[str, npt.NDArray[Any]]) -> None:
    """Refuse arrays that do not fit each other or would lead a kernel or embree out of bounds."""
    missing = LAYOUT.keys() - data.keys()
    if missing:
        raise InputError(f"{name}: is no bake: {', '.join(sorted(missing))} missing; make one: prtcl bake")
    given = data["rays"]
    rays = int(given) if given.shape == () and given.dtype.kind == "i" else 0
    lengths = {"words": quadtree.visibility_words(rays) if 1 <= rays <= quadtree.MAX_LEVELS else -1}
    layout: dict[str, tuple[str, tuple[str | int, ...]]] = {**LAYOUT}
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

"""The glTF scene graph and materials: where each mesh stands, its metallic-roughness factors and its texture."""

from __future__ import annotations

import base64
import math
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from prtcl.scene.mesh_raw import PartMaterial
from prtcl.scene.texture import Texture, Wrap, beside, decode_image, unread

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}


def placements(tree: dict[str, Any]) -> list[tuple[int, NDArray[np.float64]]]:
    """List every mesh of the default scene with its transform.

    Parameters
    ----------
    tree : dict
        The JSON of the file.

    Returns
    -------
    list of (int, (4, 4) float64)
        Mesh index and matrix from mesh to world space (column vectors), depth first in file order. All
        meshes where they are if the file has no nodes.

    Raises
    ------
    ValueError
        A node is its own ancestor or has two parents.
    """
    if not tree.get("nodes"):
        return [(mesh, np.eye(4)) for mesh in range(len(tree.get("meshes", [])))]
    return [(int(node["mesh"]), matrix) for node, matrix in nodes_placed(tree) if "mesh" in node]


def nodes_placed(tree: dict[str, Any]) -> list[tuple[dict[str, Any], NDArray[np.float64]]]:
    """List every node of the default scene with its matrix to world space, depth first in file order.

    Raises
    ------
    ValueError
        A node is its own ancestor or has two parents.
    """
    nodes = tree.get("nodes", [])
    if tree.get("scenes"):
        roots = tree["scenes"][tree.get("scene", 0)].get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [index for index in range(len(nodes)) if index not in children]
    found: list[tuple[dict[str, Any], NDArray[np.float64]]] = []
    seen: set[int] = set()
    # A list as the stack, since a damaged or deep file must not run into the recursion limit.
    waiting = [(index, np.eye(4)) for index in reversed(roots)]
    while waiting:
        index, parent = waiting.pop()
        if index in seen or index < 0:
            raise ValueError(f"node {index} occurs twice in the scene")
        seen.add(index)
        node = nodes[index]
        matrix = parent @ _local(node)
        found.append((node, matrix))
        waiting += [(child, matrix) for child in reversed(node.get("children", []))]
    return found


class Resources:
    """The bytes that a glTF file refers to: in the file, in data: URIs, and in files beside it.

    Parameters
    ----------
    path : pathlib.Path
        Where the file lies.
    tree : dict
        Its JSON.
    rest : bytes
        What follows the JSON in a GLB.
    """

    def __init__(self, path: Path, tree: dict[str, Any], rest: bytes) -> None:
        self._folder = path.parent
        self._tree = tree
        self._rest = rest
        self._buffers: dict[int, bytes] = {}

    def uri(self, uri: str) -> bytes:
        """Return what a URI refers to; ValueError or OSError where that is nothing, or out of the file's folder."""
        if uri.startswith("data:"):
            head, _, text = uri.partition(",")
            return (
                base64.b64decode(unquote_to_bytes(text))
                if head.endswith(";base64")
                else unquote_to_bytes(text)
            )
        return beside(self._folder, uri, unquote(uri))

    def view(self, index: int) -> bytes:
        """Return the bytes of a buffer view."""
        view = self._tree["bufferViews"][index]
        number = view["buffer"]
        if number not in self._buffers:
            buffer = self._tree["buffers"][number]
            self._buffers[number] = self.uri(buffer["uri"]) if "uri" in buffer else self._chunk()
        start, length = view.get("byteOffset", 0), view["byteLength"]
        if start < 0 or length < 0 or start + length > len(self._buffers[number]):
            raise ValueError("it reaches beyond its buffer")
        return self._buffers[number][start : start + length]

    def _chunk(self) -> bytes:
        """Return the binary chunk of a GLB, which trimesh has found good."""
        (size,) = struct.unpack_from("<I", self._rest)
        return self._rest[8 : 8 + size]


class Materials:
    """The materials of a glTF file; an image is decoded once for all that wrap it alike.

    Parameters
    ----------
    tree : dict
        The JSON of the file.
    resources : Resources
        Its images.
    notes : list of str
        Gets a line where a texture is left out.
    """

    def __init__(self, tree: dict[str, Any], resources: Resources, notes: list[str]) -> None:
        self._tree = tree
        self._resources = resources
        self._notes = notes
        self._textures: dict[tuple[int, Wrap, Wrap], Texture | Exception] = {}

    def of(self, primitive: dict[str, Any]) -> tuple[PartMaterial | None, NDArray[np.float64]]:
        """Return a primitive's material, with the defaults of the specification.

        Parameters
        ----------
        primitive : dict
            With those attributes that are read.

        Returns
        -------
        PartMaterial or None
            None where the primitive names no material.
        (2, 3) float64
            What takes its stored texture coordinates to those in the image.

        Raises
        ------
        ValueError
            A factor is no number.
        """
        if "material" not in primitive:
            return None, np.eye(2, 3)
        material = self._tree["materials"][primitive["material"]]
        name = str(material.get("name", ""))
        factors, base = _factors(material)
        left_out = [key for key, info in _textures(material) if info is not base]
        if left_out:
            self._notes.append(f"material '{name}': not read: {', '.join(dict.fromkeys(left_out))}")
        red, green, blue = (float(value) for value in factors.get("baseColorFactor", (1.0, 1.0, 1.0))[:3])
        metallic, roughness = (float(factors.get(key, 1.0)) for key in ("metallicFactor", "roughnessFactor"))
        values = (red, green, blue, metallic, roughness)
        if not all(math.isfinite(value) for value in values):
            raise ValueError(f"material '{name}' has a factor that is no number")
        red, green, blue, metallic, roughness = (min(max(value, 0.0), 1.0) for value in values)
        texture, transform = None, np.eye(2, 3)
        if base is not None:
            texture, transform = self._base(
                f"material '{name}': ", base, "TEXCOORD_0" in primitive["attributes"]
            )
        return PartMaterial(name, (red, green, blue), metallic, roughness, texture), transform

    def _base(self, owner: str, info: Any, has_uv: bool) -> tuple[Texture | None, NDArray[np.float64]]:
        """Return a base colour texture and the transform of its coordinates; None and a note where it is left out."""
        label = "base colour"
        try:
            entry = self._tree["textures"][info["index"]]
            # An image of another format stands in an extension, such as EXT_texture_webp.
            sources = [entry, *entry.get("extensions", {}).values()]
            number = next(source["source"] for source in sources if "source" in source)
            uri = str(self._tree["images"][number].get("uri", "data:"))
            label = f"image {number}" if uri.startswith("data:") else uri
            moved = info.get("extensions", {}).get("KHR_texture_transform", {})
            if moved.get("texCoord", info.get("texCoord", 0)) != 0:
                raise ValueError("it takes texture coordinates other than TEXCOORD_0")
            if not has_uv:
                raise ValueError("the mesh has no texture coordinates")
            transform = _transform(moved)
            sampler = self._tree["samplers"][entry["sampler"]] if "sampler" in entry else {}
            across, down = (_WRAPS.get(sampler.get(key, 0), "repeat") for key in ("wrapS", "wrapT"))
            return self._texture(number, across, down), transform
        except Exception as error:  # whatever is wrong with an image, the geometry is good
            if not isinstance(error, ValueError | OSError):
                error = ValueError("the file refers to what it does not have")
            self._notes.append(unread(owner, label, error))
            return None, np.eye(2, 3)

    def _texture(self, number: int, across: Wrap, down: Wrap) -> Texture:
        """Return a texture of an image, decoded before if it was; raises again what it raised before."""
        key = (number, across, down)
        if key not in self._textures:
            image = self._tree["images"][number]
            try:
                data = (
                    self._resources.uri(image["uri"])
                    if "uri" in image
                    else self._resources.view(image["bufferView"])
                )
                self._textures[key] = Texture(decode_image(data), (across, down))
            except Exception as error:
                self._textures[key] = error
        found = self._textures[key]
        if isinstance(found, Exception):
            raise found
        return found


def _factors(material: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """Return metallic-roughness factors and the textureInfo of the base colour, None where there is none."""
    factors = material.get("pbrMetallicRoughness", {})
    glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
    if glossy is None or factors:
        return factors, factors.get("baseColorTexture")
    # The older workflow: its diffuse colour, as rough as it is not glossy.
    roughness = 1.0 - float(glossy.get("glossinessFactor", 1.0))
    diffuse = glossy.get("diffuseFactor", (1.0, 1.0, 1.0, 1.0))
    factors = {"baseColorFactor": diffuse, "metallicFactor": 0.0, "roughnessFactor": roughness}
    return factors, glossy.get("diffuseTexture")


def _textures(material: dict[str, Any]) -> list[tuple[str, Any]]:
    """List the names and textureInfos of a material and its extensions."""
    groups = (material, material.get("pbrMetallicRoughness", {}), *material.get("extensions", {}).values())
    return [
        (key, info)
        for group in groups
        if isinstance(group, dict)
        for key, info in group.items()
        if key.endswith("Texture")
    ]


def _transform(moved: dict[str, Any]) -> NDArray[np.float64]:
    """Return the (2, 3) matrix of KHR_texture_transform: scale, then rotation, then offset.

    The rotation is counter-clockwise as seen in the image, where v points down. The specification's GLSL turns the
    other way than its text and its example, which three.js and Khronos' own viewer follow.
    """
    turn = float(moved.get("rotation", 0.0))
    cosine, sine = math.cos(turn), math.sin(turn)
    scale = np.array(moved.get("scale", (1.0, 1.0)), dtype=np.float64).reshape(2)
    offset = np.array(moved.get("offset", (0.0, 0.0)), dtype=np.float64).reshape(2)
    return np.column_stack((np.array([[cosine, sine], [-sine, cosine]]) * scale, offset))


def _local(node: dict[str, Any]) -> NDArray[np.float64]:
    """Return a node's matrix: as stored (by columns), or translation times rotation times scale."""
    if "matrix" in node:
        return np.asarray(np.reshape(node["matrix"], (4, 4)).T, dtype=np.float64)
    matrix: NDArray[np.float64] = np.eye(4)
    if "rotation" in node:
        x, y, z, w = np.array(node["rotation"], dtype=np.float64) / np.linalg.norm(node["rotation"])
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    if "scale" in node:
        matrix[:3, :3] *= np.array(node["scale"], dtype=np.float64).reshape(3)
    if "translation" in node:
        matrix[:3, 3] = np.array(node["translation"], dtype=np.float64).reshape(3)
    return matrix

"""The glTF scene graph and materials: where each mesh stands, and its metallic-roughness factors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prtcl.scene.mesh_raw import PartMaterial


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
    nodes = tree.get("nodes", [])
    if not nodes:
        return [(mesh, np.eye(4)) for mesh in range(len(tree.get("meshes", [])))]
    if tree.get("scenes"):
        roots = tree["scenes"][tree.get("scene", 0)].get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [index for index in range(len(nodes)) if index not in children]
    found: list[tuple[int, NDArray[np.float64]]] = []
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
        if "mesh" in node:
            found.append((int(node["mesh"]), matrix))
        waiting += [(child, matrix) for child in reversed(node.get("children", []))]
    return found


def material_of(tree: dict[str, Any], primitive: dict[str, Any], notes: list[str]) -> PartMaterial | None:
    """Return the factors of a primitive's material, with the defaults of the specification.

    Parameters
    ----------
    tree : dict
        The JSON of the file.
    primitive : dict
        The primitive within it.
    notes : list of str
        Gets a line where textures are left out.

    Returns
    -------
    PartMaterial or None
        None where the primitive names no material.
    """
    if "material" not in primitive:
        return None
    material = tree["materials"][primitive["material"]]
    name = str(material.get("name", ""))
    factors = material.get("pbrMetallicRoughness", {})
    glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
    if glossy is not None and not factors:
        # The older workflow: its diffuse colour, as rough as it is not glossy.
        roughness = 1.0 - float(glossy.get("glossinessFactor", 1.0))
        factors = {
            "baseColorFactor": glossy.get("diffuseFactor", (1.0, 1.0, 1.0, 1.0)),
            "metallicFactor": 0.0,
            "roughnessFactor": roughness,
        }
    groups = (material, material.get("pbrMetallicRoughness", {}), *material.get("extensions", {}).values())
    if any(key.endswith("Texture") for group in groups if isinstance(group, dict) for key in group):
        notes.append(f"material '{name}': textures are not read, its factors are used alone")
    red, green, blue = (float(value) for value in factors.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))[:3])
    values = (
        red,
        green,
        blue,
        float(factors.get("metallicFactor", 1.0)),
        float(factors.get("roughnessFactor", 1.0)),
    )
    if not all(math.isfinite(value) for value in values):
        raise ValueError(f"material '{name}' has a factor that is no number")
    red, green, blue, metallic, roughness = (min(max(value, 0.0), 1.0) for value in values)
    return PartMaterial(name, (red, green, blue), metallic, roughness)


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

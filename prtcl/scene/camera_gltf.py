"""The perspective cameras of a glTF file."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.scene.camera import Camera, Triple
from prtcl.scene.mesh_gltf import split_glb
from prtcl.scene.mesh_gltf_nodes import nodes_placed


def gltf_cameras(path: Path, size: tuple[int, int]) -> tuple[list[tuple[str, Camera]], list[str]]:
    """Every perspective camera of the default scene, depth first in file order, and notes on what was left out.

    Parameters
    ----------
    path : of a .gltf or .glb file
    size : width and height of the images

    Returns
    -------
    cameras : list of (name, Camera); the name is the node's, else the camera's, else camera001 and so on
    notes : a line each

    Raises
    ------
    InputError
        If the file is damaged, or has no perspective camera.

    Notes
    -----
    A camera looks along its node's −z with +y up (glTF 2.0, 3.10); of its transform only the directions count, not
    their lengths. The vertical field of view is kept, whatever `aspectRatio` the file has: its image is as high as
    ours, and w/h times as wide,

        tan(fov / 2) = w/h · tan(yfov / 2).
    """
    notes: list[str] = []
    found: list[tuple[str, Camera]] = []
    try:
        data = path.read_bytes()
        text = split_glb(path, data)[0] if path.suffix.lower() == ".glb" else data
        tree = json.loads(text)
        for node, matrix in nodes_placed(tree):
            if "camera" not in node:
                continue
            stored = tree["cameras"][node["camera"]]
            name = str(node.get("name") or stored.get("name") or f"camera{len(found) + 1:03}")
            if stored.get("type") != "perspective":
                notes.append(f"camera '{name}': left out, it is {stored.get('type', 'of no type')}")
                continue
            try:
                found.append((name, _camera(matrix, float(stored["perspective"]["yfov"]), size)))
            except InputError as error:
                raise InputError(f"camera '{name}': {error}") from error
    except InputError as error:
        if str(error).startswith(str(path)):
            raise
        raise InputError(f"{path}: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:  # whatever a damaged tree makes of itself
        raise InputError(
            f"{path}: cannot be read as glTF, it is damaged ({error!r}); export it again"
        ) from error
    if not found:
        raise InputError(
            f"{path}: expected perspective cameras in its scene, found none; export with cameras"
        )
    return found, notes


def _camera(matrix: NDArray[np.float64], yfov: float, size: tuple[int, int]) -> Camera:
    """The camera of a node's world matrix (column vectors) and a vertical field of view in radians."""
    if not 0.0 < yfov < math.pi:
        raise InputError(f"yfov: expected radians between 0 and π, got {yfov:g}")
    eye, backward, up = matrix[:3, 3], matrix[:3, 2], matrix[:3, 1]
    fov = 2 * math.degrees(math.atan(math.tan(yfov / 2) * size[0] / size[1]))
    # The target is a point ahead: far enough off that the eye's own digits do not bend the direction.
    length = float(np.linalg.norm(backward))
    target = eye - backward / (length or 1.0) * max(1.0, float(np.abs(eye).max()))
    return Camera(_triple(eye), _triple(target), _triple(up), fov, size)


def _triple(vector: NDArray[Any]) -> Triple:
    return float(vector[0]), float(vector[1]), float(vector[2])

"""Cameras in rows: a turntable, a JSON list, the cameras of a glTF file."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.files.source import check_source
from prtcl.scene.camera import Camera, Triple
from prtcl.scene.camera_gltf import gltf_cameras

ENDINGS = (".json", ".gltf", ".glb")
FOV = 40.0
Y_UP: Triple = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class View:
    """A camera and what it is called."""

    name: str
    camera: Camera


def turntable(
    bounds: npt.NDArray[np.float64],
    count: int,
    *,
    elevation: float = 20.0,
    target: Triple | None = None,
    up: Triple = Y_UP,
    fov: float = FOV,
    size: tuple[int, int] = (512, 512),
) -> list[View]:
    """Views from a full circle about the object, at equal steps of azimuth; the first again would follow the last.

    Parameters
    ----------
    bounds : (2, 3) of the object, lowest and highest corner
    count : of views
    elevation : degrees of the eye above the target's horizon, −90 and 90 excluded
    target : the centre; None takes that of the bounds
    up : the axis that is turned about. Azimuth 0 is +z (−y where the axis is nearly z), and views go counter-clockwise
        as seen from above: the object seems to turn clockwise

    Returns
    -------
    views : all at one distance, the least from which a ball about the target that holds the bounds fits the image, so
        that nothing is cut and the object does not change its size as it turns

    Raises
    ------
    InputError
        If there is no view, or the elevation is out of range.
    """
    if count < 1:
        raise InputError(f"turntable: expected 1 view or more, got {count}")
    if not -90.0 < elevation < 90.0:
        raise InputError(f"elevation: expected degrees between -90 and 90, got {elevation:g}")
    aim = bounds.mean(axis=0) if target is None else np.asarray(target, dtype=np.float64)
    centre: Triple = tuple(aim.tolist())
    Camera(tuple((aim + _beside(up)).tolist()), centre, up, fov, size)  # refuses what no camera takes
    axis = np.asarray(up, dtype=np.float64) / np.linalg.norm(up)
    front = _beside(up)
    side = np.cross(axis, front)
    radius = float(np.linalg.norm(np.maximum(np.abs(bounds[0] - aim), np.abs(bounds[1] - aim))))
    half = math.tan(math.radians(fov) / 2) * min(1.0, size[1] / size[0])
    distance = radius / math.sin(math.atan(half))
    rise = math.radians(elevation)
    views = []
    for number in range(count):
        turn = 2 * math.pi * number / count
        around = math.cos(turn) * front + math.sin(turn) * side
        eye = aim + distance * (math.cos(rise) * around + math.sin(rise) * axis)
        name = f"turn{number:0{max(3, len(str(count - 1)))}}"
        views.append(View(name, Camera(tuple(eye.tolist()), centre, up, fov, size)))
    return views


def _beside(up: Triple) -> npt.NDArray[np.float64]:
    """The unit direction at right angles to `up` that lies nearest to +z, or to −y where `up` is nearly z."""
    axis = np.asarray(up, dtype=np.float64)
    axis = axis / max(float(np.linalg.norm(axis)), 1e-300)
    side = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    front = side - (side @ axis) * axis
    return np.asarray(front / np.linalg.norm(front))


def read_views(
    path: str, *, size: tuple[int, int] = (512, 512), up: Triple = Y_UP, fov: float = FOV
) -> tuple[list[View], list[str]]:
    """Cameras from a file, and notes on what was left out.

    Parameters
    ----------
    path : a JSON list of {eye, target[, up, fov, name]} (degrees, horizontal), other keys ignored, so that the
        VIEWS.json of `prtcl fit` is one; or a glTF or GLB file with perspective cameras
    size : of the images: no file of these says it
    up, fov : of JSON entries that have none

    Raises
    ------
    InputError
        Naming the file, the entry and what is wrong.
    """
    source = check_source(path, ENDINGS, "cameras")
    if source.suffix.lower() == ".json":
        return _json_views(source, size, up, fov), []
    found, notes = gltf_cameras(source, size)
    return [View(name, camera) for name, camera in found], notes


def _json_views(path: Path, size: tuple[int, int], up: Triple, fov: float) -> list[View]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected a JSON list of cameras ({error})") from error
    if not isinstance(found, list) or not found or not all(isinstance(entry, dict) for entry in found):
        raise InputError(f"{path}: expected a JSON list of cameras, {{eye, target[, up, fov]}} each")
    digits = max(3, len(str(len(found))))
    views = []
    for number, entry in enumerate(found, start=1):
        where = f"{path}: camera {number}"
        eye, target = _triple(where, "eye", entry.get("eye")), _triple(where, "target", entry.get("target"))
        degrees, name = entry.get("fov", fov), entry.get("name", f"view{number:0{digits}}")
        if not _number(degrees):
            raise InputError(f"{where}: fov expected degrees, got {degrees}")
        if not isinstance(name, str) or not name:
            raise InputError(f"{where}: name expected a text, got {name}")
        try:
            camera = Camera(eye, target, _triple(where, "up", entry.get("up", up)), float(degrees), size)
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        views.append(View(name, camera))
    return views


def _triple(where: str, key: str, value: Any) -> Triple:
    if not isinstance(value, list | tuple) or len(value) != 3 or not all(map(_number, value)):
        raise InputError(f"{where}: {key} expected three numbers, got {value}")
    return float(value[0]), float(value[1]), float(value[2])


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e30

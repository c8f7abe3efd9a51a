"""Cameras in rows: where a turntable's eyes are, and what JSON and glTF files say."""

from __future__ import annotations

import json
import struct
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prtcl.errors import InputError
from prtcl.scene.camera import Camera
from prtcl.scene.camera_path import read_views, turntable

BOUNDS = np.array([[-1.0, 0.0, -2.0], [3.0, 2.0, 2.0]])


def direction(camera: Camera) -> np.ndarray:
    forward = np.subtract(camera.target, camera.eye)
    return forward / np.linalg.norm(forward)


def on_image(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Pixel positions by a look-at matrix, written apart from `Camera.rays`: (n, 2) from −1 to 1 within the image."""
    z = -direction(camera)
    x = np.cross(camera.up, z)
    x /= np.linalg.norm(x)
    local = (points - camera.eye) @ np.stack([x, np.cross(z, x), z], axis=1)
    half = np.tan(np.radians(camera.fov) / 2)
    return local[:, :2] / -local[:, 2:] / [half, half * camera.size[1] / camera.size[0]]


# --- turntable -----------------------------------------------------------------------------------------------


def test_four_views_stand_in_front_at_the_right_behind_and_at_the_left() -> None:
    views = turntable(BOUNDS, 4, elevation=0.0)
    assert [view.name for view in views] == ["turn000", "turn001", "turn002", "turn003"]
    for view, ahead in zip(views, [(0, 0, -1), (-1, 0, 0), (0, 0, 1), (1, 0, 0)], strict=True):
        assert view.camera.target == (1.0, 1.0, 0.0)
        assert np.abs(direction(view.camera) - ahead).max() < 1e-12


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, -2.0, 0.0), (1.0, 1.0, 0.0)])
@pytest.mark.parametrize("size", [(64, 64), (96, 32), (32, 96)])
def test_the_object_is_whole_and_as_large_in_all_views(
    up: tuple[float, float, float], size: tuple[int, int]
) -> None:
    views = turntable(BOUNDS, 7, elevation=35.0, up=up, size=size, fov=50.0)
    corners = np.array(list(product(*BOUNDS.T)))
    axis = np.asarray(up) / np.linalg.norm(up)
    away = [np.subtract(view.camera.eye, view.camera.target) for view in views]
    for view, eye in zip(views, away, strict=True):
        assert np.abs(on_image(view.camera, corners)).max() < 1.0
        assert eye @ axis / np.linalg.norm(eye) == pytest.approx(np.sin(np.radians(35.0)), abs=1e-12)
    lengths = np.linalg.norm(away, axis=1)
    assert lengths.max() - lengths.min() < 1e-12 * lengths.max()
    flat = np.array([eye - (eye @ axis) * axis for eye in away])
    turns = [axis @ np.cross(a, b) / (a @ a) for a, b in zip(flat, np.roll(flat, -1, axis=0), strict=True)]
    assert turns == pytest.approx([np.sin(2 * np.pi / 7)] * 7, abs=1e-12), (
        "not equal steps, counter-clockwise"
    )


@pytest.mark.parametrize(("count", "elevation"), [(0, 20.0), (3, 90.0), (3, -90.0), (3, float("nan"))])
def test_a_turntable_that_is_none_is_refused(count: int, elevation: float) -> None:
    with pytest.raises(InputError, match=r"turntable|elevation"):
        turntable(BOUNDS, count, elevation=elevation)


def test_a_turntable_without_an_axis_is_refused() -> None:
    with pytest.raises(InputError, match="up"):
        turntable(BOUNDS, 3, up=(0.0, 0.0, 0.0))


# --- JSON ----------------------------------------------------------------------------------------------------


def saved(path: Path, what: Any) -> str:
    path.write_text(what if isinstance(what, str) else json.dumps(what), encoding="utf-8")
    return str(path)


def test_json_cameras_with_what_they_leave_out(tmp_path: Path) -> None:
    views, notes = read_views(
        saved(tmp_path / "a.json", [
            {"eye": [1, 2, 3], "target": [0, 0, 0]},
            {"eye": [4, 0, 0], "target": [0, 1, 0], "up": [0, 0, 1], "fov": 25, "name": "side", "env": "b.exr"},
        ]),
        size=(30, 20), fov=50.0,
    )  # fmt: skip
    assert notes == [] and [view.name for view in views] == ["view001", "side"]
    assert views[0].camera == Camera((1, 2, 3), (0, 0, 0), (0, 1, 0), 50.0, (30, 20))
    assert views[1].camera == Camera((4, 0, 0), (0, 1, 0), (0, 0, 1), 25.0, (30, 20))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "expected a JSON list"), ("[]", "expected a JSON list"), ("[1]", "expected a JSON list"),
        ('[{"eye": [1, 2, 3]}]', "camera 1: target"), ('[{"eye": [1, 2], "target": [0, 0, 0]}]', "camera 1: eye"),
        ('[{"eye": [1, 2, 3], "target": [0, 0, NaN]}]', "camera 1: target"),
        ('[{"eye": [1, 2, 3], "target": [0, 0, 0], "fov": "wide"}]', "camera 1: fov"),
        ('[{"eye": [1, 2, 3], "target": [0, 0, 0], "name": 7}]', "camera 1: name"),
        ('[{"eye": [1, 2, 3], "target": [1, 2, 3]}]', "camera 1: eye and target"),
        ('[{"eye": [1, 2, 3], "target": [0, 0, 0], "fov": 180}]', "camera 1: fov"),
    ],
)  # fmt: skip
def test_bad_json_is_told_with_file_and_entry(tmp_path: Path, content: str, said: str) -> None:
    path = saved(tmp_path / "a.json", content)
    with pytest.raises(InputError) as caught:
        read_views(path)
    assert str(caught.value).startswith(path) and said in str(caught.value)


def test_another_kind_of_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.json, \.gltf, \.glb"):
        read_views(saved(tmp_path / "a.txt", "[]"))


# --- glTF ----------------------------------------------------------------------------------------------------

QUARTER = [0.0, float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5))]
"""A quarter turn about y, as a quaternion: z becomes x."""
TREE = {
    "asset": {"version": "2.0"},
    "scenes": [{"nodes": [0, 3]}],
    "nodes": [
        {"children": [1, 2], "translation": [10, 0, 0], "rotation": QUARTER, "scale": [2, 2, 2]},
        {"camera": 0, "translation": [0, 1, 5], "name": "wide"},
        {"camera": 2},
        {"camera": 1, "matrix": [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 3, 4, 5, 1]},
        {"camera": 0, "name": "of no scene"},
    ],
    "cameras": [
        {"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1, "aspectRatio": 9.0}},
        {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}, "name": "top"},
        {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0, "zfar": 1}},
    ],
}


def gltf_file(folder: Path, kind: str, tree: Any) -> str:
    text = json.dumps(tree).encode()
    if kind == "glb":
        text += b" " * (-len(text) % 4)
        text = struct.pack("<5I", 0x46546C67, 2, 20 + len(text), len(text), 0x4E4F534A) + text
    (folder / f"a.{kind}").write_bytes(text)
    return str(folder / f"a.{kind}")


@pytest.mark.parametrize("kind", ["gltf", "glb"])
def test_gltf_cameras_stand_where_their_nodes_are(tmp_path: Path, kind: str) -> None:
    views, notes = read_views(gltf_file(tmp_path, kind, TREE), size=(60, 40))
    assert [view.name for view in views] == ["wide", "top"]
    assert notes == ["camera 'camera002': left out, it is orthographic"]
    wide, top = (view.camera for view in views)
    # The parent turns (0, 1, 5) · 2 to (10, 2, 0) and moves it; −z becomes −x.
    assert np.abs(np.subtract(wide.eye, (20, 2, 0))).max() < 1e-12
    assert np.abs(direction(wide) - (-1, 0, 0)).max() < 1e-12
    # The matrix's columns are x, −z, y and the place: it looks down, and −z is up in the image.
    assert top.eye == (3, 4, 5) and np.abs(direction(top) - (0, -1, 0)).max() < 1e-12
    assert np.abs(np.subtract(top.up, (0, 0, -1))).max() < 1e-12
    for camera, yfov in ((wide, 0.8), (top, 0.5)):
        upper = camera.rays(np.array([30.0]), np.array([0.0]))[0]
        assert np.arccos(upper @ direction(camera)) == pytest.approx(yfov / 2, abs=1e-12)


def without(key: str) -> dict[str, Any]:
    return {name: value for name, value in TREE.items() if name != key}


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        (without("cameras"), "damaged"),
        ({**TREE, "scenes": [{"nodes": [2]}]}, "expected perspective cameras"),
        ({**TREE, "scenes": [{"nodes": [1, 1]}]}, "damaged"),
        (without("nodes") | {"scenes": [{}]}, "expected perspective cameras"),
        (
            {**TREE, "cameras": [{"type": "perspective", "perspective": {"yfov": 4.0}}] * 3},
            "': yfov: expected radians",
        ),
        ([], "damaged"),
    ],
)
def test_gltf_without_good_cameras_is_refused(tmp_path: Path, tree: Any, said: str) -> None:
    path = gltf_file(tmp_path, "gltf", tree)
    with pytest.raises(InputError) as caught:
        read_views(path)
    assert str(caught.value).startswith(path) and said in str(caught.value)

"""The pinhole: orientation, field of view, framing, and the order of sub-pixel points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.factors.sequence import stratified
from prtcl.scene.camera import Camera

EXACT = 1e-14
"""Some tens of float64 roundings of numbers of order 1."""


def ray(camera: Camera, x: float, y: float) -> NDArray[np.float64]:
    return camera.rays(np.array([float(x)]), np.array([float(y)]))[0]


def angle(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


# --- rays ----------------------------------------------------------------------------------------------------


def test_the_middle_of_the_image_looks_at_the_target() -> None:
    camera = Camera((1.0, 2.0, 3.0), (4.0, -1.0, 0.5), size=(64, 48))
    forward = np.subtract(camera.target, camera.eye)
    assert np.abs(ray(camera, 32, 24) - forward / np.linalg.norm(forward)).max() < EXACT


def test_a_camera_that_looks_along_minus_z_has_x_to_the_right_and_y_upwards() -> None:
    camera = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), fov=90.0, size=(8, 8))
    s = np.sqrt(0.5)
    for (x, y), expected in {
        (8, 4): (s, 0, -s),
        (0, 4): (-s, 0, -s),
        (4, 0): (0, s, -s),
        (4, 8): (0, -s, -s),
    }.items():
        assert np.abs(ray(camera, x, y) - expected).max() < EXACT


def test_up_decides_what_is_above_even_if_it_is_not_square_to_the_view() -> None:
    camera = Camera((0.0, -5.0, 0.0), (0.0, 0.0, 0.0), up=(0.0, 0.9, 0.3), size=(8, 8))
    top, right = ray(camera, 4, 0), ray(camera, 8, 4)
    assert top[2] > 0 and abs(top[0]) < EXACT
    assert right[0] > 0 and abs(right[2]) < EXACT


@pytest.mark.parametrize("size", [(40, 40), (80, 20), (10, 90)])
@pytest.mark.parametrize("fov", [10.0, 40.0, 150.0])
def test_fov_is_horizontal_and_pixels_are_square(size: tuple[int, int], fov: float) -> None:
    camera = Camera((2.0, 1.0, 4.0), (0.0, 0.0, 0.0), fov=fov, size=size)
    width, height = size
    left, right = ray(camera, 0, height / 2), ray(camera, width, height / 2)
    assert angle(left, right) == pytest.approx(fov, abs=1e-10)
    top, bottom = ray(camera, width / 2, 0), ray(camera, width / 2, height)
    tall = 2 * np.degrees(np.arctan(np.tan(np.radians(fov / 2)) * height / width))
    assert angle(top, bottom) == pytest.approx(tall, abs=1e-10)


def test_pixel_i_j_covers_its_square_of_the_image_plane() -> None:
    """Half-open squares: a direction through the centre of pixel (i, j) falls back to (j + 0.5, i + 0.5)."""
    camera = Camera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), fov=60.0, size=(7, 5))
    i, j = (a.ravel() + 0.5 for a in np.mgrid[:5, :7])
    d = camera.rays(j, i)
    half = np.tan(np.radians(30.0))
    assert np.abs((d[:, 0] / -d[:, 2] / half + 1) * 3.5 - j).max() < EXACT * 10
    assert np.abs(2.5 - d[:, 1] / -d[:, 2] / half * 3.5 - i).max() < EXACT * 10
    assert np.abs(np.linalg.norm(d, axis=1) - 1).max() < EXACT


# --- framing -------------------------------------------------------------------------------------------------


def projected(camera: Camera, bounds: NDArray[np.float64]) -> NDArray[np.float64]:
    """The box's corners in the image plane, both coordinates in [−1, 1] where they are seen; depth last."""
    forward = np.subtract(camera.target, camera.eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right = right / np.linalg.norm(right)
    corners = np.array([[bounds[a, 0], bounds[b, 1], bounds[c, 2]] for a, b, c in np.ndindex(2, 2, 2)])
    d = corners - camera.eye
    depth, half = d @ forward, np.tan(np.radians(camera.fov) / 2)
    x = d @ right / depth / half
    y = d @ np.cross(right, forward) / depth / (half * camera.size[1] / camera.size[0])
    return np.stack([x, y, depth], axis=1)


@given(
    low=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
    extent=st.tuples(*[st.floats(0.01, 50)] * 3),
    up=st.sampled_from(
        [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, -2.0, 0.0), (1.0, 2.0, -3.0)]
    ),
    fov=st.floats(3.0, 170.0),
    size=st.tuples(st.integers(1, 2000), st.integers(1, 2000)),
)
def test_framing_sees_the_whole_box(
    low: tuple[float, ...], extent: tuple[float, ...], up: Any, fov: float, size: tuple[int, int]
) -> None:
    bounds = np.stack([np.array(low), np.add(low, extent)])
    camera = Camera.framing(bounds, up=up, fov=fov, size=size)
    seen = projected(camera, bounds)
    assert (seen[:, 2] > 0).all()
    assert np.abs(seen[:, :2]).max() <= 1.0 + 1e-9
    assert camera.size == size and camera.fov == fov and camera.up == up


def test_framing_fills_the_image() -> None:
    """The ball around the box touches the border, so the box reaches at least a third of the way to it."""
    for size in ((100, 100), (300, 100), (100, 300)):
        seen = projected(
            Camera.framing(np.array([[-1.0] * 3, [1.0] * 3]), size=size), np.array([[-1] * 3, [1] * 3])
        )
        assert 0.6 < np.abs(seen[:, :2]).max() <= 1.0


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_framing_looks_from_the_front_right_and_above(up: Any) -> None:
    camera = Camera.framing(np.array([[-1.0] * 3, [1.0] * 3]), up=up)
    front = (0.0, 0.0, 1.0) if up[1] else (0.0, -1.0, 0.0)
    assert np.dot(camera.eye, up) > 0 and np.dot(camera.eye, front) > 0 and camera.eye[0] > 0


def test_framing_keeps_a_given_eye_and_target() -> None:
    bounds = np.array([[0.0, 0.0, 0.0], [2.0, 4.0, 6.0]])
    camera = Camera.framing(bounds, eye=(9.0, 8.0, 7.0))
    assert camera.eye == (9.0, 8.0, 7.0) and camera.target == (1.0, 2.0, 3.0)
    assert Camera.framing(bounds, target=(0.5, 0.0, 0.0)).target == (0.5, 0.0, 0.0)
    both = Camera.framing(bounds, eye=(9.0, 8.0, 7.0), target=(0.5, 0.0, 0.0))
    assert both.eye == (9.0, 8.0, 7.0) and both.target == (0.5, 0.0, 0.0)


@pytest.mark.parametrize("target", [(1.0, 1.0, 1.0), (0.0, 3.0, -2.0)])
def test_framing_sees_the_whole_box_about_a_given_target_too(target: Any) -> None:
    bounds = np.array([[-1.0] * 3, [1.0] * 3])
    seen = projected(Camera.framing(bounds, target=target), bounds)
    assert (seen[:, 2] > 0).all() and np.abs(seen[:, :2]).max() <= 1.0


# --- sub-pixel points ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [1, 2, 4, 8, 16, 32])
def test_the_first_n_by_n_points_lie_one_in_each_cell(side: int) -> None:
    x, y = stratified(np.arange(side * side))
    assert ((x >= 0) & (x < 1) & (y >= 0) & (y < 1)).all()
    cells = (y * side).astype(int) * side + (x * side).astype(int)
    assert sorted(cells) == list(range(side * side))


@pytest.mark.parametrize("wide,tall", [(1, 4), (8, 2), (64, 1), (16, 4), (2, 128)])
def test_every_power_of_two_is_stratified_in_every_shape_of_cell(wide: int, tall: int) -> None:
    """What makes it a (0, 2)-sequence: any aligned run of wide · tall points, not only the first."""
    count = wide * tall
    for run in range(3):
        x, y = stratified(np.arange(run * count, (run + 1) * count))
        assert len(set(zip((x * wide).astype(int), (y * tall).astype(int), strict=True))) == count


@pytest.mark.parametrize("side", [2, 4, 8, 16])
def test_points_do_not_shift_the_picture(side: int) -> None:
    """Their mean is within a tenth of a stratum of the pixel's centre; plain bit reversal is half a one off."""
    x, y = stratified(np.arange(side * side))
    assert abs(x.mean() - 0.5) <= 0.1 / side and abs(y.mean() - 0.5) <= 0.1 / side


def test_points_do_not_depend_on_what_else_is_asked_for() -> None:
    x, y = stratified(np.arange(100))
    some = np.array([7, 99, 0, 7])
    assert (stratified(some)[0] == x[some]).all() and (stratified(some)[1] == y[some]).all()


# --- errors --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change,message",
    [
        ({"eye": (0.0, 0.0, 0.0)}, "eye and target are the same point"),
        ({"up": (0.0, 0.0, 0.0)}, "up: .*zero"),
        ({"up": (0.0, 0.0, -2.0)}, "up: .*along the view"),
        ({"up": (0.0, 1.0)}, "up: expected three finite numbers"),
        ({"eye": (0.0, np.nan, 5.0)}, "eye: expected three finite numbers"),
        ({"target": (0.0, np.inf, 5.0)}, "target: expected three finite numbers"),
        ({"fov": 0.0}, "fov: expected degrees between 0 and 180, got 0"),
        ({"fov": 180.0}, "fov: expected"),
        ({"fov": float("nan")}, "fov: expected"),
        ({"size": (0, 5)}, "size: expected"),
        ({"size": (5,)}, "size: expected"),
    ],
)
def test_errors_name_what_is_wrong(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Camera(**{"eye": (0.0, 0.0, 5.0), "target": (0.0, 0.0, 0.0), **change})


@pytest.mark.parametrize(
    "change",
    [
        {"up": (0.0, 0.0, 0.0)},
        {"up": (np.nan, 0.0, 0.0)},
        {"target": (np.nan, 0.0, 0.0)},
        {"fov": 0.0},
        {"fov": 180.0},
        {"fov": 200.0},
        {"size": (0, 4)},
        {"size": (4, 0)},
    ],
)
def test_framing_makes_the_same_checks(change: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"^({next(iter(change))}):"):
        Camera.framing(np.array([[0.0] * 3, [1.0] * 3]), **change)

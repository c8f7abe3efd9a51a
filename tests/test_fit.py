"""Recovering tables: exact on exact data, in spite of outliers, with what the data do not determine marked."""

from __future__ import annotations

import json
import sys
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import prtcl
from prtcl.apps.cli import main
from prtcl.compute.device import Device
from prtcl.errors import InputError, PrtclError
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.environment import Environment
from prtcl.factors.sky import sun_sky
from prtcl.factors.table_solve import solve
from prtcl.files.image import write_exr
from prtcl.scene.camera import Camera
from prtcl.scene.fit import default_nodes, fit
from prtcl.scene.mesh import Mesh, read_mesh
from prtcl.scene.scene import Scene

scipy = pytest.importorskip("scipy", reason="fits need scipy, the extra `fit`")

Array = NDArray[np.float64]
NH, ND = 9, 6
THETA_H, THETA_D = np.linspace(0, 1, NH) ** 2 * np.pi / 2, np.linspace(0, np.pi / 2, ND)


def lobe(theta_h: Array, theta_d: Array) -> Array:
    """A coloured lobe over a matt base, from 12 down to 0.1: (nh, nd, 3)."""
    peak = 12 * np.exp(-((theta_h / 0.3) ** 2))[:, None] * (1 + 0.5 * theta_d**2)
    return np.asarray(peak[..., None] * [1.0, 0.8, 0.6] + [0.3, 0.2, 0.1])


def measurements(count: int = 1500, seed: int = 0) -> tuple[Array, Array, Array]:
    """Rows that read a few neighbouring nodes each, the table, and what they measure of it."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((count, 1, NH, ND))
    for row in rows[:, 0]:
        i, j = rng.integers(0, NH - 1), rng.integers(0, ND - 1)
        row[i : i + 2, j : j + 2] = rng.random((2, 2))
    table = lobe(THETA_H, THETA_D)
    return rows.reshape(count, 1, -1), table, rows.reshape(count, -1) @ table.reshape(-1, 3)


@pytest.mark.parametrize("robust", [False, True])
def test_exact_measurements_give_the_table_back(robust: bool) -> None:
    """What is left is the smoothness, at the least noise that is assumed, 1e-4."""
    rows, table, b = measurements()
    found = solve(rows, b, THETA_H, THETA_D, robust=robust)
    np.testing.assert_allclose(found.values, table, rtol=2e-3)
    np.testing.assert_allclose(found.predicted, b, rtol=1e-3)
    assert found.read.all() and found.deviation.max() < 0.01


@pytest.mark.parametrize("factor", [10.0, 0.0])
def test_outliers_do_not_ruin_it(factor: float) -> None:
    """Two percent of the pixels wrong: without weights the table errs by far more than with them."""
    rows, table, b = measurements()
    rng = np.random.default_rng(1)
    wrong = rng.choice(len(b), len(b) // 50, replace=False)
    b[wrong] *= factor
    b *= 1 + 0.01 * rng.normal(size=b.shape)
    errors = []
    for robust in (False, True):
        found = solve(rows, b, THETA_H, THETA_D, robust=robust)
        errors.append(float(np.abs(found.values / table - 1).max()))
    assert errors[1] < 0.05 and errors[0] > 3 * errors[1], errors
    assert (found.weights[wrong] < 0.1).all()
    assert (np.delete(found.weights, wrong) < 0.25).mean() < 0.01


def test_nodes_that_nothing_reads_are_filled_smoothly_and_known() -> None:
    rows, table, b = measurements()
    seen = np.zeros((NH, ND), np.bool_)
    seen[:, :3] = True
    keep = (rows[:, 0] * ~seen.ravel() == 0).all(axis=1)
    found = solve(rows[keep], b[keep], THETA_H, THETA_D)
    np.testing.assert_array_equal(found.read, seen)
    np.testing.assert_allclose(found.values[:, :3], table[:, :3], rtol=5e-3)
    assert (found.deviation[:, 3:].min(axis=1) > found.deviation[:, :3].max(axis=1)).all()
    assert (np.abs(np.log(found.values[:, 3:] / table[:, 3:])) < np.log(3)).all()


def test_values_are_never_negative() -> None:
    """A table that is zero in places, with noise about it."""
    rows, table, _ = measurements()
    table[5:] = 0.0
    b = rows[:, 0] @ table.reshape(-1, 3)
    found = solve(rows, b + 0.01 * b.mean() * np.random.default_rng(2).normal(size=b.shape), THETA_H, THETA_D)
    assert (found.values >= 0).all()
    assert found.values[6:].max() < 0.02 * table.max()


def test_one_row_of_light_serves_all_channels() -> None:
    rows, _, b = measurements(400)
    one = solve(rows, b, THETA_H, THETA_D, rounds=4)
    three = solve(np.repeat(rows, 3, axis=1), b, THETA_H, THETA_D, rounds=4)
    np.testing.assert_allclose(one.values, three.values, rtol=1e-9)


# --- images ------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def ball() -> Mesh:
    """A sphere that is smooth, under which nothing hides."""
    made = trimesh.creation.icosphere(subdivisions=4)
    return Mesh.from_arrays(made.vertices, made.faces).smooth()


def around(count: int, size: tuple[int, int] = (48, 36)) -> list[Camera]:
    turns = 2 * np.pi * np.arange(count) / count
    return [Camera((4 * np.sin(a), 1.0, 4 * np.cos(a)), (0.0, 0.0, 0.0), fov=36.0, size=size) for a in turns]


def sky() -> Environment:
    return Environment(sun_sky(32, sun_elevation=35.0, sun_azimuth=130.0))


def test_images_of_a_ball_relight_another_view(device: Device) -> None:
    """Rendered by `Scene`, which does not know the fit's operator; the sixth view under another sky."""
    cameras, material = around(4), "ggx:alpha=0.4,f0=0.5/0.4/0.3,kd=0.3"
    views = [
        (c, sky(), Scene(ball(), sky(), material, c, device=device).render(samples=4).image)
        for c in cameras[:3]
    ]
    h, d = np.linspace(0, 1, 16) ** 2 * np.pi / 2, np.linspace(0, np.pi / 2, 9)
    found = fit(ball(), views, theta_h=h, theta_d=d, levels=5, samples=400, device=device)
    assert found.residual < 0.04 and 0.2 < found.determined <= 1.0
    assert found.table.valid.mean() == pytest.approx(found.determined)
    other = Environment(sun_sky(32, sun_elevation=60.0, sun_azimuth=20.0))
    true, got = (
        Scene(ball(), other, own, cameras[3], device=device).render(samples=4).image
        for own in (material, found.table.material())
    )
    covered = true[..., 3] > 0
    error = np.sqrt(((true - got)[covered, :3] ** 2).mean()) / true[covered, :3].mean()
    # Three images of some 500 pixels: a wrong sun or frame errs by half, a table that fits its images alone by more.
    assert error < 0.1, error


def test_angles_that_no_light_reaches_are_not_determined(device: Device) -> None:
    """Light from within 15 degrees of the eye's direction alone: θ_d stays below half of that and the camera's."""
    camera = Camera((0.0, 0.0, 20.0), (0.0, 0.0, 0.0), fov=7.0, size=(40, 40))
    height = 32
    theta = np.pi * (np.arange(height) + 0.5) / height
    phi = np.pi * (np.arange(2 * height) + 0.5) / height
    towards_eye = -np.sin(theta)[:, None] * np.cos(phi)
    image = np.repeat((towards_eye > np.cos(np.radians(15)))[..., None], 3, axis=2).astype(np.float32)
    light = Environment(image)
    picture = Scene(ball(), light, "lambert:albedo=0.5", camera, device=device).render(samples=4).image
    h, d = np.linspace(0, 1, 12) ** 2 * np.pi / 2, np.linspace(0, np.pi / 2, 10)
    found = fit(
        ball(), [(camera, light, picture)], theta_h=h, theta_d=d, levels=5, samples=600, device=device
    )
    assert not found.table.valid[:, d > np.radians(25)].any()
    well = (h > np.radians(10)) & (h < np.radians(60))
    assert found.table.valid[well][:, 0].all()
    np.testing.assert_allclose(found.table.values[well][:, 0], 0.5 / np.pi, rtol=0.05)
    assert any("not determined" in note for note in found.notes)


def test_bad_pixels_in_images_are_left_out(device: Device) -> None:
    camera = around(1)[0]
    picture = Scene(ball(), sky(), "lambert:albedo=0.5", camera, device=device).render(samples=2).image
    rng = np.random.default_rng(3)
    spoilt = picture.copy()
    y, x = np.nonzero(picture[..., 3] >= 1)
    some = rng.choice(len(y), len(y) // 50, replace=False)
    spoilt[y[some], x[some], :3] *= 10
    spoilt[y[0], x[0]] = np.nan
    h, d = np.linspace(0, 1, 8) ** 2 * np.pi / 2, np.linspace(0, np.pi / 2, 6)
    clean, found = (
        fit(ball(), [(camera, sky(), p)], theta_h=h, theta_d=d, levels=4, device=device)
        for p in (picture, spoilt)
    )
    assert found.outliers > clean.outliers
    valid = clean.table.valid & found.table.valid
    assert valid.any()
    np.testing.assert_allclose(found.table.values[valid], clean.table.values[valid], rtol=0.1)
    report = found.report()
    assert report["pixels"] == found.pixels and report["nodes"] == [8, 6]


def test_what_is_wrong_is_named(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = around(1)[0]
    good = np.ones((36, 48, 3), np.float32)
    cases = [
        ([], {}, r"views: expected at least one"),
        ([(camera, sky(), good[:10])], {}, "image 1: expected 48x36 pixels as its camera has, got 48x10"),
        ([(camera, sky(), good[..., 0])], {}, r"image 1: expected \(h, w, 3\) or \(h, w, 4\) radiance"),
        (
            [(camera, sky(), good * np.nan)],
            {},
            "image 1: all pixels that the mesh covers are NaN or infinite",
        ),
        ([(camera, sky(), good)], {"smoothness": 0.0}, "smoothness: expected a number above 0"),
        ([(camera, sky(), good)], {"samples": 0}, "samples: expected at least 1 pixel"),
        ([(camera, sky(), good)], {"theta_h": [0.2, 0.1]}, "theta_h expected finite, strictly ascending"),
        (
            [(Camera((0, 0, 9.0), (0, 0, 20.0), size=(48, 36)), sky(), good)],
            {},
            "view 1: the mesh covers no pixel",
        ),
    ]
    for views, options, message in cases:
        with pytest.raises(InputError, match=message):
            fit(ball(), views, device=device, levels=3, **options)  # type: ignore[arg-type]
    for name in [n for n in sys.modules if n.split(".")[0] == "scipy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(PrtclError, match=r"needs scipy, which is not installed\npip install prtcl\[fit\]"):
        fit(ball(), [(camera, sky(), good)], device=device, levels=3, samples=20)


def test_it_is_prtcl_fit_and_its_nodes_are_what_a_table_takes() -> None:
    assert prtcl.fit is fit
    h, d = default_nodes()
    assert h.shape == (45,) and d.shape == (23,) and h[0] == d[0] == 0.0
    assert np.degrees(h[1]) < 0.1 and h[-1] == d[-1] == pytest.approx(np.pi / 2)


# --- command line ------------------------------------------------------------------------------------------


def test_the_command_line_fits_what_it_rendered(
    device: Device, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trimesh.creation.icosphere(subdivisions=3).export(tmp_path / "ball.ply")
    camera = around(1)[0]
    image = sky().image
    write_exr(tmp_path / "sky.exr", np.dstack([image, np.ones(image.shape[:2])]).astype(np.float32))
    mesh = read_mesh(tmp_path / "ball.ply").smooth()
    picture = Scene(mesh, sky(), "lambert:albedo=0.5", camera, device=device).render(samples=2).image
    write_exr(tmp_path / "one.exr", picture)
    view = {
        "image": "one.exr",
        "env": "sky.exr",
        "eye": camera.eye,
        "target": camera.target,
        "fov": camera.fov,
    }
    (tmp_path / "views.json").write_text(json.dumps([view]))
    table = tmp_path / "found.npz"
    arguments = ["fit", str(tmp_path / "ball.ply"), "--views", str(tmp_path / "views.json"), "-o", str(table)]
    assert main([*arguments, "--smooth", "--levels", "4", "--nodes", "8x6", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["nodes"] == [8, 6] and report["residual"] < 0.05
    found = Bivariate.load(table)
    assert found.valid.any()
    # One small image leaves single nodes open; all of them together it does not.
    assert np.median(found.values[found.valid]) == pytest.approx(0.5 / np.pi, rel=0.05)


@pytest.mark.parametrize(
    ("views", "message"),
    [
        ("{", "expected a JSON list of views"),
        ("[]", "expected a JSON list of views"),
        ('[{"image": "a.exr", "env": "b.exr", "eye": [0, 0, 1]}]', "view 1: target is missing"),
        ('[{"image": "a", "env": "b", "eye": [0, 0, 1], "target": [0, 0], "x": 1}]', "view 1: x is unknown"),
        ('[{"image": "a", "env": "b", "eye": [0, 0, 1], "target": [0, 0]}]', "target expected three numbers"),
        (
            '[{"image": "a", "env": "b", "eye": [0, 0, 1], "target": [0, 0, 0], "fov": "w"}]',
            "fov expected degrees",
        ),
    ],
)
def test_views_that_are_wrong_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], views: str, message: str
) -> None:
    (tmp_path / "views.json").write_text(views)
    status = main(
        [
            "fit",
            str(tmp_path / "m.ply"),
            "--views",
            str(tmp_path / "views.json"),
            "-o",
            str(tmp_path / "t.npz"),
        ]
    )
    error = capsys.readouterr().err
    assert status == 2 and message in error and "views.json" in error and len(error.splitlines()) <= 2

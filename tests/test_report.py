"""`prtcl report`: what it measures against what is known, and the files it writes."""

from __future__ import annotations

import json
import re
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cases import Run

from prtcl.apps.report import measure
from prtcl.apps.report.page import page
from prtcl.compute import choice
from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.factors.sky import sun_sky
from prtcl.files.image import write_exr
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.scene import Scene
from prtcl.transport.settings import Settings

VIEW = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(48, 36))


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A report of a moment."""
    for name, value in {"PIXELS": 40, "POINTS": 64, "DIRECTIONS": 64, "SAMPLES": (1, 2, 4)}.items():
        monkeypatch.setattr(measure, name, value)


@pytest.fixture
def run(run: Run, tmp_path: Path, opencl_device: choice.Seen) -> Run:
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    sky = np.ones((16, 32, 4), dtype=np.float32)
    sky[..., :3] = sun_sky(16)
    write_exr(tmp_path / "sky.exr", sky)

    return partial(
        run, "report", tmp_path / "ball.ply", "--env", tmp_path / "sky.exr", "--size", "24x20", "--device",
        opencl_device.spec, "-o", tmp_path / "out",
    )  # fmt: skip


def sample(
    device: Device, mesh: Mesh, sky: Environment, spec: str = "ggx:alpha=0.3,f0=0.9"
) -> measure.Sample:
    return measure.Sample(Scene(mesh, sky, spec, VIEW, device=device))


@pytest.mark.usefixtures("small")
def test_a_setting_errs_as_its_whole_picture_does(device: Device, mesh: Mesh, sky: Environment) -> None:
    """The sample is a part of the picture: `--samples` gives the same pixels, bit for bit but for their sums' order."""
    own = sample(device, mesh, sky)
    rows = {(row["rays"], row["levels"], row["samples"]): row for row in measure.settings(own)}
    scene = Scene(mesh, sky, "ggx:alpha=0.3,f0=0.9", VIEW, device=device, rays=3, levels=5, keep=5)
    image = scene.render(samples=2).image.reshape(-1, 4)[own.pilot.pixels, :3].astype(np.float64)
    assert abs(rows[3, 5, 2]["error"] - own.error(image)) < 1e-4
    errors = [rows[4, 5, side]["error"] for side in (1, 2, 4)]
    assert errors == sorted(errors, reverse=True)
    seconds = [rows[4, 5, side]["seconds"] for side in (1, 2, 4)]
    assert seconds == sorted(seconds)


@pytest.mark.usefixtures("small")
def test_every_factor_alone_errs_less_the_finer_it_is(device: Device, mesh: Mesh, sky: Environment) -> None:
    curves = measure.factors(sample(device, mesh, sky))
    assert set(curves) == {"light", "visibility", "reflectance", "view"}
    for name, rows in curves.items():
        errors = [row["error"] for row in rows]
        assert all(b < 1.1 * a for a, b in pairwise(errors)), (name, errors)
        assert errors[0] > 5 * errors[-1]


def test_the_frontier_is_what_no_other_beats() -> None:
    rows = [{"seconds": s, "error": e} for s, e in ((1, 9), (2, 5), (2, 4), (3, 6), (4, 3), (5, 3), (1, 10))]
    assert [(r["seconds"], r["error"]) for r in measure.frontier(rows)] == [(1, 9), (2, 4), (4, 3)]


@pytest.mark.usefixtures("small")
def test_files_are_whole_and_stand_alone(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "SHIFTS", (-1, 0))
    monkeypatch.setattr(measure, "FINER", (0,))
    monkeypatch.setattr(measure, "FINEST", Settings(levels=5, rays=4, keep=5, views=64))
    ran = run("--brdf", "lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.9", "--error", "0.05")
    assert ran.status == 0, ran.err
    assert len(ran.out.splitlines()) == 3 and "asked 5 %" in ran.out
    names = {path.name for path in (tmp_path / "out").iterdir()}
    plots = {
        f"{n}_{k}.{e}"
        for n in ("settings", "error", "factors", "stages")
        for k in (1, 2)
        for e in ("png", "svg")
    }
    assert names == {"report.html", "report.json", *plots}
    result = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [told["material"] for told in result["materials"]] == [
        "lambert:albedo=0.5",
        "ggx:alpha=0.3,f0=0.9",
    ]
    for told in result["materials"]:
        assert told["settings"] and told["frontier"] and told["plan"]["predicted"] <= 0.05
        assert told["render"]["seconds"] and told["render"]["bytes_per_point"]
    text = (tmp_path / "out" / "report.html").read_text()
    assert not re.findall(r"(?:src|href)=['\"](?!data:)", text) and text.count("data:image/png;base64,") == 8
    assert str(tmp_path) not in text  # a report is shown to others


@pytest.mark.usefixtures("small")
def test_where_the_error_is_refused_the_rest_is_told(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measure, "SHIFTS", (0,))
    monkeypatch.setattr(measure, "FINER", (0,))
    monkeypatch.setattr(measure, "FINEST", Settings(levels=5, rays=4, keep=5, views=64))
    ran = run("--brdf", "lambert:albedo=0.5", "--error", "0.00001")
    assert ran.status == 0 and "refused" in ran.out and len(ran.out.splitlines()) == 2, ran.err
    plan = json.loads((tmp_path / "out" / "report.json").read_text())["materials"][0]["plan"]
    assert "no setting that was tried meets it" in plan["refused"] and 0.0 < plan["found"] < 0.1
    assert "no setting that was tried meets it" in (tmp_path / "out" / "report.html").read_text()


def test_names_cannot_break_the_page() -> None:
    result = {
        "mesh": "<script>alert(1)</script>", "environment": "a'b\"", "device": "d", "size": [1, 1], "date": "",
        "command": "x", "materials": [],
    }  # fmt: skip
    text = page(result, [])
    assert "<script>" not in text and "&lt;script&gt;" in text


@pytest.mark.parametrize(
    "options, words",
    [
        (["--samples", "2"], ["--samples"]),
        (["--points", "vertex"], ["pixels"]),
        (["--error", "2"], ["between 0 and 1"]),
        (["--brdf", "lambert:albedo=0"], ["black", "choose"]),
        (["--eye", "0", "0", "9", "--target", "0", "0", "20"], ["sees nothing", "--eye"]),
    ],
)
@pytest.mark.usefixtures("small")
def test_what_a_report_cannot_do_is_refused(run: Run, options: list[str], words: list[str]) -> None:
    ran = run(*options, "--quiet")
    assert ran.status == 2 and ran.out == "" and len(ran.err.splitlines()) <= 2
    assert all(word in ran.err for word in words)


def test_without_matplotlib_it_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    ran = run()
    assert ran.status == 2 and "pip install 'prtcl[plots]'" in ran.err

"""`prtcl render --error`, `--plan`, `--error-channel`, and what of them contradicts."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import trimesh
from cases import Run

from prtcl.compute import choice
from prtcl.factors.sky import sun_sky
from prtcl.files.image import read_image, write_exr
from prtcl.scene.plan import Plan


@pytest.fixture
def run(run: Run, tmp_path: Path, opencl_device: choice.Seen) -> Run:
    """`prtcl render` of a small ball under a sky, with more options."""
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    sky = np.ones((16, 32, 4), dtype=np.float32)
    sky[..., :3] = sun_sky(16)
    write_exr(tmp_path / "sky.exr", sky)
    (tmp_path / "out").mkdir()

    return partial(
        run, "render", tmp_path / "ball.ply", "--env", tmp_path / "sky.exr", "--size", "24x20", "--device",
        opencl_device.spec, "-o", tmp_path / "out" / "a.exr",
    )  # fmt: skip


def test_the_error_expected_is_said(run: Run, tmp_path: Path) -> None:
    ran = run("--error", "0.05", "--explain")
    assert ran.status == 0
    assert "expected error" in ran.out and "asked for 5 %" in ran.out
    assert re.search(r"4\^\d rays", ran.out)  # how many depends on what this machine does fastest
    report = json.loads(run("--error", "0.05", "--json").out)
    assert 0.0 < report["plan"]["predicted"] <= 0.05 and report["plan"]["audits"] >= 1
    assert report["plan"]["trials"]


def test_a_plan_is_saved_reused_and_overridden(run: Run, tmp_path: Path) -> None:
    plan = tmp_path / "out" / "plan.json"
    assert run("--error", "0.05", "--save-plan", plan).status == 0
    kept = Plan.load(plan)
    assert kept.asked == 0.05 and kept.steered
    first = run("--plan", plan, "--json")
    image = read_image(tmp_path / "out" / "a.exr")
    assert json.loads(first.out)["plan"]["audits"] == 0
    assert run("--plan", plan).status == 0
    assert (read_image(tmp_path / "out" / "a.exr") == image).all()
    by_hand = json.loads(run("--plan", plan, "--rays", "5", "--json").out)
    assert by_hand["settings"][0]["rays"] == 5
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.exr", "plan.json"]


def test_the_error_channel(run: Run, tmp_path: Path) -> None:
    assert run("--error-channel", "--samples", "2").status == 0
    channels = OpenEXR.File(str(tmp_path / "out" / "a.exr"), separate_channels=True).channels()
    assert set(channels) == {"R", "G", "B", "A", "error"}
    error = channels["error"].pixels
    assert (error >= 0).all() and error.max() > 0
    # Beside the silhouette points may have missed the ball; far from it there is nothing to miss.
    assert not error[[0, 0, -1, -1], [0, -1, 0, -1]].any()


@pytest.mark.parametrize(
    "options, words",
    [
        (["--error", "0"], ["error", "between 0 and 1"]),
        (["--error", "nan"], ["error", "between 0 and 1"]),
        (["--error", "0.1", "--samples", "2"], ["samples and error"]),
        (["--error", "0.1", "--plan", "p.json"], ["--plan and --error"]),
        (["--save-plan", "out/p.json"], ["--save-plan", "--error"]),
        (["--plan", "missing.json"], ["missing.json", "cannot be read"]),
        (["--plan", "ball.ply"], ["ball.ply", "no plan"]),
        (["--error", "0.1", "--save-plan", "nowhere/p.json"], ["nowhere"]),
    ],
)
def test_what_contradicts_is_refused(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = run(*options)
    print(ran.err)
    assert ran.status == 2 and ran.out == "" and 1 <= len(ran.err.splitlines()) <= 2
    assert ran.err.startswith("prtcl render: ") and all(word in ran.err for word in words)
    assert not list((tmp_path / "out").iterdir())


def test_an_error_that_nothing_meets_ends_with_two_lines(run: Run, tmp_path: Path) -> None:
    ran = run("--error", "0.0005", "--levels", "2", "--brdf", "ggx:alpha=0.1,f0=0.9")
    assert (
        ran.status == 2 and "no setting that was tried meets it" in ran.err and len(ran.err.splitlines()) == 2
    )
    assert not list((tmp_path / "out").iterdir())

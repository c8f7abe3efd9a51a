"""`prtcl relight`: its files and their names, and that nothing is lost or half written, whatever ends a run."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from cases import Ran, Run
from PIL import Image

from prtcl.apps.relight import batch as batch_module
from prtcl.apps.relight import command as command_module
from prtcl.apps.relight import folder as folder_module
from prtcl.apps.relight import writer as writer_module
from prtcl.apps.relight.folder import Folder
from prtcl.apps.relight.inputs import digest, material_digest, mesh_digest
from prtcl.apps.relight.lock import locked
from prtcl.apps.relight.names import material_name, plain, rotation_names, unique
from prtcl.apps.relight.options import rotations
from prtcl.compute import choice
from prtcl.errors import PrtclError
from prtcl.factors.material import Material, from_table
from prtcl.files.atomic import replacing
from prtcl.files.image import read_image, write_exr
from prtcl.scene.camera import Camera
from prtcl.scene.engine_choice import Choice
from prtcl.scene.mesh import Mesh, PartMaterial, Texture, read_mesh
from prtcl.scene.scene import Scene

ROOT = Path(__file__).resolve().parents[1]
SUPPORT = {".relight.lock", "manifest.json", "finished.jsonl"}


def write_sky(path: Path, colour: tuple[float, float, float]) -> None:
    image = np.ones((8, 16, 4), dtype=np.float32)
    image[..., :3] = np.linspace(2.0, 0.5, 8)[:, None, None] * colour
    image[2, 3, :3] = 40.0
    write_exr(path, image)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball, and a folder of two skies."""
    folder = tmp_path_factory.mktemp("relight")
    trimesh.creation.icosphere(subdivisions=2).export(folder / "ball.ply")
    (folder / "skies").mkdir()
    write_sky(folder / "skies" / "blue.exr", (0.5, 0.7, 1.0))
    write_sky(folder / "skies" / "red.exr", (1.0, 0.4, 0.3))
    return folder


@pytest.fixture
def tiny(files: Path, opencl_device: choice.Seen) -> list[str]:
    """Two skies × two materials, of a moment, all but the output."""
    return ["relight", f"{files}/ball.ply", "--env", f"{files}/skies", "--brdf", "lambert:albedo=0.5",
            "ggx:alpha=0.3,f0=0.04", "--size", "12x8", "--samples", "1", "--levels", "3", "--views", "8", "--quiet",
            "--device", opencl_device.spec]  # fmt: skip


def contents(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a folder."""
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}


# --- what is made ----------------------------------------------------------------------------------------------


def test_images_manifest_and_events(run: Run, tiny: list[str], files: Path, tmp_path: Path) -> None:
    output = tmp_path / "new" / "out"
    ran = run(*tiny, "--env-rotate", "0", "90", "--png", "--exposure", "-1", "--json", "-o", output)
    assert ran.status == 0, ran.err
    stems = [
        f"{sky}_{turn}_{material}_view"
        for sky in ("blue", "red")
        for turn in ("rot000", "rot090")
        for material in ("lambert-albedo-0.5", "ggx-alpha-0.3-f0-0.04")
    ]
    assert set(os.listdir(output)) == SUPPORT | {f"{s}.{end}" for s in stems for end in ("exr", "png")}
    manifest = json.loads((output / "manifest.json").read_text())
    assert [entry["file"] for entry in manifest["frames"]] == [f"{stem}.exr" for stem in stems]
    assert manifest["frames"][3] == {
        "file": "blue_rot090_ggx-alpha-0.3-f0-0.04_view.exr", "png": "blue_rot090_ggx-alpha-0.3-f0-0.04_view.png",
        "environment": "blue", "rotation": 90.0, "material": "ggx-alpha-0.3-f0-0.04", "view": "view",
    }  # fmt: skip
    assert manifest["materials"][1] == {"name": "ggx-alpha-0.3-f0-0.04", "spec": "ggx:alpha=0.3,f0=0.04"}
    assert [Path(entry["file"]) for entry in manifest["environments"]] == [
        files / "skies" / "blue.exr", files / "skies" / "red.exr",
    ]  # fmt: skip
    view = manifest["views"][0]
    assert (
        view["name"] == "view" and view["size"] == [12, 8] and view["fov"] == 40.0 and len(view["eye"]) == 3
    )
    events = ran.events
    assert [event["event"] for event in events] == ["started", *["frame"] * 8, "summary"]
    assert events[0]["frames"] == 8 and events[0]["skipped"] == 0
    assert [event["file"] for event in events[1:-1]] == [f"{stem}.exr" for stem in stems]
    summary = events[-1]
    assert summary["frames"] == 8 and summary["frames_per_second"] == pytest.approx(
        8 / summary["seconds"], rel=0.05, abs=1e-3
    )
    assert summary["busy"] > 0.0 and summary["utilisation"] == pytest.approx(
        summary["busy"] / summary["seconds"], rel=0.05, abs=1e-3
    )
    images = [read_image(output / f"{stem}.exr") for stem in stems]
    assert all(image.shape == (8, 12, 4) and image[4, 6, :3].min() > 0 for image in images)
    assert len({image.tobytes() for image in images}) == 8, "two images are the same"
    with Image.open(output / f"{stems[0]}.png") as preview:
        assert preview.size == (12, 8) and preview.text["exposure"] == "-1 stops"


def test_the_same_files_from_another_folder_are_the_same_job(
    run: Run, tiny: list[str], files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what another program keeps beside the images is left alone."""
    output = tmp_path / "out"
    assert run(*tiny, "-o", output).status == 0
    whole = contents(output)
    next(output.glob("*.exr")).unlink()
    (output / f".{'0' * 32}.zarr").mkdir()
    monkeypatch.chdir(files)
    words = [str(Path(w).relative_to(files)) if w.startswith(str(files)) else w for w in tiny]
    assert words != tiny
    ran = run(*words, "--json", "-o", output)
    assert ran.status == 0 and ran.events[-1]["frames"] == 1, ran.err
    (output / f".{'0' * 32}.zarr").rmdir()
    assert contents(output) == whole


def test_an_error_is_met_by_the_same_points_at_every_try(
    run: Run, tiny: list[str], files: Path, tmp_path: Path
) -> None:
    """The pilot times nothing: a plan made again is the same plan, or resuming would be refused."""
    output = tmp_path / "out"
    words = [w for w in tiny if w not in ("--samples", "1", "--levels", "3", "--views", "8")]
    ran = run(*words, "--error", "0.05", "-o", output)
    assert ran.status == 0, ran.err
    told = re.search(
        r"(\d+) x (\d+) points a pixel, 4\^(\d) rays: images are expected to err by ([\d.]+) %", ran.err
    )
    assert told is not None and 0.0 < float(told[4]) <= 5.0
    manifest = json.loads((output / "manifest.json").read_text())
    inputs, error = manifest["inputs"], manifest["error"]
    assert inputs["samples"] == int(told[1]) and inputs["rays"] == int(told[3])
    assert error["asked"] == 0.05 and f"{100 * error['predicted']:.2g}" == told[4]
    (output / "blue_lambert-albedo-0.5_view.exr").unlink()
    again = run(*words, "--error", "0.05", "--json", "-o", output)
    assert again.status == 0 and again.events[-1]["frames"] == 1 and again.events[-1]["skipped"] == 3
    # What was promised, of the picture it was promised for.
    scene = Scene(
        files / "ball.ply", files / "skies" / "blue.exr", "ggx:alpha=0.3,f0=0.04", Camera.framing(
            read_mesh(files / "ball.ply").bounds, size=(12, 8)
        ), rays=5, levels=6, keep=6,
    )  # fmt: skip
    wanted = scene.render(samples=16).image
    got = read_image(output / "blue_ggx-alpha-0.3-f0-0.04_view.exr")
    seen = wanted[..., 3] > 0
    assert np.sqrt(((got - wanted)[seen][:, :3] ** 2).mean()) < 0.05 * wanted[seen][:, :3].mean()


@pytest.mark.parametrize("more", [["--samples", "2"], ["--rays", "3"], ["--points", "vertex"]])
def test_what_an_error_finds_cannot_be_fixed_beside_it(
    run: Run, tiny: list[str], tmp_path: Path, more: list[str]
) -> None:
    words = [w for w in tiny if w not in ("--samples", "1")]
    ran = run(*words, "--error", "0.05", *more, "-o", tmp_path / "out")
    assert ran.status == 2 and "--error" in ran.err and len(ran.err.splitlines()) <= 2


def test_many_lights_share_a_transport(run: Run, tiny: list[str], tmp_path: Path) -> None:
    """`--factorization view` and `light` make one picture, each to its own error."""
    images = {}
    words = [w for w in tiny if w not in ("--samples", "1", "--levels", "3", "--views", "8")]
    for name in ("light", "view"):
        output = tmp_path / name
        ran = run(*words, "--factorization", name, "--samples", "8", "--env-rotate", "0:360:90", "-o", output)
        assert ran.status == 0, ran.err
        images[name] = {path.name: read_image(path) for path in sorted(output.glob("*.exr"))}
    assert len(images["view"]) == 16 and images["view"].keys() == images["light"].keys()
    for name, got in images["view"].items():
        wanted = images["light"][name]
        seen = wanted[..., 3] > 0
        off = np.sqrt(((got - wanted)[seen][:, :3] ** 2).mean()) / wanted[seen][:, :3].mean()
        # 64 points of a pixel do not resolve the lamp's glint on a ball of six pixels, in either.
        assert off < (0.06 if "ggx" in name else 0.02), (name, off)


def test_an_interrupted_choice_is_kept(
    run: Run, tiny: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was tried and found faster is no input: another trial may find otherwise, and the images would not match."""
    words = [w for w in tiny if w not in ("--levels", "3", "--views", "8")]
    many = [*words, "--env-rotate", "0:360:60", "--explain"]
    tried = []

    def choose(*given: Any, **_: Any) -> Choice:
        tried.append(len(given[4]))
        return Choice(("view", "light")[len(tried) - 1], "for the test")

    monkeypatch.setattr(batch_module, "choose_engine", choose)
    first = run(*many, "-o", tmp_path / "out")
    assert first.status == 0 and "factorization view: for the test" in first.err and tried == [12]
    before = contents(tmp_path / "out")
    next((tmp_path / "out").glob("*.exr")).unlink()
    again = run(*many, "-o", tmp_path / "out")
    assert again.status == 0 and "factorization view: as the run before" in again.err and tried == [12]
    assert contents(tmp_path / "out") == before
    few = run(*words, "--explain", "-o", tmp_path / "few")
    assert "factorization light: 2 lights are too few" in few.err and tried == [12]
    by_hand = run(*many, "--levels", "3", "-o", tmp_path / "levels")
    assert "factorization light: --levels is its own" in by_hand.err and tried == [12]
    # A batch of another material does not inherit what was chosen for these.
    again = run(*many, "--brdf", "lambert:albedo=0.1", "--overwrite", "-o", tmp_path / "out")
    assert again.status == 0 and tried == [12, 12]


def test_vertices_and_bakes_have_no_view_to_factor(run: Run, tiny: list[str], tmp_path: Path) -> None:
    words = [w for w in tiny if w not in ("--levels", "3", "--views", "8")]
    ran = run(*words, "--points", "vertex", "--factorization", "view", "-o", tmp_path / "out")
    assert ran.status == 2 and "view has pixels, no vertices" in ran.err


def test_the_same_command_again_makes_nothing(run: Run, tiny: list[str], tmp_path: Path) -> None:
    output = tmp_path / "out"
    assert run(*tiny, "-o", output).status == 0
    before = contents(output)
    times = {p.name: p.stat().st_mtime_ns for p in output.glob("*.exr")}
    ran = run(*tiny, "--json", "-o", output)
    assert [event["event"] for event in ran.events] == ["started", *["skipped"] * 4, "summary"]
    assert contents(output) == before
    assert {p.name: p.stat().st_mtime_ns for p in output.glob("*.exr")} == times
    assert (
        run(*[text for text in tiny if text != "--quiet"], "-o", output).out
        == f"{output}: all 4 images were there\n"
    )


def test_an_image_of_render_and_of_relight_is_the_same(
    run: Run, tiny: list[str], files: Path, tmp_path: Path
) -> None:
    assert run(*tiny, "-o", tmp_path / "out").status == 0
    ran = run(
        "render", *tiny[1:2], "--env", files / "skies" / "red.exr", "--brdf", "ggx:alpha=0.3,f0=0.04", *tiny[7:],
        "-o", tmp_path / "one.exr",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    one, many = (
        read_image(tmp_path / name) for name in ("one.exr", "out/red_ggx-alpha-0.3-f0-0.04_view.exr")
    )
    assert np.abs(one - many).max() <= 8 * 2.0**-24 * np.abs(one).max()


CAMERAS = [
    {"eye": [0, 0, 4], "target": [0, 0, 0], "name": "front"},
    {"eye": [4, 0, 0], "target": [0, 0, 0], "fov": 30},
]


@pytest.mark.parametrize(
    ("asked", "names"),
    [
        ([], ["view"]),
        (["--eye", "0", "1", "5", "--target", "0", "0", "0", "--up", "0", "1", "0", "--fov", "30"], ["view"]),
        (["--turntable", "3", "--elevation", "-10"], ["turn000", "turn001", "turn002"]),
        (["--cameras", "{}/cameras.json"], ["front", "view002"]),
        (["--cameras", "{}/cameras.gltf"], ["camera001"]),
    ],
)
def test_every_source_of_cameras(
    run: Run, tiny: list[str], tmp_path: Path, asked: list[str], names: list[str]
) -> None:
    (tmp_path / "cameras.json").write_text(json.dumps(CAMERAS))
    gltf = {
        "asset": {"version": "2.0"}, "nodes": [{"camera": 0, "translation": [0, 0, 4]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.6, "znear": 0.1}}],
    }  # fmt: skip
    (tmp_path / "cameras.gltf").write_text(json.dumps(gltf))
    ran = run(*tiny, *(text.format(tmp_path) for text in asked), "-o", tmp_path / "out")
    assert ran.status == 0, ran.err
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert [view["name"] for view in manifest["views"]] == names
    assert len(list((tmp_path / "out").glob("*.exr"))) == 4 * len(names)
    for entry in manifest["frames"]:
        assert read_image(tmp_path / "out" / entry["file"])[4, 6, 3] == 1.0


def test_a_bake_is_relit(run: Run, tiny: list[str], files: Path, tmp_path: Path) -> None:
    bake = tmp_path / "ball.npz"
    assert run("bake", files / "ball.ply", "--rays", "3", "-o", bake, "--quiet").status == 0
    assert run("relight", bake, *tiny[2:], "-o", tmp_path / "out").status == 0
    assert len(list((tmp_path / "out").glob("*.exr"))) == 4
    ran = run("relight", bake, *tiny[2:], "--points", "pixel", "-o", tmp_path / "out")
    assert ran.status == 2 and "--points pixel" in ran.err


# --- names, rotations, globs -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("30", [30.0]), ("-30", [-30.0]), ("0,90,10.5", [0.0, 90.0, 10.5]),
        ("0:360:90", [0.0, 90.0, 180.0, 270.0]), ("0:90:45", [0.0, 45.0, 90.0]), ("0:100:45", [0.0, 45.0, 90.0]),
        ("90:-270:-180", [90.0, -90.0]), ("0:720:360", [0.0, 360.0]), ("0:0:5", [0.0]), ("10:370:180", [10.0, 190.0]),
    ],
)  # fmt: skip
def test_rotations(text: str, degrees: list[float]) -> None:
    assert rotations(text) == degrees


def test_a_full_turn_by_one_degree_has_360() -> None:
    assert rotations("0:360:1") == list(range(360))
    assert len(rotations("0:360:0.1")) == 3600


@pytest.mark.parametrize(
    "text", ["", "x", "0:360", "0:360:0", "0:360:-1", "0:360:1:1", "nan", "0:inf:1", "0:1:1e-9", "1e300"]
)
def test_rotations_that_are_none(run: Run, tiny: list[str], tmp_path: Path, text: str) -> None:
    ran = run(*tiny, "--env-rotate", text, "-o", tmp_path / "out")
    assert ran.status == 2 and "--env-rotate" in ran.err and not (tmp_path / "out").exists()


def test_names_are_plain_and_no_two_alike() -> None:
    assert material_name("ggx:alpha=0.3,f0=1.0/0.77/0.34") == "ggx-alpha-0.3-f0-1.0-0.77-0.34"
    assert material_name("merl:some/folder/red paint.binary,angles=2") == "merl-red-paint"
    assert plain("../über/*?") == "ber" and plain("///") == "unnamed" and len(plain("x" * 300)) == 60
    assert unique(["sky", "Sky", "sky-2", "sky"]) == ["sky", "Sky-2", "sky-2-2", "sky-3"]
    assert rotation_names([0.0]) == [""] and rotation_names([30.0]) == ["rot030"]
    assert rotation_names([5.0, 12.5, -7.0]) == ["rot005", "rot012.5", "rot-07"]


def test_names_that_clash_are_numbered(run: Run, tiny: list[str], files: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    shutil.copy(files / "skies" / "blue.exr", tmp_path / "other" / "red.exr")
    ran = run(
        *tiny, "--env", files / "skies" / "red.exr", tmp_path / "other" / "red.exr", "-o", tmp_path / "out"
    )
    assert ran.status == 0, ran.err
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert [entry["name"] for entry in manifest["environments"]] == ["blue", "red", "red-2"], "each file once"
    blue, copy = (
        read_image(tmp_path / "out" / f"{name}_lambert-albedo-0.5_view.exr") for name in ("blue", "red-2")
    )
    assert (blue == copy).all()


def test_globs(run: Run, tiny: list[str], files: Path, tmp_path: Path) -> None:
    rest = [*tiny[:2], *tiny[4:]]
    assert run(*rest, "--env", f"{files}/sk*/*e*.exr", "-o", tmp_path / "out").status == 0
    names = json.loads((tmp_path / "out" / "manifest.json").read_text())["environments"]
    assert [entry["name"] for entry in names] == ["blue", "red"]
    # What macOS keeps beside a file on other disks.
    shutil.copytree(files / "skies", tmp_path / "skies")
    (tmp_path / "skies" / "._blue.exr").write_bytes(b"no map")
    assert run(*rest, "--env", tmp_path / "skies", "-o", tmp_path / "out").status == 0
    for pattern in (f"{files}/sk*/*.hdr", f"{files}/*.ply", f"{tmp_path}/no*/**"):
        ran = run(*rest, "--env", pattern, "-o", tmp_path / "none")
        assert ran.status == 2 and pattern in ran.err and "no file matches" in ran.err
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["--turntable", "3", "--cameras", "a.json"], "--cameras"), (["--turntable", "0"], "turntable"),
        (["--turntable", "3", "--eye", "1", "2", "3"], "--eye"), (["--elevation", "10"], "--elevation"),
        (["--cameras", "none.json"], "none.json"), (["--samples", "0"], "--samples"),
        (["--exposure", "nan"], "--exposure"), (["--factorization", "view"], "--levels: is of --factorization light"),
        (["--brdf", "lambert:albedo=7"], "albedo"), (["--env", "none.exr"], "none.exr"),
        (["--eye", "9", "9", "9", "--target", "20", "20", "20"], "sees nothing"),
    ],
)  # fmt: skip
def test_wrong_options_are_two_lines_at_most(
    run: Run, tiny: list[str], tmp_path: Path, asked: list[str], said: str
) -> None:
    ran = run(*tiny, *asked, "-o", tmp_path / "out")
    assert ran.status == 2 and said in ran.err and ran.out == ""
    assert ran.err.startswith("prtcl relight: ") and len(ran.err.splitlines()) <= 2
    assert not list(tmp_path.glob("out/*.exr"))


def test_an_input_is_never_overwritten(run: Run, tiny: list[str], files: Path, tmp_path: Path) -> None:
    name = "sky_lambert-albedo-0.5_view"
    write_sky(tmp_path / "sky.exr", (1.0, 1.0, 1.0))
    write_sky(tmp_path / f"{name}.exr", (1.0, 1.0, 1.0))
    before = contents(tmp_path)
    rest = [*tiny[:2], *tiny[4:]]
    ran = run(*rest, "--env", tmp_path / "sky.exr", tmp_path / f"{name}.exr", "--overwrite", "-o", tmp_path)
    assert ran.status == 2 and f"{name}.exr" in ran.err and contents(tmp_path) == before


# --- another job, damage ---------------------------------------------------------------------------------------


def test_another_job_is_refused(run: Run, tiny: list[str], files: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    assert run(*tiny, "-o", output).status == 0
    before = contents(output)
    for more, what in (
        (["--samples", "2"], "samples: 1 there, 2 here"), (["--env-rotate", "7"], "rotations"),
        (["--size", "8x8"], "cameras"), (["--png"], "png: False there"),
        (["--smooth"], "mesh"),
    ):  # fmt: skip
        ran = run(*tiny, *more, "-o", output)
        assert ran.status == 2 and len(ran.err.splitlines()) == 2
        assert f"what differs is {what}" in ran.err and "--overwrite" in ran.err
    assert contents(output) == before
    ran = run(*tiny, "--env-rotate", "7", "--overwrite", "-o", output)
    assert ran.status == 0
    assert {p.name for p in output.glob("*.exr")} == {
        entry["file"] for entry in json.loads((output / "manifest.json").read_text())["frames"]
    }, "images of the other job were left"


def test_an_environment_that_changed_is_another_job(
    run: Run, tiny: list[str], files: Path, tmp_path: Path
) -> None:
    write_sky(tmp_path / "sky.exr", (1.0, 0.5, 0.2))
    rest = [*tiny[:2], "--env", str(tmp_path / "sky.exr"), *tiny[4:], "-o", str(tmp_path / "out")]
    assert run(*rest).status == 0
    write_sky(tmp_path / "sky.exr", (1.0, 0.5, 0.1))
    ran = run(*rest)
    assert ran.status == 2 and "what differs is environments" in ran.err


def test_a_bad_map_or_view_ends_a_run_before_its_first_image(
    run: Run, tiny: list[str], files: Path, tmp_path: Path
) -> None:
    """Mended or taken out, the same command goes on: nothing is lost, and nothing has to be replaced."""
    skies, output = tmp_path / "skies", tmp_path / "out"
    shutil.copytree(files / "skies", skies)
    (skies / "cut.exr").write_bytes((skies / "blue.exr").read_bytes()[:400])
    words = [*tiny[:3], str(skies), *tiny[4:], "-o", str(output)]
    ran = run(*words)
    assert ran.status == 2 and "cut.exr" in ran.err and len(ran.err.splitlines()) <= 2
    assert not list(output.glob("*.exr"))
    (skies / "cut.exr").unlink()
    cameras = tmp_path / "cameras.json"
    good, away = (
        {"eye": [0, 0, 5], "target": [0, 0, 0]},
        {"eye": [0, 0, 5], "target": [0, 0, 9], "name": "away"},
    )
    cameras.write_text(json.dumps([good, away]))
    ran = run(*words, "--cameras", cameras)
    assert ran.status == 2 and "away: " in ran.err and "sees nothing" in ran.err
    assert not list(output.glob("*.exr"))
    cameras.write_text(json.dumps([good]))
    assert run(*words, "--cameras", cameras).status == 0 and len(list(output.glob("*.exr"))) == 4


def test_what_is_computed_when_a_run_fails_is_written(
    run: Run, tiny: list[str], files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A map that is there when the run begins, and no more when its turn comes."""
    skies, output = tmp_path / "skies", tmp_path / "out"
    shutil.copytree(files / "skies", skies)
    (skies / "cut.exr").write_bytes((skies / "blue.exr").read_bytes()[:400])
    monkeypatch.setattr(command_module, "check_inputs", lambda *_: None)
    words = [*tiny[:3], str(skies), *tiny[4:], "-o", str(output)]
    assert run(*words).status == 2
    assert sorted(path.name[:4] for path in output.glob("*.exr")) == ["blue", "blue"]
    (skies / "cut.exr").unlink()
    ran = run(*words, "--json")
    assert ran.status == 0 and ran.events[0]["skipped"] == 2 and ran.events[-1]["frames"] == 2
    assert run(*tiny, "-o", tmp_path / "one").status == 0
    assert contents(output).items() - contents(tmp_path / "one").items() == {
        ("manifest.json", contents(output)["manifest.json"])  # it names the maps' paths
    }


@pytest.mark.parametrize("ends", [None, "journal", "manifest", "the old command after it"])
def test_a_batch_grows(
    run: Run, tiny: list[str], files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: str | None
) -> None:
    """More lights, materials and views: what is finished stays, though a run ends as it takes the folder over."""
    cameras, output = tmp_path / "cameras.json", tmp_path / "out"
    front, side = (
        {"eye": eye, "target": [0, 0, 0], "name": n} for eye, n in (([0, 0, 5], "f"), ([5, 0, 0], "s"))
    )
    cameras.write_text(json.dumps([front]))
    blue = [*tiny[:3], str(files / "skies" / "blue.exr"), *tiny[4:], "--cameras", str(cameras)]
    assert run(*blue, "-o", output).status == 0
    cameras.write_text(json.dumps([side, front]))
    more = [*tiny, "--brdf", "lambert:albedo=0.2", "--cameras", str(cameras)]
    if ends is not None:
        real = Folder.write

        def full(folder: Folder, name: str, write: Any) -> str:
            if name.startswith("finished" if ends == "journal" else "manifest"):
                raise PrtclError(f"{name}: no room\nmake some")
            return real(folder, name, write)

        with monkeypatch.context() as patch:
            patch.setattr(Folder, "write", full)
            assert run(*more, "-o", output).status == 1
    if ends == "the old command after it":
        cameras.write_text(json.dumps([front]))
        assert "all 2 images were there" in run(*[w for w in blue if w != "--quiet"], "-o", output).out
        cameras.write_text(json.dumps([side, front]))
    ran = run(*more, "--json", "-o", output)
    assert ran.status == 0, ran.err
    assert ran.events[0]["skipped"] == 2 and ran.events[-1]["frames"] == 10
    assert run(*more, "-o", tmp_path / "one").status == 0
    assert contents(output) == contents(tmp_path / "one")
    ran = run(*blue, "-o", output)
    assert ran.status == 2 and "what differs is environments" in ran.err, "it would leave finished images out"
    assert contents(output) == contents(tmp_path / "one")


def test_a_batch_does_not_grow_over_a_file_of_others(
    run: Run, tiny: list[str], files: Path, tmp_path: Path
) -> None:
    blue = [*tiny[:3], str(files / "skies" / "blue.exr"), *tiny[4:]]
    assert run(*blue, "-o", tmp_path).status == 0
    mine = tmp_path / "red_lambert-albedo-0.5_view.exr"
    mine.write_bytes(b"mine")
    before = contents(tmp_path)
    ran = run(*tiny, "-o", tmp_path)
    assert ran.status == 2 and mine.name in ran.err and contents(tmp_path) == before


def test_files_of_others_are_not_replaced(run: Run, tiny: list[str], tmp_path: Path) -> None:
    mine = tmp_path / "red_lambert-albedo-0.5_view.exr"
    mine.write_bytes(b"mine")
    ran = run(*tiny, "-o", tmp_path)
    assert ran.status == 2 and mine.name in ran.err and mine.read_bytes() == b"mine"
    assert run(*tiny, "--overwrite", "-o", tmp_path).status == 0
    assert read_image(mine).shape == (8, 12, 4)


def test_a_manifest_does_not_lead_out_of_its_folder(run: Run, tiny: list[str], tmp_path: Path) -> None:
    """--overwrite removes what a manifest lists, and a manifest may come from anywhere."""
    (tmp_path / "precious").write_bytes(b"here")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "manifest.json").write_text(
        json.dumps(
            {"frames": [{"file": "../precious"}, {"file": str(tmp_path / "precious")}, {"file": ".."}, 3]}
        )
    )
    assert run(*tiny, "--overwrite", "-o", tmp_path / "out").status == 0
    assert (tmp_path / "precious").read_bytes() == b"here"


def test_what_is_damaged_or_gone_is_made_again(run: Run, tiny: list[str], tmp_path: Path) -> None:
    output = tmp_path / "out"
    assert run(*tiny, "-o", output).status == 0
    before = contents(output)
    images = sorted(output.glob("*.exr"))
    changed = bytearray(images[0].read_bytes())
    changed[len(changed) // 2] ^= 1
    images[0].write_bytes(changed)
    images[1].unlink()
    (output / (".0123456789abcdef" * 2)).with_suffix(".exr")
    (output / f".{'0123456789abcdef' * 2}.exr").write_bytes(b"half")
    journal = (output / "finished.jsonl").read_bytes()
    (output / "finished.jsonl").write_bytes(journal[:-7])  # a line that was cut off
    ran = run(*tiny, "--json", "-o", output)
    # The last line's image is made again as well, whichever it was.
    assert ran.status == 0 and 2 <= sum(event["event"] == "frame" for event in ran.events) <= 3
    assert contents(output) == before


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 99}', "null"])
def test_a_manifest_that_is_none_is_another_job(run: Run, tiny: list[str], tmp_path: Path, text: str) -> None:
    output = tmp_path / "out"
    output.mkdir()
    (output / "manifest.json").write_text(text)
    ran = run(*tiny, "-o", output)
    assert ran.status == 2 and "another job" in ran.err and (output / "manifest.json").read_text() == text
    assert run(*tiny, "--overwrite", "-o", output).status == 0


@pytest.mark.parametrize(
    "journal", [b"", b"\n\n", b"{}\n", b'{"job": "other"}\n{"frame": 0}\n', b"\xff\xfe\n"]
)
def test_a_journal_that_says_nothing(run: Run, tiny: list[str], tmp_path: Path, journal: bytes) -> None:
    output = tmp_path / "out"
    assert run(*tiny, "-o", output).status == 0
    before = contents(output)
    (output / "finished.jsonl").write_bytes(journal)
    assert run(*tiny, "-o", output).status == 0 and contents(output) == before


# --- a run that is killed --------------------------------------------------------------------------------------


@contextlib.contextmanager
def started(arguments: list[str]) -> Iterator[subprocess.Popen[str]]:
    """`prtcl` in a process of its own, killed at the latest when the block ends."""
    command = [sys.executable, "-m", "prtcl", *arguments]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as job:
        try:
            yield job
        finally:
            job.kill()


def test_killed_at_ten_moments_the_set_is_that_of_one_run(run: Run, tiny: list[str], tmp_path: Path) -> None:
    """SIGKILL, again and again on one folder, at moments between its start and its last image.

    Moments are drawn as a number of images after which to kill, and a wait after that, so that they fall between the
    first and the last image however fast the machine is.
    """
    # Two folders are compared: which factorization each takes must not hang on what was timed there.
    job = [*tiny, "--factorization", "light", "--env-rotate", "0:360:8", "--png", "--json"]
    total = 4 * 45
    assert run(*job, "-o", tmp_path / "whole").status == 0
    whole = contents(tmp_path / "whole")
    output = tmp_path / "out"
    moments = random.Random(20261125)
    killed = finished = 0
    for number in range(10):
        lines = 0 if number in (0, 5) else moments.randrange(1, 9)
        with started([*job, "-o", str(output)]) as process:
            assert process.stdout is not None
            if not lines:  # on its way up
                time.sleep(moments.uniform(0.0, 0.5))
            while lines and (line := process.stdout.readline()):
                lines -= '"skipped"' not in line or '"started"' in line
            time.sleep(moments.uniform(0.0, 0.01))
            process.send_signal(signal.SIGKILL)
            killed += process.wait(timeout=60) == -signal.SIGKILL
        found = contents(output) if output.exists() else {}
        for name, value in found.items():
            if not name.startswith(".") and name != "finished.jsonl":
                assert value == whole[name], f"{name} is not whole after kill {number}"
        finished = sum(name.endswith(".exr") and name in whole for name in found)
    assert killed >= 8 and 0 < finished < total, f"{killed} killed, {finished} images: not the moments meant"
    ran = run(*job, "-o", output)
    assert ran.status == 0 and 0 < ran.events[0]["skipped"] < total
    assert contents(output) == whole


# --- a full disk -----------------------------------------------------------------------------------------------


def test_a_file_that_may_not_grow_ends_the_run_in_two_lines(
    run: Run, tiny: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system refuses the third image's last bytes, inside OpenEXR's own writer."""
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # an OpenCL driver may have put a handler there
    try:
        full_at_the_third(run, tiny, tmp_path, monkeypatch)
    finally:
        signal.signal(signal.SIGXFSZ, before if before is not None else signal.SIG_IGN)


def full_at_the_third(run: Run, tiny: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    output, calls = tmp_path / "out", 0
    assert run(*tiny, "-o", tmp_path / "whole").status == 0
    size = min(path.stat().st_size for path in (tmp_path / "whole").glob("*.exr"))
    real = writer_module.write_exr

    def third_is_too_large(path: Path, *rest: Any) -> None:
        nonlocal calls
        calls += 1
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        if calls == 3:
            resource.setrlimit(resource.RLIMIT_FSIZE, (size - 10, hard))
        try:
            real(path, *rest)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    monkeypatch.setattr(writer_module, "write_exr", third_is_too_large)
    refused(run(*tiny, "-o", output), output, 2)
    monkeypatch.setattr(writer_module, "write_exr", real)
    assert run(*tiny, "-o", output).status == 0
    assert contents(output) == contents(tmp_path / "whole")


def refused(ran: Ran, output: Path, images: int) -> None:
    """It ended with two lines and status 1, and left whole images and nothing else."""
    assert ran.status == 1 and len(ran.err.splitlines()) == 2, ran.err
    assert ran.err.startswith(f"prtcl relight: {output}") and "the same command" in ran.err
    assert set(os.listdir(output)) - SUPPORT == {p.name for p in output.glob("*.exr")}
    assert len([read_image(path) for path in output.glob("*.exr")]) == images
    assert (output / ".relight.lock").stat().st_size == 0


@pytest.mark.parametrize(
    ("call", "after"),
    [
        ("write", 0), ("write", 3), ("replace", 0), ("replace", 1), ("replace", 3), ("fsync", 0), ("fsync", 2),
        ("fsync", 4), ("fsync", 5), ("fsync", 6), ("fsync", 9), ("ftruncate", 0),
    ],
)  # fmt: skip
def test_a_disk_that_is_full_at_any_call(
    run: Run, tiny: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, after: int
) -> None:
    """ENOSPC from a system call of the folder's, once it has been made some times."""
    output = tmp_path / "out"
    assert run(*tiny, "-o", tmp_path / "whole").status == 0
    real, made = getattr(os, call), 0

    def full(*arguments: Any) -> Any:
        nonlocal made
        made += 1
        if made > after:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(os, call, full)
        ran = run(*tiny, "-o", output)
    assert made > after, "the call was not made so often"
    if ran.status == 0:  # the lock has no name in it, or a folder was not flushed: nothing is lost
        assert call in ("ftruncate", "fsync")
    else:
        refused(ran, output, len(list(output.glob("*.exr"))))
        assert "No space left on device" in ran.err
    assert run(*tiny, "-o", output).status == 0
    assert contents(output) == contents(tmp_path / "whole")


def test_a_line_that_is_cut_by_a_full_disk_is_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifest = {"format": 1, "job": "x", "inputs": {}, "frames": [{"file": "a.exr"}, {"file": "b.exr"}]}
    with folder_module.opened(str(tmp_path), manifest, False) as folder:
        folder.record(0, {"a.exr": "0"})
        before = (tmp_path / "finished.jsonl").read_bytes()
        real = os.write
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", lambda file, data: real(file, data[:5]))
            with pytest.raises(PrtclError, match="No space left"):
                folder.record(1, {"b.exr": "1"})
        assert (tmp_path / "finished.jsonl").read_bytes() == before and folder.finished == {0}


# --- two runs --------------------------------------------------------------------------------------------------


def test_a_second_run_is_told_who_is_there(run: Run, tiny: list[str], tmp_path: Path) -> None:
    output = tmp_path / "out"
    with started([*tiny, "--env-rotate", "0:360:1", "--json", "-o", str(output)]) as first:
        assert first.stdout is not None
        assert '"started"' in first.stdout.readline() and '"frame"' in first.stdout.readline()
        ran = run(*tiny, "--env-rotate", "0:360:1", "-o", output)
        assert ran.status == 1 and f"process {first.pid} on " in ran.err and len(ran.err.splitlines()) == 2
        assert run(*tiny, "--overwrite", "-o", output).status == 1, "--overwrite is no key to a lock"
        first.send_signal(signal.SIGKILL)
        first.wait(timeout=60)
    assert (output / ".relight.lock").stat().st_size > 0, "it still names the dead process"
    assert run(*tiny, "--overwrite", "-o", output).status == 0


def test_a_lock_ends_with_its_block(tmp_path: Path) -> None:
    with locked(tmp_path):
        with pytest.raises(PrtclError, match=f"process {os.getpid()} on "), locked(tmp_path):
            pass
        assert (tmp_path / ".relight.lock").stat().st_size > 0, "the refused run took the holder's name away"
    with pytest.raises(KeyError), locked(tmp_path):
        raise KeyError
    with locked(tmp_path):
        pass


# --- fingerprints ----------------------------------------------------------------------------------------------


def test_fingerprints_tell_values_apart() -> None:
    a = np.arange(6, dtype=np.int32)
    values: list[Any] = [
        a, a.astype(np.int64), a.reshape(2, 3), a[::-1], [a], [1, 2], ["1", "2"], ["12"], [[1], 2], {"a": 1},
        {"b": 1}, 1, 1.0, True, None, "None", [], {},
    ]  # fmt: skip
    assert len({digest(value) for value in values}) == len(values)
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    with pytest.raises(TypeError, match="object"):
        digest(object())


def test_all_of_a_mesh_and_a_material_counts() -> None:
    """Whatever an image depends on is in the fingerprint, and what it is called is not."""
    image = np.zeros((2, 2, 3), dtype=np.uint8)
    vertices = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]
    mesh = replace(
        Mesh.from_arrays(vertices, [[0, 1, 2]], name="a", colours=np.ones((3, 3))),
        uv=np.zeros((3, 2), dtype=np.float32), materials=(PartMaterial("p", (1, 1, 1), 0.0, 1.0, Texture(image)),),
    )  # fmt: skip
    part = mesh.materials[0]
    assert part is not None
    others = [
        replace(mesh, vertices=mesh.vertices * 2), replace(mesh, normals=mesh.smooth().normals),
        replace(mesh, faces=mesh.faces[:, ::-1]), replace(mesh, colours=None), replace(mesh, uv=None),
        replace(mesh, materials=(replace(part, roughness=0.5),)),
        replace(mesh, materials=(replace(part, texture=Texture(image + np.uint8(1))),)),
        replace(mesh, materials=(replace(part, texture=Texture(image, ("clamp", "repeat"))),)),
    ]  # fmt: skip
    prints = {mesh_digest(own) for own in [mesh, *others]} | {mesh_digest(mesh, np.zeros(3, np.uint32))}
    assert len(prints) == len(others) + 2
    assert mesh_digest(replace(mesh, name="b", notes=("read",))) == mesh_digest(mesh)
    table = from_table(
        np.linspace(0.5, 0.1, 6)[:, None] * np.ones(5), np.linspace(0, 1.5, 6), np.linspace(0, 1.5, 5)
    )
    assert table.table is not None
    wet = replace(table, table={**table.table, "values": table.table["values"] * 0.5})
    materials = [
        None,
        Material.parse("lambert:albedo=0.5"),
        Material.parse("lambert:albedo=mesh"),
        table,
        wet,
    ]
    assert len({material_digest(own) for own in materials}) == len(materials)
    assert material_digest(replace(table, spec="another file")) == material_digest(table)


def test_what_is_written_aside_is_what_is_cleared(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.exr") as aside:
        aside.touch()
        assert folder_module._ASIDE.fullmatch(aside.name)
    for name in (".relight.lock", ".hidden.exr", "a.exr", f".{'0' * 31}g.exr"):
        assert not folder_module._ASIDE.fullmatch(name)


def test_a_folder_that_is_looked_through_for_maps_is_no_output(
    run: Run, tiny: list[str], files: Path, tmp_path: Path
) -> None:
    shutil.copytree(files / "skies", tmp_path / "skies")
    rest = [*tiny[:2], *tiny[4:]]
    for env in (tmp_path / "skies", f"{tmp_path}/skies/*.exr"):
        ran = run(*rest, "--env", env, "-o", tmp_path / "skies")
        assert ran.status == 2 and "where --env looks for maps" in ran.err and len(ran.err.splitlines()) == 1
    assert len(list((tmp_path / "skies").iterdir())) == 2


def test_an_unfinished_image_is_no_obstacle(run: Run, tiny: list[str], files: Path, tmp_path: Path) -> None:
    """Killed between an image's name and its line, the batch may go on without that light."""
    assert run(*tiny, "-o", tmp_path / "out").status == 0
    journal = (tmp_path / "out" / "finished.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "out" / "finished.jsonl").write_bytes(b"".join(journal[:3]))
    blue = [*tiny[:3], str(files / "skies" / "blue.exr"), *tiny[4:]]
    ran = run(*blue, "--json", "-o", tmp_path / "out")
    assert ran.status == 0 and ran.events[0]["skipped"] == 2
    assert run(*blue, "-o", tmp_path / "one").status == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "one")


@pytest.mark.parametrize("line", ['{"frame": 1e999, "sha256": {}}', "[" * 200_000, "3", '{"sha256": 1}'])
def test_lines_that_no_run_writes(run: Run, tiny: list[str], tmp_path: Path, line: str) -> None:
    assert run(*tiny, "-o", tmp_path).status == 0
    before = contents(tmp_path)
    with (tmp_path / "finished.jsonl").open("a") as file:
        file.write(f"{line}\n")
    assert run(*tiny, "-o", tmp_path).status == 0 and contents(tmp_path) == before


@pytest.mark.parametrize("name", [-1, 10**29, "\0", "\ud800.exr", "foreign.txt", "../out.exr"])
def test_names_that_no_run_writes(run: Run, tiny: list[str], files: Path, tmp_path: Path, name: Any) -> None:
    blue = [*tiny[:3], str(files / "skies" / "blue.exr"), *tiny[4:]]
    output = tmp_path / "out"
    assert run(*blue, "-o", output).status == 0
    manifest = json.loads((output / "manifest.json").read_text())
    manifest["frames"][0]["file"] = name
    (output / "manifest.json").write_text(json.dumps(manifest))
    (output / "foreign.txt").write_bytes(b"here")
    ran = run(*tiny, "-o", output)
    assert ran.status == 2 and "--overwrite" in ran.err and len(ran.err.splitlines()) <= 2
    assert run(*tiny, "--overwrite", "-o", output).status == 0
    assert (output / "foreign.txt").read_bytes() == b"here"


def test_what_differs_is_told_first_where_it_may_not(
    run: Run, tiny: list[str], files: Path, tmp_path: Path
) -> None:
    """Another light is no reason to refuse a batch; another option is."""
    blue = [*tiny[:3], str(files / "skies" / "blue.exr"), *tiny[4:]]
    assert run(*blue, "-o", tmp_path).status == 0
    ran = run(*tiny, "--one-sided", "-o", tmp_path)
    assert ran.status == 2 and "what differs is one-sided: False there, True here" in ran.err

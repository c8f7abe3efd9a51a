"""The command line: what it writes, what it prints, its exit status, and an answer to every bad input."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from cases import Ran, Run
from numpy.typing import NDArray
from PIL import Image

from prtcl._version import __version__
from prtcl.apps.interrupts import deferred_interrupts
from prtcl.compute import choice
from prtcl.errors import DeviceError, InputError
from prtcl.files.image import read_image, write_exr
from prtcl.scene.bake import Bake
from prtcl.scene.mesh import Mesh
from prtcl.scene.scene import Scene

ROOT = Path(__file__).resolve().parents[1]


def sky(height: int = 16) -> NDArray[np.float32]:
    """Brighter above, and coloured."""
    rows = np.linspace(2.0, 0.5, height)[:, None, None] * np.array([1.0, 0.9, 0.7])
    return np.broadcast_to(rows, (height, 2 * height, 3)).astype(np.float32)


def write_sky(path: Path, image: NDArray[np.float32]) -> Path:
    write_exr(path, np.dstack([image, np.ones(image.shape[:2], np.float32)]))
    return path


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A folder of a ball and a sky; outputs go into `out` beside them."""
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    write_sky(tmp_path / "sky.exr", sky())
    (tmp_path / "out").mkdir()
    return tmp_path


@pytest.fixture
def tiny(files: Path, opencl_device: choice.Seen) -> list[str]:
    """The arguments of a render of a moment, all but the output."""
    return ["render", f"{files}/ball.ply", "--env", f"{files}/sky.exr", "--size", "12x8", "--samples", "1",
            "--device", opencl_device.spec]  # fmt: skip


# --- what works ----------------------------------------------------------------------------------------------


def test_render_writes_an_image_and_says_so(run: Run, files: Path, tiny: list[str]) -> None:
    output = files / "out" / "a.exr"
    ran = run(*tiny, "-o", output)
    assert ran.status == 0
    assert re.fullmatch(
        rf"{re.escape(str(output))}: 12x8, \d+ points, [\d.]+ M rays, [\d.]+ s on .+\n", ran.out
    )
    image = read_image(output)
    assert image.shape == (8, 12, 4) and np.isfinite(image).all()
    assert image[4, 6, 3] == 1 and image[0, 0, 3] == 0
    assert image[2, 6, 0] > image[5, 6, 0] > 0  # brighter above; row 6 is the ball's lower edge
    assert os.listdir(files / "out") == ["a.exr"]


def test_an_input_is_never_overwritten(run: Run, files: Path, tiny: list[str]) -> None:
    environment = files / "sky.exr"
    before = environment.read_bytes()
    ran = run(*tiny, "-o", environment)
    assert ran.status == 2 and "sky.exr" in ran.err and environment.read_bytes() == before


def test_png_adds_a_preview(run: Run, files: Path, tiny: list[str]) -> None:
    assert run(*tiny, "-o", files / "out" / "a.exr", "--png").status == 0
    assert sorted(os.listdir(files / "out")) == ["a.exr", "a.png"]
    named = run(*tiny, "-o", files / "out" / "a.exr", "--png", files / "out" / "b.png", "--exposure", "-1.5")
    assert named.status == 0
    with Image.open(files / "out" / "b.png") as preview, Image.open(files / "out" / "a.png") as first:
        assert preview.size == (12, 8) and preview.info["exposure"] == "-1.5 stops"
        assert np.asarray(preview)[..., :3].max() < np.asarray(first)[..., :3].max()


def test_quiet_prints_nothing(run: Run, files: Path, tiny: list[str]) -> None:
    assert run(*tiny, "--quiet", "-o", files / "out" / "a.exr") == (0, "", "")
    bake = run("bake", files / "ball.ply", "-o", files / "out" / "a.npz", "--rays", "2", "--quiet")
    assert bake == (0, "", "")


def test_json_is_the_report_and_nothing_else(run: Run, files: Path, tiny: list[str]) -> None:
    for more in ([], ["--quiet"], ["--explain"]):
        ran = run(*tiny, "--json", *more, "-o", files / "out" / "a.exr")
        report = json.loads(ran.out)
        assert ran.status == 0 and report["points"] == "pixel" and report["seconds"]["total"] > 0
    assert "resolution" in ran.err  # --explain went there


def test_explain_says_what_was_chosen(run: Run, files: Path, tiny: list[str]) -> None:
    ran = run(
        *tiny, "--explain", "--brdf", "ggx:alpha=0.3,f0=0.04", "--levels", "5", "-o", files / "out/a.exr"
    )
    for word in ("device  ", "light 4^5", "GGX alpha 0.3", "hard light", "left out", "points  "):
        assert word in ran.out


def test_options_reach_the_scene(
    run: Run, files: Path, tiny: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[Scene, dict[str, Any]]] = []

    def render(self: Scene, **options: Any) -> None:
        seen.append((self, options))
        raise InputError("enough")

    monkeypatch.setattr(Scene, "render", render)
    options = """--brdf lambert:albedo=0.2 --env-rotate -30 --env-up z --eye -3 -1e-1 .5 --target -.25 0 1e-2 --fov 25
        --samples 3 --points vertex --one-sided --smooth --levels 6 --rays 3 --keep 4 --views 32
        --method tree --hard-light off --precision float32"""
    ran = run(*tiny, *options.split(), "-o", files / "out" / "a.exr")
    assert ran.err == "prtcl render: enough\n"
    [(scene, given)] = seen
    assert given.pop("progress") is not None and given == {
        "points": "vertex",
        "samples": 3,
        "error": None,
        "plan": None,
    }
    camera, own = scene.camera, scene.settings[0][0]
    assert camera.eye == (-3.0, -0.1, 0.5) and camera.target == (-0.25, 0.0, 0.01)
    assert camera.up == (0.0, 0.0, 1.0) and camera.fov == 25.0 and camera.size == (12, 8)
    assert (own.levels, own.rays, own.keep, own.views, own.method, own.hard) == (6, 3, 4, 32, "tree", "off")
    assert scene.environment.rotate == -30.0 and scene.environment.up == "z"
    assert not scene.two_sided and scene.mesh.normals is not None
    assert scene.materials[0].spec == "lambert:albedo=0.2"


def test_a_bake_is_rendered_under_any_light(run: Run, files: Path, tiny: list[str]) -> None:
    bake = files / "out" / "ball.npz"
    ran = run("bake", files / "ball.ply", "-o", bake, "--rays", "3")
    assert ran.status == 0 and ran.out.startswith(f"{bake}: 162 vertices, {162 * 64} rays, ")
    again = run("bake", files / "ball.ply", "-o", bake, "--rays", "3", "--json")
    report = json.loads(again.out)
    assert report["vertices"] == 162 and report["rays"] == 162 * 64
    assert report["bytes_per_point"] == {"visibility_bits": 8}
    ran = run(tiny[0], bake, *tiny[2:], "--json", "-o", files / "out" / "a.exr")
    assert ran.status == 0 and json.loads(ran.out)["points"] == "vertex"
    assert read_image(files / "out" / "a.exr")[4, 6, :3].min() > 0


@pytest.mark.usefixtures("nothing_is_traced")
@pytest.mark.parametrize(
    "options,words",
    [
        ("--rays 4", ["--rays 4: ", "was traced with 2; bake again with --rays 4"]),
        ("--smooth", ["--smooth: ", "bake again with --smooth"]),
        ("--points pixel", ["--points pixel: ", "holds the rays of vertices", "render the mesh"]),
    ],
)
def test_what_a_bake_has_fixed_cannot_be_asked_for(
    run: Run, files: Path, tiny: list[str], small_bake: Path, options: str, words: list[str]
) -> None:
    ran = run("render", small_bake, *tiny[2:], *options.split(), "-o", files / "out" / "a.exr")
    assert_refused(ran, str(small_bake), *words)
    assert not os.listdir(files / "out")


def test_what_a_bake_has_may_be_asked_for(run: Run, files: Path, tiny: list[str], small_bake: Path) -> None:
    output = files / "out" / "a.exr"
    ran = run("render", small_bake, *tiny[2:], "--rays", "2", "--points", "vertex", "--quiet", "-o", output)
    assert ran == (0, "", "") and read_image(output).shape == (8, 12, 4)


def test_a_bake_takes_no_device(run: Run, files: Path) -> None:
    ran = run("bake", files / "ball.ply", "-o", files / "out" / "a.npz", "--device", "0")
    assert_refused(ran, "unrecognized arguments: --device")
    assert "--device" not in run("bake", "--help").out and "--device" in run("render", "--help").out


def test_notes_go_to_standard_error(run: Run, files: Path, tiny: list[str]) -> None:
    """A degenerate triangle is left out; NaN is repaired if one says so."""
    made = trimesh.creation.icosphere(subdivisions=1)
    faces = np.concatenate([made.faces, [[0, 0, 1]]])
    lines = [f"v {x} {y} {z}" for x, y, z in made.vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    (files / "thin.obj").write_text("\n".join(lines) + "\n")
    image = sky()
    image[3, 5, 1] = np.nan
    write_sky(files / "nan.exr", image)
    output = files / "out" / "a.exr"
    ran = run("render", files / "thin.obj", "--env", files / "nan.exr", "--repair", *tiny[4:], "-o", output)
    assert ran.status == 0
    assert "dropped 1 degenerate triangles of 81" in ran.err and "replaced 1 NaN" in ran.err
    assert np.isfinite(read_image(output)).all()


def test_devices_lists_them_and_the_one_used(run: Run, opencl_device: choice.Seen) -> None:
    ran = run("devices", "--device", opencl_device.spec)
    assert ran.status == 0 and ran.err == ""
    assert re.search(rf"^\* {opencl_device.spec} ", ran.out, re.M)
    assert f"used: {opencl_device.spec} {opencl_device.name}: asked for by --device" in ran.out
    report = json.loads(run("devices", "--json", "--device", opencl_device.spec).out)
    assert report["used"] == opencl_device.spec and len(report["devices"]) == len(choice.devices())


def test_the_demo_needs_nothing(run: Run, tmp_path: Path, opencl_device: choice.Seen) -> None:
    folder = tmp_path / "new" / "demo"
    ran = run("demo", "-o", folder, "--size", "32x24", "--json", "--device", opencl_device.spec)
    assert ran.status == 0
    reports = json.loads(ran.out)
    assert len(reports) == 3 and reports == json.loads((folder / "report.json").read_text())
    for name in reports:
        image = read_image(folder / f"{name}.exr")
        assert image.shape == (24, 32, 4) and np.isfinite(image).all() and image[..., :3].mean() > 0.1
        assert (folder / f"{name}.png").is_file()
    assert len(list(folder.glob("sky-*.exr"))) == 2


def test_help_and_version(run: Run) -> None:
    assert run("--version").out == f"prtcl {__version__}\n"
    assert "render" in run("--help").out
    for command in ("demo", "render", "bake", "devices"):
        ran = run(command, "--help")
        assert ran.status == 0 and "usage:" in ran.out


def test_a_process_of_its_own(files: Path, tiny: list[str]) -> None:
    output = files / "out" / "a.exr"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "prtcl", *tiny, "--quiet", "-o", str(output)],
        cwd=ROOT, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert read_image(output).shape == (8, 12, 4)
    done = subprocess.run(
        [sys.executable, "-m", "prtcl", *tiny[:2], "--env", "no.exr", "-o", str(output)],
        cwd=ROOT, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert (
        done.returncode == 2 and done.stdout == "" and done.stderr.startswith("prtcl render: no.exr: no such")
    )


# --- what does not -------------------------------------------------------------------------------------------


@pytest.fixture
def nothing_is_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hemisphere traced ends the job with another exit status than 2."""

    def traced(*_: Any, **__: Any) -> None:
        raise AssertionError("traced before the input was checked")

    for name in ("visibility", "light_visibility"):
        monkeypatch.setattr(f"prtcl.factors.visibility.Tracer.{name}", traced)


@pytest.fixture
def no_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even a mesh read is too much."""

    def made(*_: Any, **__: Any) -> None:
        raise AssertionError("work was done before the output was checked")

    for name in ("scene_options.Scene", "scene_options.read_environment", "render.Device", "bake.read_mesh"):
        monkeypatch.setattr(f"prtcl.apps.{name}", made)


def assert_refused(ran: Ran, *words: str, status: int = 2) -> None:
    print(ran.err)
    assert ran.status == status and ran.out == ""
    assert 1 <= len(ran.err.splitlines()) <= 2 and "Traceback" not in ran.err and "bug" not in ran.err
    assert ran.err.startswith("prtcl")
    for word in words:
        assert word in ran.err


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def nan_sky() -> NDArray[np.float32]:
    image = sky().copy()
    image[3, 5, 1] = np.nan
    return image


def obj(*lines: str) -> bytes:
    return ("\n".join(lines) + "\n").encode()


@pytest.mark.usefixtures("nothing_is_traced")
class TestBadInput:
    """Refused with status 2 and two lines at most that name the file; nothing traced, nothing left behind."""

    @pytest.mark.parametrize(
        "content,words",
        [
            (None, ["no such file"]),
            (b"", ["empty file"]),
            (b"not an image", ["expected an EXR"]),
            ("half", ["incomplete EXR", "copy or export"]),
            (sky()[:, :30], ["twice as wide as high", "30x16", "convert or resize"]),
            (nan_sky(), ["1 NaN", "row 3, column 5", "--repair"]),
            (-sky(), ["negative", "--repair"]),
        ],
    )  # fmt: skip
    def test_environments(
        self, run: Run, files: Path, tiny: list[str], content: Any, words: list[str]
    ) -> None:
        path = files / "bad.exr"
        if isinstance(content, np.ndarray):
            write_sky(path, content)
        elif content == "half":
            whole = (files / "sky.exr").read_bytes()
            path.write_bytes(whole[: len(whole) // 2])
        elif content is not None:
            path.write_bytes(content)
        before = contents(files)
        ran = run(*tiny, "--env", path, "-o", files / "out" / "a.exr")
        assert_refused(ran, f"{path}: ", *words)
        assert contents(files) == before

    @pytest.mark.parametrize(
        "name,content,words",
        [
            ("no.ply", None, ["no such file"]),
            ("no.npz", None, ["no such file", "bake"]),
            ("bad.txt", b"x", ["expected a mesh", ".obj"]),
            ("bad.ply", b"", ["empty file"]),
            ("bad.ply", "half", ["bad.ply"]),
            ("bad.obj", obj("# nothing"), ["no vertices"]),
            ("bad.obj", obj("v 0 0 0", "v 1 0 0", "v 0 1 0"), ["no faces"]),
            ("bad.obj", obj("v 0 0 nan", "v 1 0 0", "v 0 1 0", "f 1 2 3"), ["NaN", "vertex 0", "export"]),
            ("bad.obj", obj("v 0 0 0", "v 1 0 0", "v 0 1 0", "f 1 1 2"), ["1 triangles are degenerate"]),
            ("bad.obj", obj("v 0 0 0", "v 1 0 0", "v 0 1 0", "f 1 2 9"), ["bad.obj"]),
        ],
    )
    def test_meshes(
        self, run: Run, files: Path, tiny: list[str], name: str, content: Any, words: list[str]
    ) -> None:
        path = files / name
        if content == "half":
            whole = (files / "ball.ply").read_bytes()
            path.write_bytes(whole[: len(whole) // 2])
        elif content is not None:
            path.write_bytes(content)
        before = contents(files)
        assert_refused(run("render", path, *tiny[2:], "-o", files / "out" / "a.exr"), f"{path}: ", *words)
        if path.suffix != ".npz":
            assert_refused(run("bake", path, "-o", files / "out" / "a.npz"), f"{path}: ", *words)
        assert contents(files) == before

    @pytest.mark.parametrize(
        "spec,words",
        [
            ("phong", ["unknown kind 'phong'", "forms: lambert:"]),
            ("lambert:albedo=2", ["albedo expected from 0 to 1, got 2"]),
            ("lambert:albedo=red", ["albedo expected a number or r/g/b"]),
            ("ggx:alpha=0.3", ["expected f0, or both eta and k"]),
            ("table:no.npz", ["no.npz: no such file"]),
        ],
    )
    def test_materials(self, run: Run, files: Path, tiny: list[str], spec: str, words: list[str]) -> None:
        assert_refused(run(*tiny, "--brdf", spec, "-o", files / "out" / "a.exr"), *words)
        assert not os.listdir(files / "out")

    def test_tables(self, run: Run, files: Path, tiny: list[str]) -> None:
        path = files / "table.npz"
        np.savez(path, values=np.ones((3, 2, 3)), theta_h=[0.0, 45.0, 90.0], theta_d=[0.0, 1.5])
        ran = run(*tiny, "--brdf", f"table:{path}", "-o", files / "out" / "a.exr")
        assert_refused(ran, f"{path}: theta_h", "degrees?")
        path.write_bytes(path.read_bytes()[:300])
        ran = run(*tiny, "--brdf", f"table:{path}", "-o", files / "out" / "a.exr")
        assert_refused(ran, f"{path}: ")

    @pytest.mark.parametrize(
        "options,words",
        [
            ("--eye 0 0 0.1 --target 0 0 0", ["(0 0 0.1) is inside the mesh", "--eye"]),
            ("--eye 0 0 5 --target 9 0 5", ["sees nothing of the mesh", "--eye or --target"]),
            ("--eye 1 2 3 --target 1 2 3", ["eye and target are the same point"]),
            ("--eye 0 5 0 --target 0 0 0", ["up:"]),
            ("--eye nan 0 5", ["eye: expected three finite numbers"]),
            ("--up 0 0 0", ["up: "]),
            ("--fov 0", ["fov: expected degrees between 0 and 180, got 0"]),
            ("--fov nan", ["fov: expected"]),
            ("--fov 180", ["fov: expected"]),
            ("--eye 1 2", ["--eye", "expected 3 arguments", "see prtcl render --help"]),
            ("--size 640", ["--size", "expected WIDTHxHEIGHT", "got '640'"]),
            ("--size 0x4", ["--size", "got '0x4'"]),
            ("--size 4x-4", ["--size"]),
            ("--size 1e3x4", ["--size"]),
            ("--size 99999x4", ["--size"]),
            ("--samples 0", ["samples: expected 1 to 64", "got 0"]),
            ("--samples 65", ["samples: expected 1 to 64"]),
            ("--samples two", ["--samples", "invalid int value: 'two'"]),
            ("--points face", ["--points", "choose from"]),
            ("--levels 0", ["levels: expected 1 to"]),
            ("--levels 12", ["levels: expected 1 to", "got 12"]),
            ("--rays 9 --levels 4", ["rays"]),
            ("--keep 9", ["keep"]),
            ("--views 1", ["views: expected at least 2, got 1"]),
            ("--method fast", ["--method"]),
            ("--precision half", ["--precision"]),
            ("--env-rotate nan", ["env-rotate: expected degrees"]),
            ("--env-up x", ["--env-up"]),
            ("--exposure nan", ["--exposure nan"]),
            ("--frobnicate", ["unrecognized arguments: --frobnicate"]),
            ("--device nope", ["--device nope: no OpenCL device matches", "there are: 0:0"]),
            ("--device 99", ["--device 99"]),
        ],
    )
    def test_options(self, run: Run, files: Path, tiny: list[str], options: str, words: list[str]) -> None:
        assert_refused(run(*tiny, *options.split(), "--png", "-o", files / "out" / "a.exr"), *words)
        assert not os.listdir(files / "out")

    def test_commands(self, run: Run, files: Path) -> None:
        assert_refused(run(), "COMMAND")
        assert_refused(run("paint"), "paint")
        assert_refused(run("render", files / "ball.ply"), "--env", "-o")
        assert_refused(run("devices", "--device", "nope"), "nope")
        assert_refused(
            run("bake", files / "ball.ply", "-o", files / "a.npz", "--rays", "0"), "rays: expected"
        )
        assert_refused(run("demo", "-o", files / "ball.ply"), f"{files / 'ball.ply'}: cannot make the folder")


@pytest.mark.usefixtures("no_scene")
@pytest.mark.parametrize("command", ["render", "bake"])
def test_bad_outputs_are_found_before_any_work(run: Run, files: Path, tiny: list[str], command: str) -> None:
    start = tiny if command == "render" else ["bake", f"{files}/ball.ply"]
    ending = "exr" if command == "render" else "npz"
    (files / f"folder.{ending}").mkdir()
    before = contents(files)
    for output, word in (
        (files / "missing" / f"a.{ending}", "there is no folder"),
        (files / "ball.ply" / f"a.{ending}", "is a file and not a folder"),
        (files / f"folder.{ending}", "got a folder"),
        (files / "out" / "a.jpg", f"ends in .{ending}"),
        (files / "out" / "a", f"ends in .{ending}"),
        (files / f"{'a' * 300}.{ending}", "cannot be written"),
    ):
        assert_refused(run(*start, "-o", output), str(output), word)
    if os.geteuid() != 0:  # root may write anywhere
        (files / "out").chmod(0o555)
        assert_refused(run(*start, "-o", files / "out" / f"a.{ending}"), "cannot be written")
        (files / "out").chmod(0o755)
    assert contents(files) == before


@pytest.mark.usefixtures("no_scene")
def test_bad_previews_are_found_before_any_work(run: Run, files: Path, tiny: list[str]) -> None:
    output = files / "out" / "a.exr"
    for preview, word in (
        (files / "missing" / "a.png", "there is no folder"),
        (output, "ends in .png"),
        (files / "out" / "a.jpg", "ends in .png"),
    ):
        assert_refused(run(*tiny, "-o", output, "--png", preview), str(preview), word)
    assert not os.listdir(files / "out")


def test_no_opencl_platform(run: Run, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pyopencl as cl

    def none() -> None:
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(cl, "get_platforms", none)
    render = ["render", files / "ball.ply", "--env", files / "sky.exr", "-o", files / "out" / "a.exr"]
    for arguments in (render, ["devices"], ["demo", "-o", files / "out"]):
        ran = run(*arguments)
        assert_refused(ran, "no OpenCL platform was found", "pip install 'prtcl[pocl]'", status=1)
    assert not os.listdir(files / "out")
    # Baking takes rays alone.
    assert run("bake", files / "ball.ply", "-o", files / "out" / "a.npz", "--rays", "1").status == 0


@pytest.mark.parametrize(
    "error,status,word",
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 1, "out of memory"),
        (DeviceError("the device is gone"), 1, "the device is gone"),
        (RuntimeError("clEnqueueNDRangeKernel failed\nsecond line"), 1, "clEnqueueNDRangeKernel failed"),
        (ZeroDivisionError(), 1, "ZeroDivisionError"),
    ],
)
def test_a_job_that_fails_leaves_the_old_output(
    run: Run, files: Path, tiny: list[str], monkeypatch: pytest.MonkeyPatch, error: BaseException, status: int,
    word: str,
) -> None:  # fmt: skip
    output = files / "out" / "a.exr"
    output.write_bytes(b"the old picture")
    before = contents(files)

    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.delenv("PRTCL_DEBUG", raising=False)
    monkeypatch.setattr(Scene, "render", fail)
    ran = run(*tiny, "--png", "-o", output)
    assert ran.status == status and ran.out == "" and word in ran.err
    assert ran.err.startswith("prtcl render: ") and len(ran.err.splitlines()) <= 2
    assert "Traceback" not in ran.err and "second line" not in ran.err
    assert contents(files) == before


def test_an_interrupted_bake_leaves_the_old_one(
    run: Run, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = files / "out" / "a.npz"
    output.write_bytes(b"the old bake")

    def interrupt(file: Any, **_: Any) -> None:
        file.write(b"half of")
        raise KeyboardInterrupt

    monkeypatch.setattr("prtcl.scene.bake.np.savez", interrupt)
    ran = run("bake", files / "ball.ply", "-o", output, "--rays", "1", "--quiet")
    assert (ran.status, ran.out, ran.err) == (
        130,
        "",
        "prtcl bake: interrupted; no output was left half written\n",
    )
    assert os.listdir(files / "out") == ["a.npz"] and output.read_bytes() == b"the old bake"


def test_an_interrupted_demo_leaves_the_old_report(
    run: Run, tmp_path: Path, opencl_device: choice.Seen, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "report.json").write_text("the old report")
    write = Path.write_text

    def interrupt(path: Path, text: str, **how: Any) -> None:
        write(path, text[:10], **how)
        raise KeyboardInterrupt

    monkeypatch.setattr("prtcl.apps.demo.VIEWS", ())
    monkeypatch.setattr(Path, "write_text", interrupt)
    ran = run("demo", "-o", tmp_path, "--quiet", "--device", opencl_device.spec)
    assert ran.status == 130 and os.listdir(tmp_path) == ["report.json"]
    assert (tmp_path / "report.json").read_text() == "the old report"


def test_an_interrupt_waits_for_imports_and_is_not_lost() -> None:
    """Some libraries catch every exception of their own imports, Ctrl-C with them."""
    reached = False
    with pytest.raises(KeyboardInterrupt), deferred_interrupts():
        with contextlib.suppress(BaseException):
            signal.raise_signal(signal.SIGINT)
        reached = True
    assert reached
    reached = False
    with pytest.raises(KeyboardInterrupt), deferred_interrupts():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)  # someone who insists
        reached = True
    assert not reached
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_interrupts_leave_other_handlers_alone() -> None:
    """A job in the background ignores Ctrl-C, and goes on doing so."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with deferred_interrupts():
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("delay", [0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8])
def test_an_interrupt_at_any_time(files: Path, delay: float) -> None:
    """While the command's libraries are imported as well, which takes about half a second."""
    trimesh.creation.icosphere(subdivisions=5).export(files / "fine.ply")
    # The line is printed where interrupts are held back: before that they are Python's own.
    program = (
        "import sys; from prtcl.apps import cli; parser = cli.parser\n"
        "cli.parser = lambda: (print(flush=True), parser())[1]; sys.exit(cli.main())"
    )
    command = [
        sys.executable,
        "-c",
        program,
        "bake",
        f"{files}/fine.ply",
        "-o",
        f"{files}/out/a.npz",
        "--rays",
        "8",
    ]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as job:
        assert job.stdout is not None and job.stderr is not None
        job.stdout.readline()
        time.sleep(delay)
        job.send_signal(signal.SIGINT)
        sent = time.monotonic()
        message = job.stderr.read()
    assert job.returncode == 130 and message.splitlines()[-1].endswith(
        "interrupted; no output was left half written"
    )
    assert "Traceback" not in message and not os.listdir(files / "out")
    assert time.monotonic() - sent < 20  # of the job's 100 seconds


def test_debugging_shows_the_traceback(
    run: Run, tiny: list[str], files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(Scene, "render", fail)
    monkeypatch.setenv("PRTCL_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        run(*tiny, "-o", files / "out" / "a.exr")


# --- damaged bakes -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def small_bake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = trimesh.creation.icosphere(subdivisions=1)
    path = tmp_path_factory.mktemp("bake") / "ball.npz"
    Bake.trace(Mesh.from_arrays(made.vertices, made.faces), rays=2).save(path)
    return path


def same(first: Bake, second: Bake) -> bool:
    return first.rays == second.rays and all(
        np.array_equal(a, b)
        for a, b in (
            (first.bits, second.bits),
            (first.mesh.vertices, second.mesh.vertices),
            (first.mesh.faces, second.mesh.faces),
            (first.mesh.normals, second.mesh.normals),
            (first.mesh.parts, second.mesh.parts),
        )
    )


def test_every_truncated_bake_is_refused(small_bake: Path, tmp_path: Path) -> None:
    whole = small_bake.read_bytes()
    path = tmp_path / "cut.npz"
    for length in [*range(0, len(whole), 53), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=re.escape(str(path))) as caught:
            Bake.load(path)
        assert len(str(caught.value).splitlines()) <= 2


def test_every_flipped_byte_of_a_bake_is_refused_or_harmless(small_bake: Path, tmp_path: Path) -> None:
    """An archive's own bookkeeping has bytes that do not matter; its data has checksums."""
    whole, good = small_bake.read_bytes(), Bake.load(small_bake)
    path = tmp_path / "flipped.npz"
    refused = 0
    for at in range(0, len(whole), 7):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ (1 << at % 8)]) + whole[at + 1 :])
        try:
            assert same(Bake.load(path), good)
        except InputError as error:
            assert str(path) in str(error) and len(str(error).splitlines()) <= 2
            refused += 1
    assert refused > len(whole) / 7 * 0.5


@pytest.mark.usefixtures("nothing_is_traced")
def test_damaged_bakes_on_the_command_line(run: Run, files: Path, tiny: list[str], small_bake: Path) -> None:
    whole = small_bake.read_bytes()
    path = files / "bad.npz"
    half = len(whole) // 2
    flipped = whole[:half] + bytes([whole[half] ^ 0xFF]) + whole[half + 1 :]
    for content in (whole[:-1], whole[:half], b"", b"no archive", flipped):
        path.write_bytes(content)
        ran = run("render", path, *tiny[2:], "-o", files / "out" / "a.exr")
        assert_refused(ran, f"{path}: ", "again")
    np.savez(path, values=np.zeros(3))
    assert_refused(
        run("render", path, *tiny[2:], "-o", files / "out" / "a.exr"), f"{path}: is no bake", "prtcl bake"
    )
    assert not os.listdir(files / "out")

"""The viewer without a browser: looks, cameras, what is saved and where, whose turn it is, who may connect."""

from __future__ import annotations

import json
import math
import socket
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prtcl.apps.cli import main
from prtcl.apps.view import saving, web
from prtcl.apps.view.command import listed, part_names, writable_folder
from prtcl.apps.view.look import ALPHA, KINDS, PRESETS, History, Look
from prtcl.apps.view.loop import WAITING, Loop, Seat
from prtcl.apps.view.state import (
    MOVING_PIXELS,
    Eye,
    State,
    develop,
    linear_colour,
    metered_exposure,
    picked_colour,
)
from prtcl.apps.view.studio import FINE, MOVING, STILL, Drawn, Quality
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.material import Material
from prtcl.files.image import srgb, write_exr
from prtcl.scene.bake import Bake
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import read_mesh
from prtcl.scene.scene import Render

EYE = Eye((1.0, 2.0, 3.0), (0.0, 0.5, 0.0), (0.0, 1.0, 0.0), 0.6, (800, 500))
STATE = State(EYE, (Look(),), "sky")


# --- looks ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_materials_within_the_sliders(name: str) -> None:
    look = PRESETS[name]
    assert look.cleaned() == look
    again = Look.of(Material.parse(look.spec))
    assert again.kind == look.kind
    assert np.allclose(again.colour, look.colour, atol=1e-3)
    assert math.isclose(again.alpha, look.alpha, rel_tol=2e-3) or look.kind == "lambert"


@pytest.mark.parametrize(
    ("spec", "kind"),
    [
        ("lambert:albedo=0.1/0.2/0.3", "lambert"),
        ("ggx:alpha=0.3,eta=0.2,k=3.0", "as given"),
        ("ggx:alpha=0.3,f0=0.9/0.7/0.3", "metal"),
        ("ggx:alpha=0.3,f0=0.04,kd=0.5", "dielectric"),
        ("ggx:alpha=0.001,f0=0.04,kd=0.5", "as given"),
        ("blinn:exponent=50,ks=0.2,kd=0.3", "blinn"),
        ("lambert:albedo=0.5*mesh", "lambert"),
        ("ggx:alpha=0.3,f0=0.04,kd=mesh", "dielectric"),
        ("ggx:alpha=0.3,f0=0.9*mesh", "as given"),
        ("gltf:base=mesh,roughness=0.5,metallic=0.4", "as given"),
    ],
)
def test_a_look_keeps_the_material_it_is_made_of(spec: str, kind: str) -> None:
    look = Look.of(Material.parse(spec))
    assert look.kind == kind
    assert look.cleaned() == look
    a, b = look.material.reference(), Material.parse(spec).reference()
    assert look.material.tints == Material.parse(spec).tints
    for name, value in b.items():
        if isinstance(value, int | float | tuple | list | np.ndarray):
            assert np.allclose(a[name], value, rtol=1e-3), name
        else:
            assert a[name] == value


def test_what_comes_from_a_page_is_put_into_range() -> None:
    wild = Look("evil", (math.nan, -3.0, 7.0), alpha=math.inf, specular=-1.0).cleaned()
    assert wild == Look("lambert", (0.0, 0.0, 1.0), alpha=ALPHA[0], specular=0.0)
    assert Look("as given").cleaned().kind == "lambert"  # nothing was given
    for kind in KINDS:
        Material.parse(Look(kind).spec)


def test_history_takes_one_drag_as_one_step() -> None:
    history, looks = History(), tuple((Look(alpha=0.1 * n),) for n in range(1, 6))
    history.record(looks[0], "alpha", 0.0)
    history.record(looks[1], "alpha", 0.5)  # the same drag
    history.record(looks[2], "colour", 0.6)
    assert history.undo(looks[3]) == looks[2]
    assert history.undo(looks[2]) == looks[0]
    assert history.undo(looks[0]) == looks[0]
    assert history.redo(looks[0]) == looks[2]
    assert history.redo(looks[2]) == looks[3]
    history.undo(looks[3])
    history.record(looks[4], "alpha", 0.7)  # undo ended the drag; what was undone is gone
    assert history.redo(looks[4]) == looks[4]


# --- pictures -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("canvas", [(800, 500), (500, 800), (4000, 3000), (0, 0), (10**9, 5)])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_camera_fits_its_canvas_and_the_limit(canvas: tuple[int, int], scale: float) -> None:
    camera = replace(EYE, canvas=canvas).camera((1280, 800), scale)
    width, height = camera.size
    assert 1 <= width <= 1280
    assert 1 <= height <= 800
    assert scale == 1.0 or width * height <= 1.01 * MOVING_PIXELS


def test_a_page_sees_what_the_camera_saw() -> None:
    camera = Camera((1, 2, 3), (0, 0, 0), fov=40.0, size=(640, 480))
    assert math.isclose(Eye.of(camera).camera((640, 480)).fov, 40.0, rel_tol=1e-6)


def test_pictures_are_exposed_srgb_over_grey() -> None:
    rng = np.random.default_rng(1)
    image = np.concatenate([rng.uniform(0, 1.2, (20, 30, 3)), np.ones((20, 30, 1))], axis=2).astype(
        np.float32
    )
    want = np.rint(255 * srgb(np.clip(2 * image[..., :3], 0, 1)))
    assert np.abs(develop(image, 1.0).astype(int) - want).max() <= 1
    empty = develop(np.zeros((1, 1, 4), np.float32), 5.0)
    assert 0 < empty[0, 0, 0] < 80  # the exposure does not touch the backdrop
    image[0, 0] = np.nan
    assert (develop(image, 0.0)[0, 0] == 0).all()


def test_colours_and_exposure() -> None:
    assert picked_colour(linear_colour((1, 128, 255))) == (1, 128, 255)
    assert linear_colour((300, 0, 0)) == (1.0, 0.0, 0.0)
    assert metered_exposure(np.full((64, 128, 3), 0.25, np.float32)) == 2.0
    assert metered_exposure(np.zeros((8, 16, 3), np.float32)) == 0.0


# --- whose turn it is -----------------------------------------------------------------------------------------


class Studio:
    """Stands in for the sessions: what it was asked for, and a picture at once or after some steps."""

    def __init__(self) -> None:
        self.asked: list[tuple[State, Quality]] = []
        self.steps: dict[str, int] = {}
        self.fine, self.fails = True, False

    def can(self, quality: Quality) -> bool:
        return self.fine or not quality.fine

    def step(self, state: State, quality: Quality) -> Drawn | None:
        self.asked.append((state, quality))
        if self.fails:
            raise InputError("env: gone")
        if quality.fine and self.steps.get(state.environment, 0) > 0:
            self.steps[state.environment] -= 1
            return None
        render = Render(np.zeros((2, 3, 4), np.float32), {"seconds": {}, "points": {}})
        return Drawn(render, 0.0, 0.01, not quality.fine)

    def left(self, state: State) -> float:
        return 0.5

    def look_ahead(self, state: State) -> bool:
        return False


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


class Bench:
    """A loop over a stand-in studio, stepped by hand."""

    def __init__(self) -> None:
        self.studio, self.clock = Studio(), Clock()
        self.loop = Loop(self.studio, self.clock)  # type: ignore[arg-type]
        self.got: list[tuple[str, str, State]] = []
        self.told: list[tuple[str, str]] = []

    def join(self, name: str, state: State = STATE) -> Seat:
        return self.loop.join(
            state, lambda s, q, d: self.got.append((name, q.name, s)), lambda t: self.told.append((name, t))
        )

    def work(self, seconds: float = 0.0) -> None:
        """Let time pass, and do all that is due."""
        self.clock.now += seconds
        for _ in range(100):
            job, _ = self.loop._next()
            if job is None:
                return
            self.loop._serve(*job)
        pytest.fail("the loop never rests")


def test_a_picture_climbs_while_its_page_rests() -> None:
    bench = Bench()
    seat = bench.join("a")
    bench.work()
    assert [q for _, q, _ in bench.got] == ["moving"]
    bench.work(STILL.rest)
    bench.work(FINE.rest - STILL.rest)
    assert [q for _, q, _ in bench.got] == ["moving", "resting", "refined"]
    bench.work(60.0)
    assert len(bench.got) == 3, "a picture that is fine is not made again"
    bench.loop.update(seat, lambda s: replace(s, exposure=2.0))
    bench.work()
    assert len(bench.studio.asked) == 3, "exposure renders nothing"
    assert bench.got[-1][2].exposure == 2.0


def test_only_the_latest_state_is_rendered() -> None:
    bench = Bench()
    seat = bench.join("a")
    for n in range(20):
        bench.loop.update(seat, lambda s, n=n: replace(s, rotate=float(n)))  # type: ignore[misc]
    bench.work()
    assert [s.rotate for s, _ in bench.studio.asked] == [19.0]


def test_pages_do_not_disturb_one_another() -> None:
    bench = Bench()
    bench.studio.steps["slow"] = 6
    slow, quick = bench.join("slow", replace(STATE, environment="slow")), bench.join("quick")
    bench.work(0.0)
    bench.clock.now += 1.0
    # `slow` refines in many steps; what `quick` does meanwhile is served between them.
    for _ in range(3):
        job, _ = bench.loop._next()
        assert job is not None
        bench.loop._serve(*job)
    bench.loop.update(quick, lambda s: replace(s, rotate=5.0))
    job, _ = bench.loop._next()
    assert job is not None
    assert job[0] is quick
    assert job[2] is MOVING
    bench.work(2.0)
    assert {(n, q) for n, q, _ in bench.got} >= {("slow", "refined"), ("quick", "refined")}
    assert all(s.environment == "slow" for n, _, s in bench.got if n == "slow")
    bench.loop.leave(slow)
    count = len(bench.got)
    bench.loop.update(slow, lambda s: replace(s, rotate=1.0))
    bench.work(2.0)
    assert len(bench.got) == count


def test_a_page_that_moves_for_ever_does_not_starve_another() -> None:
    bench = Bench()
    mover, rester = bench.join("mover"), bench.join("rester")
    for n in range(100):
        bench.clock.now += 0.1
        bench.loop.update(mover, lambda s, n=n: replace(s, rotate=float(n)))  # type: ignore[misc]
        job, _ = bench.loop._next()
        assert job is not None
        bench.loop._serve(*job)
    assert ("rester", "refined") in {(n, q) for n, q, _ in bench.got}
    assert rester.rung == 3


def test_a_failure_is_told_to_its_page_alone_and_does_not_end_the_loop() -> None:
    bench = Bench()
    seat = bench.join("a")
    bench.studio.fails = True
    bench.work(1.0)
    assert bench.told == [("a", "env: gone")]
    bench.work(10.0)
    assert len(bench.studio.asked) == 1, "it is not tried again until something changes"
    bench.studio.fails = False
    bench.loop.update(seat, lambda s: replace(s, rotate=1.0))
    bench.work(1.0)
    assert bench.got[-1][1] == "refined"
    assert bench.told[-1] == ("a", "")


def test_until_visibility_is_there_pictures_are_previews() -> None:
    bench = Bench()
    bench.studio.fine = False
    bench.join("a")
    bench.work(5.0)
    assert [q for _, q, _ in bench.got] == ["moving"]
    bench.studio.fine = True
    bench.work()
    assert [q for _, q, _ in bench.got] == ["moving", "resting", "refined"]


def test_saving_waits_for_the_refined_picture_of_that_moment() -> None:
    bench = Bench()
    seat = bench.join("a")
    saved: list[State] = []
    bench.loop.save(seat, lambda state, drawn: saved.append(state))
    bench.loop.update(seat, lambda s: replace(s, rotate=90.0))
    bench.work(5.0)
    assert [s.rotate for s in saved] == [0.0]
    taken = [bench.loop.save(seat, lambda state, drawn: saved.append(state)) for _ in range(WAITING + 1)]
    assert taken == [True] * WAITING + [False]
    bench.work(5.0)
    assert len(saved) == 1 + WAITING


def test_the_loop_runs_on_a_thread_and_stops() -> None:
    studio, came = Studio(), threading.Event()
    loop = Loop(studio)  # type: ignore[arg-type]
    thread = threading.Thread(target=loop.run)
    thread.start()
    loop.join(STATE, lambda s, q, d: came.set() if q is FINE else None, lambda t: None)
    assert came.wait(20.0)
    loop.stop()
    thread.join(20.0)
    assert not thread.is_alive()


# --- saving ---------------------------------------------------------------------------------------------------


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    render = Render(np.ones((2, 3, 4), np.float32), {})
    (tmp_path / "view-001.png").write_text("mine")
    (tmp_path / "view-002.exr").symlink_to(tmp_path / "nowhere")
    names = [path.name for path in saving.save_image(tmp_path, render, 0.0)]
    assert names == ["view-003.exr", "view-003.png"]
    assert (tmp_path / "view-001.png").read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        ["view-001.png", "view-002.exr", "view-003.exr", "view-003.png"]
    )


def test_a_material_is_saved_as_the_command_line_takes_it(tmp_path: Path) -> None:
    state = replace(STATE, looks=(PRESETS["gold"], Look()), exposure=1.5)
    (path,) = saving.save_material(tmp_path, state, ("1 body", "2"))
    saved = json.loads(path.read_text())
    assert saved["exposure"] == 1.5
    assert [m["part"] for m in saved["materials"]] == ["1 body", "2"]
    assert Material.parse(saved["materials"][0]["brdf"]).spec == PRESETS["gold"].spec


def test_a_full_or_missing_folder_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(saving, "MOST", 1)
    saving.save_material(tmp_path, STATE, ("1",))
    with pytest.raises(InputError, match="move them away"):
        saving.save_material(tmp_path, STATE, ("1",))
    with pytest.raises(InputError, match="cannot be written"):
        saving.save_material(tmp_path / "gone", STATE, ("1",))


# --- who may connect, and what is offered ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("origin", "named", "host", "wanted"),
    [
        (None, "localhost:8080", "127.0.0.1", True),
        ("http://localhost:8080", "localhost:8080", "127.0.0.1", True),
        ("http://127.0.0.1:8080", "127.0.0.1:8080", "127.0.0.1", True),
        ("http://[::1]:8080", "[::1]:8080", "::1", True),
        ("http://evil.example", "localhost:8080", "127.0.0.1", False),
        ("http://localhost:9999", "localhost:8080", "127.0.0.1", False),
        ("http://evil.example:8080", "evil.example:8080", "127.0.0.1", False),  # a name that points here
        ("http://studio.lan:8080", "studio.lan:8080", "0.0.0.0", True),
        ("null", "localhost:8080", "127.0.0.1", False),
    ],
)
def test_other_sites_pages_are_refused(origin: str | None, named: str, host: str, wanted: bool) -> None:
    assert web.allowed(origin, named, host) is wanted


def test_a_port_in_use_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"--port {port}: is in use at 127.0.0.1; choose another"):
            web.require_free("127.0.0.1", port)
    with pytest.raises(InputError, match="cannot listen there"):
        web.require_free("no.such.host.invalid", 8080)


def test_the_list_of_environments(tmp_path: Path) -> None:
    (tmp_path / "more").mkdir()
    for name in ("a.exr", "b.HDR", "notes.txt", "more/a.exr"):
        (tmp_path / name).write_text("")
    got = listed([str(tmp_path), str(tmp_path / "more" / "a.exr"), str(tmp_path / "a.exr")])
    assert {name: path.relative_to(tmp_path).as_posix() for name, path in got.items()} == {
        "a": "a.exr", "b": "b.HDR", "a (2)": "more/a.exr",
    }  # fmt: skip
    with pytest.raises(InputError, match="no such file or folder"):
        listed([str(tmp_path / "gone.exr")])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"no \.exr or \.hdr in this folder"):
        listed([str(tmp_path / "empty")])


def test_folder_and_parts(tmp_path: Path) -> None:
    assert writable_folder(str(tmp_path / "new" / "one")).is_dir()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected a folder to save into"):
        writable_folder(str(tmp_path / "file"))
    mesh: Any = SimpleNamespace(materials=[SimpleNamespace(name="body"), SimpleNamespace(name="body"), None])
    assert part_names(mesh) == ("1 body", "2 body", "3")


# --- the command ----------------------------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A folder with a mesh, its bake and an environment."""
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    write_exr(tmp_path / "sky.exr", np.ones((8, 16, 4), np.float32))
    Bake.trace(read_mesh(tmp_path / "m.obj").smooth(), 2).save(tmp_path / "m.npz")
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gone.obj"], "gone.obj"),
        (["m.obj", "--brdf", "velvet"], "velvet"),
        (["m.obj", "--env", "gone.exr"], "no such file or folder"),
        (["m.npz", "--rays", "4"], "was traced with 2"),
        (["m.npz", "--smooth"], "bake again with --smooth"),
        (["m.obj", "--host", "no.such.host.invalid"], "cannot listen there"),
        (["m.obj", "-o", "sky.exr"], "expected a folder to save into"),
        (["m.obj", "--error", "2"], "--error: expected 0 or more and below 1"),
        (["m.obj", "--levels", "12"], "--levels: expected 1 to"),
        (["m.obj", "--levels", "0"], "--levels: expected 1 to"),
        (["m.obj", "--levels", "4", "--rays", "5"], "--rays: expected 1 to 4"),
        (["m.obj", "--env-rotate", "nan"], "--env-rotate: expected degrees"),
    ],
)
def test_mistakes_are_told_in_two_lines(
    arguments: list[str],
    message: str,
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Any,
    device: Device,
) -> None:
    monkeypatch.chdir(files)
    extra = [] if "--env" in arguments else ["--env", "sky.exr"]
    assert main(["view", *arguments, *extra, "--port", "0"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("prtcl view: ")
    assert message in said
    assert len(said.rstrip().splitlines()) <= 2


def test_viser_missing_is_told_with_what_brings_it(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, device: Device
) -> None:
    monkeypatch.chdir(files)
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", "m.obj", "--env", "sky.exr"]) == 2
    assert "pip install 'prtcl[viewer]'" in capsys.readouterr().err

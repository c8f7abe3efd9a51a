"""`prtcl.relight`: the images of `Scene.render`, in a known order, the same whatever else is made beside them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from tolerances import UNIT, assert_close

import prtcl
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.stored import SliceStore
from prtcl.files.image import write_exr
from prtcl.scene import frames, frames_engine
from prtcl.scene.bake import Bake
from prtcl.scene.camera import Camera
from prtcl.scene.camera_path import View
from prtcl.scene.frames import Job, jobs, relight
from prtcl.scene.frames_ahead import ahead
from prtcl.scene.mesh import Mesh
from prtcl.scene.scene import Scene, read_environment
from prtcl.transport import collapse

CAMERA = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(24, 18))
SHARP = "ggx:alpha=0.1,f0=0.04,kd=0.5/0.2/0.1"
COARSE = {"levels": 4, "rays": 3, "keep": 4, "views": 16}
ROUNDINGS = 8
"""Of float32, between an image and its twin: soft and hard light are added point by point here and pixel by pixel
there, and the mesh's colour multiplies their sum here and each of them there."""


def rendered(mesh: Any, light: Environment, material: Any, camera: Camera, **more: Any) -> np.ndarray:
    points, samples = more.pop("points", "pixel"), more.pop("samples", 3)
    # Points of one normal each on its own, as a batch has them.
    more.setdefault("leave_out", "no-normals")
    return Scene(mesh, light, material, camera, **more).render(points=points, samples=samples).image


def painted() -> Mesh:
    """A ball whose upper half is red, on a white ground in a part of its own."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.apply_translation([0.0, 1.0, 0.0])
    ground = trimesh.creation.box(extents=[4.0, 0.2, 4.0])
    vertices = np.concatenate([ball.vertices, ground.vertices])
    colours = np.ones((len(vertices), 3))
    colours[: len(ball.vertices)][ball.vertices[:, 1] > 1.0] = [0.8, 0.1, 0.05]
    faces = np.concatenate([ball.faces, ground.faces + len(ball.vertices)])
    mesh = Mesh.from_arrays(vertices, faces, name="painted", colours=colours)
    parts = np.repeat(np.array([0, 1], dtype=np.int32), [len(ball.faces), len(ground.faces)])
    return replace(mesh, parts=parts, materials=(None, None))


# --- the images ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("points", ["pixel", "vertex"])
def test_images_are_those_of_single_renders(
    device: Device, mesh: Mesh, sky: Environment, points: str
) -> None:
    """Two materials of different resolution, and the mesh's own five; a sun, so that hard light takes part."""
    materials = ["lambert:albedo=0.5", SHARP, None]
    made = list(
        relight(mesh, [sky], materials, [CAMERA], rotations=[0, 70], points=points, samples=2, device=device)
    )
    assert len(made) == 6
    for frame in made:
        light = replace(sky, rotate=frame.rotation)
        wanted = rendered(
            mesh, light, materials[frame.job.material], CAMERA, points=points, samples=2, device=device
        )
        assert frame.image.shape == (18, 24, 4) and frame.image.dtype == np.float32
        assert_close(frame.image, wanted, ROUNDINGS * UNIT["float32"] * np.abs(wanted), zeros=0.9)
    assert np.abs(made[0].image - made[3].image).max() > 0.1, "the light was not turned"


@pytest.mark.parametrize("points", ["pixel", "vertex"])
def test_the_meshs_colour_multiplies_what_it_should(device: Device, sky: Environment, points: str) -> None:
    mesh = painted()
    materials = ["lambert:albedo=mesh", "ggx:alpha=0.4,f0=0.3,kd=0.5*mesh", ["lambert:albedo=mesh", SHARP]]
    camera = Camera((2.0, 3.0, 5.0), (0.0, 0.8, 0.0), size=(20, 20))
    more: dict[str, Any] = {"points": points, "samples": 2, "device": device, **COARSE}
    for frame in relight(mesh, [sky], materials, [camera], **more):
        wanted = rendered(mesh, sky, materials[frame.job.material], camera, **more)
        assert_close(frame.image, wanted, ROUNDINGS * UNIT["float32"] * np.abs(wanted), zeros=0.9)


def test_a_bake_is_lit_from_its_bits(device: Device, mesh: Mesh, sky: Environment) -> None:
    bake = Bake.trace(mesh, 4)
    materials = ["lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.04"]
    for frame in relight(bake, [sky], materials, [CAMERA], samples=2, device=device, views=12):
        wanted = rendered(
            bake, sky, materials[frame.job.material], CAMERA, samples=2, device=device, views=12
        )
        assert_close(frame.image, wanted, ROUNDINGS * UNIT["float32"] * np.abs(wanted), zeros=0.9)


def test_a_white_ball_in_white_light(device: Device) -> None:
    """Lambert of albedo ½ sends on half of the light where nothing shadows it: exact but for f_v's own quadrature."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    mesh = Mesh.from_arrays(ball.vertices, ball.faces, name="ball").smooth()
    camera = Camera((0.0, 0.0, 6.0), (0.0, 0.0, 0.0), fov=25.0, size=(32, 32))
    (frame,) = relight(mesh, [Environment.constant(2.0)], ["lambert:albedo=0.5"], [camera], device=device)
    inside = frame.image[..., 3] == 1.0
    assert inside.mean() > 0.3
    # Where the ball's facets hide the horizon of a smoothed normal, some light is missing.
    assert abs(np.median(frame.image[inside][:, :3]) - 1.0) < 0.01


def test_light_stage_images_add_up(device: Device, mesh: Mesh) -> None:
    """Linearity: the sum of the images under each light is the image under all lights."""
    stage = []
    for column in range(4):
        image = np.zeros((8, 16, 3), dtype=np.float32)
        image[2, 4 * column : 4 * column + 2] = [3.0, 2.0, 1.0 + column]
        stage.append(image)
    lights = [Environment(image) for image in (*stage, np.sum(stage, axis=0))]
    more: dict[str, Any] = {"samples": 1, "device": device, "hard": "off", **COARSE}
    *single, together = (f.image for f in relight(mesh, lights, [SHARP], [CAMERA], **more))
    # Coefficients of a product of both signs cancel: errors are of the size of the whole image, not of each pixel.
    largest = float(together[..., :3].max())
    bound = 64 * UNIT["float32"] * largest
    assert_close(np.sum(single, axis=0)[..., :3], together[..., :3], bound, zeros=0.9)


# --- order, choice, reading -----------------------------------------------------------------------------------


def test_order_and_what_is_told(device: Device, mesh: Mesh, sky: Environment) -> None:
    views = [View("left", CAMERA), replace(CAMERA, eye=(-3.0, 2.0, 5.0))]
    grey = np.full((4, 8, 3), 0.5, dtype=np.float32)
    more: dict[str, Any] = {"samples": 1, "device": device, **COARSE}
    made = list(relight(mesh, [sky, grey], [SHARP, None], views, rotations=[0.0, 30.0], **more))
    assert [frame.job for frame in made] == list(jobs(2, 2, 2, 2))
    assert [frame.job.index for frame in made] == list(range(16))
    assert [(f.view.name, f.light, f.rotation, f.material) for f in made[:5]] == [
        ("left", "environment", 0.0, SHARP), ("left", "environment", 0.0, "own"),
        ("left", "environment", 30.0, SHARP), ("left", "environment", 30.0, "own"), ("left", "array", 0.0, SHARP),
    ]  # fmt: skip
    assert made[8].view.name == "view002" and made[-1].job == Job(15, 1, 1, 1, 1)


def test_an_image_is_the_same_whatever_is_made_beside_it(
    device: Device, mesh: Mesh, sky: Environment
) -> None:
    """What resuming rests on: bit for bit."""
    materials = ["lambert:albedo=0.5", SHARP, None]
    arguments: tuple[Any, ...] = (mesh, [sky], materials, [CAMERA])
    more: dict[str, Any] = {"rotations": [0, 40], "samples": 2, "device": device}
    whole = [frame.image for frame in relight(*arguments, **more)]
    with pytest.MonkeyPatch.context() as patch:  # materials one by one, where memory does not hold them all
        patch.setattr(frames_engine, "RADIANCE", 1)
        assert all((f.image == whole[f.job.index]).all() for f in relight(*arguments, **more))
    for some in ({1}, {0, 5}, {2, 3, 4}):
        made = list(relight(*arguments, **more, wanted=lambda job, some=some: job.index in some))
        assert {frame.job.index for frame in made} == some
        for frame in made:
            assert (frame.image == whole[frame.job.index]).all()


def test_light_is_collapsed_once_for_all_materials(
    device: Device, mesh: Mesh, sky: Environment, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, real = [], collapse.reduced_coefficients

    def counted(*arguments: Any, **options: Any) -> Any:
        calls.append(len(arguments[3]))
        return real(*arguments, **options)

    monkeypatch.setattr(collapse, "reduced_coefficients", counted)
    more: dict[str, Any] = {"samples": 1, "device": device, **COARSE}
    for materials in ([SHARP], [SHARP, "lambert:albedo=0.5", "blinn:exponent=20,ks=0.4"]):
        calls.clear()
        made = list(relight(mesh, [sky], materials, [CAMERA], **more))
        assert len(made) == len(materials)
        assert sum(calls) == int(made[0].image[..., 3].sum()), "a point was collapsed for each material"


@pytest.mark.parametrize("beside", [True, False])
def test_points_in_chunks(
    device: Device, mesh: Mesh, sky: Environment, monkeypatch: pytest.MonkeyPatch, beside: bool
) -> None:
    """Of a hundred, on a device that works beside the host and is waited for late, and on one that does not."""
    arguments: tuple[Any, ...] = (mesh, [sky], [SHARP, None], [CAMERA])
    more: dict[str, Any] = {"samples": 2, "device": device, **COARSE}
    whole = [frame.image for frame in relight(*arguments, **more)]
    monkeypatch.setattr(frames_engine, "HARD_CHUNK", 100)
    monkeypatch.setattr(type(device), "beside_host", property(lambda _: beside))
    assert all((f.image == whole[f.job.index]).all() for f in relight(*arguments, **more))


def test_slices_that_do_not_fit_together(
    device: Device, mesh: Mesh, sky: Environment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Points then go in parts, each collapsed anew: the images are the same, bit for bit."""
    arguments: tuple[Any, ...] = (mesh, [sky], [SHARP, None], [CAMERA])
    more: dict[str, Any] = {"samples": 1, "device": device, **COARSE}
    whole = [frame.image for frame in relight(*arguments, **more)]
    parts: list[int] = []
    take = SliceStore.take

    def counted(self: SliceStore, keys: Any) -> Any:
        parts.append(len(keys))
        return take(self, keys)

    monkeypatch.setattr(SliceStore, "take", counted)
    list(relight(*arguments, **more))
    at_once = len(parts)
    # Five slices of three channels at most, of the 16 that there are of each of six materials.
    room = 5 * 3 * 4**4 * np.dtype(device.dtype).itemsize
    monkeypatch.setattr(frames_engine, "cache_bytes", lambda device, share=1: room)
    assert all((f.image == whole[f.job.index]).all() for f in relight(*arguments, **more))
    assert len(parts) - at_once > 2 * at_once, "all of them fitted"


def test_lights_are_kept_from_view_to_view_as_memory_allows(
    sky: Environment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in "abc":
        write_exr(tmp_path / f"{name}.exr", np.ones((4, 8, 4), dtype=np.float32))
    paths = [tmp_path / f"{name}.exr" for name in "abc"]
    reads: list[Any] = []

    def read(source: Any, **named: Any) -> Any:
        reads.append(source)
        return read_environment(source, **named)

    monkeypatch.setattr(frames, "read_environment", read)
    kept = frames.Sources(paths, "y", False, None)
    for number in (0, 1, 2, 0, 1, 2):
        kept.read(number)
    assert reads == paths
    monkeypatch.setattr(frames, "KEPT", 2 * 4 * 8 * 3 * 4)  # of two
    reads.clear()
    fewer = frames.Sources(paths, "y", False, None)
    for number in (0, 1, 0, 2, 0, 1):  # 1 makes room for 2, as it was asked for less lately
        fewer.read(number)
    assert reads == [paths[0], paths[1], paths[2], paths[1]]


def test_files_are_read_with_notes_and_images_are_shared_without_copies(
    device: Device, mesh: Mesh, tmp_path: Path
) -> None:
    image = np.ones((4, 8, 4), dtype=np.float32)
    image[1, 2, 0] = np.nan
    write_exr(tmp_path / "a.exr", image)
    notes: list[str] = []
    (frame,) = relight(
        str(saved_mesh(tmp_path, mesh)), [tmp_path / "a.exr"], [SHARP], [CAMERA], samples=1, device=device,
        repair=True, note=notes.append, **COARSE,
    )  # fmt: skip
    assert notes == [f"{tmp_path}/a.exr: replaced 1 NaN and 0 negative values by 0"]
    shared = np.from_dlpack(frame.image)
    assert np.shares_memory(shared, frame.image) and shared.shape == (18, 24, 4)
    assert frame.image.flags.writeable and frame.image.flags.c_contiguous


def saved_mesh(folder: Path, mesh: Mesh) -> Path:
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(folder / "mesh.ply")
    return folder / "mesh.ply"


def threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("prtcl")]


def test_a_consumer_may_stop_at_any_time(device: Device, mesh: Mesh, sky: Environment) -> None:
    made = prtcl.relight(
        mesh, [sky], [SHARP], [CAMERA], rotations=range(50), samples=1, device=device, **COARSE
    )
    next(made)
    made.close()
    assert threads() == []


def test_a_light_that_cannot_be_read_is_told_in_its_turn(
    device: Device, mesh: Mesh, sky: Environment, tmp_path: Path
) -> None:
    (tmp_path / "bad.exr").write_bytes(b"not an image")
    made = relight(mesh, [sky, tmp_path / "bad.exr"], [SHARP], [CAMERA], samples=1, device=device, **COARSE)
    assert next(made).job.index == 0
    with pytest.raises(InputError, match=r"bad\.exr"):
        next(made)
    assert threads() == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"lights": []}, {"lights": "sky.exr"}, {"materials": []}, {"materials": "lambert:albedo=0.5"},
        {"materials": ["lambert:albedo=2"]}, {"materials": [["lambert:albedo=0.5"]]}, {"cameras": []},
        {"rotations": []}, {"rotations": [float("nan")]}, {"points": "face"}, {"samples": 0}, {"samples": 65},
        {"samples": 2.0}, {"levels": 99},
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused_at_the_call(
    device: Device, mesh: Mesh, sky: Environment, wrong: dict[str, Any]
) -> None:
    with pytest.raises(InputError):
        relight(**{"mesh": mesh, "lights": [sky], "materials": [SHARP], "device": device} | wrong)


def test_an_engine_of_ones_own(device: Device, mesh: Mesh, sky: Environment) -> None:
    """The interface is all that the images come through; an engine may read several lights before it answers."""

    class Numbers:
        def __init__(self) -> None:
            self.device, self.prepared, self.seen = device, 0, 0

        def ahead(self, environment: Environment) -> None:
            self.seen += 1

        def prepare(self, camera: Camera) -> None:
            self.prepared += 1

        def images(self, lights: Any) -> Iterator[np.ndarray]:
            for environment, wanted in list(lights):
                for material in wanted:
                    yield np.full((1, 1, 4), 100 * environment.rotate + material, dtype=np.float32)

    engine = Numbers()
    made = relight(
        mesh, [sky], [SHARP, None], [CAMERA, replace(CAMERA, fov=20.0)], rotations=[0, 1, 2], engine=engine
    )
    assert [int(frame.image[0, 0, 0]) for frame in made] == [0, 1, 100, 101, 200, 201] * 2
    assert (engine.prepared, engine.seen) == (2, 6)


# --- reading ahead --------------------------------------------------------------------------------------------


def test_reading_ahead_keeps_the_order_and_its_depth() -> None:
    made: list[int] = []
    room = threading.Semaphore(0)

    def items() -> Iterator[int]:
        for number in range(100):
            made.append(number)
            room.release()
            yield number

    taken = ahead(items(), 2)
    assert next(taken) == 0
    for _ in range(4):  # the one taken, two in the queue, and one that waits for room
        assert room.acquire(timeout=30)
    assert not room.acquire(timeout=0.3) and made == [0, 1, 2, 3]
    assert list(taken) == list(range(1, 100)) and threads() == []


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"rotations": "90"}, "rotations: expected a list of one or more, got '90'"), ({"rotations": 90.0}, "got 90.0"),
        ({"rotations": ["a"]}, "rotations: expected degrees"), ({"rotations": [[0, 90]]}, "expected degrees"),
        ({"rotations": [np.nan]}, "expected degrees"), ({"materials": None}, "materials: expected a list"),
        ({"cameras": CAMERA}, "cameras: expected a list"), ({"lights": "sky.exr"}, "lights: .* got 'sky.exr'"),
        ({"lights": iter(())}, "lights: expected a list"), ({"level": 5}, "level: no such argument or setting"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_told(mesh: Mesh, sky: Environment, wrong: dict[str, Any], said: str) -> None:
    given = {"lights": [sky], "materials": [None], "cameras": [CAMERA], **wrong}
    with pytest.raises(InputError, match=said):
        relight(mesh, given.pop("lights"), given.pop("materials"), given.pop("cameras"), **given)

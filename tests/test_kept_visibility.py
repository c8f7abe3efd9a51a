"""Visibility that is kept from job to job: the same images, bit for bit, whatever lies in the folder."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from cases import Run

from prtcl.compute import choice
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import pixel_visibility
from prtcl.factors.environment import Environment
from prtcl.factors.visibility import Tracer
from prtcl.files.array_store import SUMS
from prtcl.files.image import read_image, write_exr
from prtcl.scene import kept_visibility
from prtcl.scene.bake import Bake
from prtcl.scene.camera import Camera
from prtcl.scene.factorization import FACTORIZATIONS
from prtcl.scene.frames import relight
from prtcl.scene.kept_visibility import KeptVisibility, key_of, open_store
from prtcl.scene.mesh import Mesh

CAMERA = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(20, 15))
MATT, SHINY = "lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.04"


class Jobs:
    """Jobs on the demo's scene that share a folder; `told` is what the last one noted."""

    def __init__(self, device: Device, mesh: Mesh, sky: Environment, folder: Path) -> None:
        self.device, self.mesh, self.sky, self.folder, self.told = device, mesh, sky, folder, ""

    def run(self, factorization: str, keep: bool = True, **changes: Any) -> list[np.ndarray]:
        """The images of one job, of which something may be changed."""
        given = {
            "mesh": self.mesh,
            "light": self.sky,
            "materials": [MATT],
            "camera": CAMERA,
            "rays": 3,
            **changes,
        }
        notes: list[str] = []
        frames = relight(
            given["mesh"], [given["light"]], given["materials"], [given["camera"]], samples=2, device=self.device,
            factorization=factorization, kept=self.folder if keep else None, note=notes.append,
            **({"levels": 4, "rays": given["rays"], "views": 16} if factorization == "light" else {}),
        )  # fmt: skip
        images = [frame.image for frame in frames]
        self.told = "\n".join(notes)
        return images

    @property
    def stores(self) -> list[Path]:
        return sorted(self.folder.glob("*.zarr"))


@pytest.fixture
def jobs(device: Device, mesh: Mesh, sky: Environment, tmp_path: Path) -> Jobs:
    return Jobs(device, mesh, sky, tmp_path / "kept")


@contextmanager
def no_rays() -> Any:
    """Whoever traces visibility fails."""

    def refuse(*_: Any, **__: Any) -> Any:
        raise AssertionError("visibility was traced")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pixel_visibility, "soft_visibility", refuse)
        patch.setattr(Tracer, "visibility", refuse)
        yield


def same(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    return len(one) == len(other) > 0 and all(
        (a == b).all() and a.any() for a, b in zip(one, other, strict=True)
    )


def flip(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at % len(data)] ^= 0x20
    path.write_bytes(bytes(data))


# --- what is kept ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factorization", FACTORIZATIONS)
def test_a_second_job_with_other_lights_and_materials_traces_no_visibility(
    jobs: Jobs, sky: Environment, factorization: str
) -> None:
    wanted = jobs.run(factorization, keep=False)
    assert same(jobs.run(factorization), wanted) and "keeps the view's visibility" in jobs.told
    (store,) = jobs.stores
    with pytest.raises(AssertionError, match="visibility was traced"), no_rays():
        jobs.run(factorization, keep=False)
    other: dict[str, Any] = {"light": replace(sky, rotate=70.0), "materials": [MATT, SHINY]}
    with no_rays():
        assert same(jobs.run(factorization), wanted) and "was read" in jobs.told
        again = jobs.run(factorization, **other)
    assert same(again, jobs.run(factorization, keep=False, **other))
    assert jobs.stores == [store]


@pytest.mark.parametrize("factorization", FACTORIZATIONS)
def test_another_view_mesh_or_grid_is_kept_beside_it(jobs: Jobs, mesh: Mesh, factorization: str) -> None:
    jobs.run(factorization)
    moved = replace(mesh, vertices=mesh.vertices * [1.0, 1.001, 1.0])
    sharp = {"materials": ["ggx:alpha=0.1,f0=0.04"]} if factorization == "view" else {"rays": 4}
    for number, change in enumerate(({"camera": replace(CAMERA, fov=39.0)}, {"mesh": moved}, sharp), start=2):
        assert same(jobs.run(factorization, **change), jobs.run(factorization, keep=False, **change))
        assert len(jobs.stores) == number


def test_a_store_says_what_it_is_made_of(jobs: Jobs, mesh: Mesh) -> None:
    jobs.run("view")
    (path,) = jobs.stores
    store = open_store(path)
    made_of = store.attributes["made_of"]
    assert path.stem == key_of(made_of) and made_of["mesh"] == mesh.name
    assert made_of["rays"] == {"of": "pixels", "levels": 6, "blocks": pixel_visibility.BLOCKS}
    assert made_of["camera"]["size"] == [20, 15] and made_of["camera"]["fov"] == 38.0
    bits = store.read("bits")
    assert bits.shape[1] == 2 * 4**6 // 32 and 0.1 < np.unpackbits(bits.view(np.uint8)).mean() < 0.6
    assert f"{store.disk_bytes} bytes, {store.disk_bytes / len(bits):.0f} a pixel" in jobs.told


# --- what does not fit --------------------------------------------------------------------------------------------


def chunk_of(store: Path) -> Path:
    return store / "bits" / "c" / "0" / "0"


DAMAGE: dict[str, Callable[[Path], Any]] = {
    "a bit of a chunk": lambda store: flip(chunk_of(store), 99),
    "a chunk cut short": lambda store: chunk_of(store).write_bytes(chunk_of(store).read_bytes()[:-5]),
    "a chunk gone": lambda store: chunk_of(store).unlink(),
    "metadata": lambda store: flip(store / "zarr.json", 60),
    "the list of hashes": lambda store: flip(store / SUMS, 10),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("factorization", FACTORIZATIONS)
def test_a_damaged_store_is_made_again(jobs: Jobs, factorization: str, damage: str) -> None:
    wanted = jobs.run(factorization)
    (store,) = jobs.stores
    before = {p: p.read_bytes() for p in store.rglob("*") if p.is_file()}
    DAMAGE[damage](store)
    assert same(jobs.run(factorization), wanted)
    assert "is damaged" in jobs.told and "traced anew" in jobs.told and "keeps the view's" in jobs.told
    assert {p: p.read_bytes() for p in store.rglob("*") if p.is_file()} == before
    with no_rays():
        assert same(jobs.run(factorization), wanted)


def test_every_sampled_byte_of_a_store_is_checked(jobs: Jobs) -> None:
    """Flipped bits are found before they are used, wherever they are."""
    jobs.run("light")
    (store,) = jobs.stores
    made_of = open_store(store).attributes["made_of"]
    shape = open_store(store).arrays["bits"].shape
    files = sorted(p for p in store.rglob("*") if p.is_file())
    rng = np.random.default_rng(11)
    for path in files:
        whole = path.read_bytes()
        for at in rng.integers(0, len(whole), 12):
            flip(path, int(at))
            with pytest.raises(InputError):
                kept_visibility._read(store, made_of, shape)
            path.write_bytes(whole)
    assert kept_visibility._read(store, made_of, shape).shape == shape


def test_another_views_store_is_not_used(jobs: Jobs) -> None:
    """Whole, but in another's place: a folder was renamed."""
    wanted = jobs.run("view")
    (store,) = jobs.stores
    jobs.run("view", camera=replace(CAMERA, fov=39.0))
    other = next(path for path in jobs.stores if path != store)
    shutil.rmtree(store)
    shutil.copytree(other, store)
    assert same(jobs.run("view"), wanted)
    assert "camera, points_sha256 differ" in jobs.told and "traced anew" in jobs.told
    with no_rays():
        jobs.run("view")


def test_a_folder_of_somebody_else_is_left_alone(jobs: Jobs) -> None:
    wanted = jobs.run("view")
    (store,) = jobs.stores
    shutil.rmtree(store)
    store.mkdir()
    (store / "mine.txt").write_text("mine")
    assert same(jobs.run("view"), wanted)
    assert "did not write" in jobs.told and "is not kept" in jobs.told
    assert [p.name for p in store.iterdir()] == ["mine.txt"]


def test_a_full_disk_costs_the_store_and_no_image(jobs: Jobs, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = jobs.run("view", keep=False)

    def full(*_: Any, **__: Any) -> Any:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("prtcl.files.array_store.file_sha256", full)
        assert same(jobs.run("view"), wanted)
    assert "No space left" in jobs.told and "is not kept" in jobs.told
    assert not list(jobs.folder.iterdir())


def test_interrupted_while_it_is_kept_the_next_job_keeps_it(
    jobs: Jobs, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("prtcl.files.array_store.file_sha256", interrupt)
        with pytest.raises(KeyboardInterrupt):
            jobs.run("view")
    assert not jobs.stores
    wanted = jobs.run("view")
    with no_rays():
        assert same(jobs.run("view"), wanted)


def test_what_cannot_be_a_folder_and_bakes_are_refused(mesh: Mesh, sky: Environment, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected a folder"):
        KeptVisibility(tmp_path / "file", mesh)
    with pytest.raises(InputError, match="holds its visibility"):
        relight(Bake.trace(mesh, 3), [sky], kept=tmp_path / "kept")


# --- the command line ---------------------------------------------------------------------------------------------


@pytest.fixture
def words(tmp_path: Path, opencl_device: choice.Seen) -> list[str]:
    """A ball under one sky, turned twelve times; all but the output."""
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    image = np.ones((8, 16, 4), dtype=np.float32)
    image[2, 3, :3] = 40.0
    write_exr(tmp_path / "sky.exr", image)
    return ["relight", f"{tmp_path}/ball.ply", "--env", f"{tmp_path}/sky.exr", "--brdf", MATT, "--size", "12x8",
            "--samples", "2", "--quiet", "--device", opencl_device.spec, "--env-rotate", "0:360:30",
            "--keep-visibility", f"{tmp_path}/kept"]  # fmt: skip


def test_jobs_of_the_command_line_share_and_resume(run: Run, words: list[str], tmp_path: Path) -> None:
    first = run(*words, "--factorization", "view", "-o", tmp_path / "one")
    assert first.status == 0 and "keeps the view's visibility" in first.err, first.err
    images = sorted((tmp_path / "one").glob("*.exr"))
    before = {path.name: path.read_bytes() for path in images}
    assert len(before) == 12
    for path in images[3:9]:  # as an interruption would leave it
        path.unlink()
    assert run(*words, "--factorization", "view", "-o", tmp_path / "one").status == 0
    assert {path.name: path.read_bytes() for path in (tmp_path / "one").glob("*.exr")} == before
    plain = run(*words[:-2], "--factorization", "view", "-o", tmp_path / "plain")
    assert plain.status == 0 and "visibility" not in plain.err
    assert {path.name: path.read_bytes() for path in (tmp_path / "plain").glob("*.exr")} == before
    # Tried, whichever is taken: the trial's few pixels are nobody's to keep.
    assert run(*words, "-o", tmp_path / "auto").status == 0
    assert len(list((tmp_path / "kept").glob("*.zarr"))) <= 2
    assert read_image(images[0]).any()


def test_info_describes_a_folder_and_finds_damage(run: Run, words: list[str], tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    assert run(*words, "--factorization", "view", "-o", tmp_path / "one").status == 0
    (store,) = kept.glob("*.zarr")
    told = run("info", kept, "--verify")
    assert told.status == 0 and "12 x 8 from" in told.out and "a pixel" in told.out and "whole" in told.out
    assert run("info", store).out.startswith(str(store))
    (found,) = json.loads(run("info", kept, "--json").out)
    assert found["rays"]["of"] == "pixels" and found["bytes"]["raw"] == found["rows"] * 4 * 2 * 4**6 // 32
    assert found["verified"] is False
    flip(chunk_of(store), 50)
    assert run("info", kept).status == 0
    broken = run("info", kept, "--verify")
    assert broken.status == 2 and "damaged" in broken.err
    (tmp_path / "empty").mkdir()
    empty = run("info", tmp_path / "empty")
    assert empty.status == 2 and "holds none" in empty.err


def test_what_the_command_line_refuses(run: Run, words: list[str], mesh: Mesh, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    ran = run(*words[:-1], tmp_path / "file", "-o", tmp_path / "out")
    assert ran.status == 2 and "expected a folder" in ran.err
    Bake.trace(mesh, 3).save(tmp_path / "bake.npz")
    ran = run(*["relight", tmp_path / "bake.npz", *words[2:]], "-o", tmp_path / "out")
    assert ran.status == 2 and "holds its visibility already" in ran.err


def test_what_a_killed_job_left_is_removed_the_next_day(jobs: Jobs) -> None:
    jobs.run("light")
    left, fresh, mine = (
        jobs.folder / name for name in (f".{'0' * 32}.zarr", f".{'1' * 32}.zarr", ".mine.zarr")
    )
    for path in (left, fresh, mine):
        path.mkdir()
    for path in (left, mine):
        os.utime(path, (1e9, 1e9))
    jobs.run("light")
    assert not left.exists() and fresh.exists() and mine.exists()

"""Bakes in a Zarr store: what is read is what was written, or is refused with the reason."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prtcl.apps import cli, info
from prtcl.errors import InputError, PrtclError
from prtcl.files import array_store, folder
from prtcl.files.array_store import SUMS, ArrayStore, write_store
from prtcl.scene import bake_store
from prtcl.scene.bake import Bake, is_bake
from prtcl.scene.bake_layout import mesh_hash
from prtcl.scene.bake_store import StoredBake
from prtcl.scene.mesh import Mesh, PartMaterial
from prtcl.scene.texture import Texture

pytest.importorskip("zarr", reason="bakes in a Zarr store take zarr")

VERTICES, RAYS, ROWS = 29, 3, 8


def made(seed: int = 1) -> Bake:
    """A bake of random bits, over a mesh that has everything a mesh can have."""
    rng = np.random.default_rng(seed)
    texture = Texture(rng.integers(0, 256, (5, 7, 3), dtype=np.uint8), ("mirror", "clamp"))
    mesh = Mesh.from_arrays(
        rng.normal(size=(VERTICES, 3)), rng.permuted(np.tile(np.arange(VERTICES), (20, 1)), axis=1)[:, :3],
        rng.normal(size=(VERTICES, 3)), "thing", rng.uniform(size=(VERTICES, 3)), rng.uniform(size=(VERTICES, 2)),
    )  # fmt: skip
    parts = (PartMaterial("", (0.5, 0.25, 0.125), 1.0, 0.5, texture), None)
    mesh = replace(mesh, parts=(np.arange(20) % 2).astype(np.int32), materials=parts)
    return Bake(mesh, rng.integers(0, 2**32, (VERTICES, 2), dtype=np.uint32), RAYS)


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of 8 vertices' bits, so that a small bake has several and a short last one."""
    monkeypatch.setattr(array_store, "CHUNK_BYTES", ROWS * 8)


@pytest.fixture
def stored(tmp_path: Path, small_chunks: None) -> Path:
    made().save(tmp_path / "a.zarr")
    return tmp_path / "a.zarr"


def assert_same(got: Bake, wanted: Bake) -> None:
    assert got.rays == wanted.rays and (got.bits == wanted.bits).all() and got.bits.dtype == np.uint32
    for name in ("vertices", "faces", "normals", "parts", "colours", "uv"):
        ours, theirs = getattr(got.mesh, name), getattr(wanted.mesh, name)
        assert ours.dtype == theirs.dtype and (ours == theirs).all(), name
    first, second = got.mesh.materials
    there = wanted.mesh.materials[0]
    assert first is not None and there is not None and second is None
    assert (first.base_color, first.metallic, first.roughness) == (
        there.base_color,
        there.metallic,
        there.roughness,
    )
    assert first.texture is not None and there.texture is not None
    assert (first.texture.image == there.texture.image).all() and first.texture.wrap == there.texture.wrap


def rewrite_sums(path: Path) -> None:
    """Make the list of hashes fit the files, as another program could have written them."""
    names = [line.split("  ")[1] for line in (path / SUMS).read_text().splitlines()[:-1]]
    lines = "".join(f"{hashlib.sha256((path / name).read_bytes()).hexdigest()}  {name}\n" for name in names)
    (path / SUMS).write_text(f"{lines}# {hashlib.sha256(lines.encode()).hexdigest()}\n")


def change_attributes(path: Path, **change: Any) -> None:
    group = json.loads((path / "zarr.json").read_text())
    group["attributes"].update(change)
    (path / "zarr.json").write_text(json.dumps(group))
    rewrite_sums(path)


def test_a_store_gives_back_what_was_written(stored: Path) -> None:
    assert is_bake(stored) and bake_store.is_store(f"{stored}/")
    assert_same(Bake.load(stored), made())
    made().save(stored.with_suffix(".npz"))
    assert_same(Bake.load(stored.with_suffix(".npz")), made())


def test_two_writings_are_the_same_bytes(stored: Path, tmp_path: Path) -> None:
    made().save(tmp_path / "b.zarr")
    ours = {item.relative_to(stored): item.read_bytes() for item in stored.rglob("*") if item.is_file()}
    other = tmp_path / "b.zarr"
    assert ours == {item.relative_to(other): item.read_bytes() for item in other.rglob("*") if item.is_file()}


def test_every_chunk_has_zarrs_own_checksum(stored: Path) -> None:
    for metadata in stored.glob("*/zarr.json"):
        assert json.loads(metadata.read_text())["codecs"][-1] == {"name": "crc32c"}, metadata


def test_visibility_is_read_by_ranges_and_from_their_chunks_only(
    stored: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted, baked = made().bits, StoredBake(stored)
    assert baked.store.arrays["bits"].chunks == (ROWS, 2) and len(baked) == VERTICES
    for start in range(VERTICES + 1):
        for stop in range(start, VERTICES + 1):
            assert (baked.bits(start, stop) == wanted[start:stop]).all()
    read: list[str] = []
    checked = ArrayStore._checked
    monkeypatch.setattr(ArrayStore, "_checked", lambda self, name: (read.append(name), checked(self, name)))
    baked.bits(9, 17)
    assert read == ["bits/c/1/0", "bits/c/2/0"]
    for count in (1, 5, 8, 29, 100):
        parts = list(baked.parts(count))
        assert [start for start, _ in parts] == list(range(0, VERTICES, count))
        assert (np.concatenate([bits for _, bits in parts]) == wanted).all()
    for bad in ((-1, 3), (3, 2), (0, 30)):
        with pytest.raises(IndexError, match="expected from 0 to 29"):
            baked.bits(*bad)


def outcome(path: Path) -> str:
    """'refused' or 'same'; anything else fails the test: other arrays, or another exception."""
    try:
        got = Bake.load(path)
    except InputError as error:
        assert str(error).startswith(f"{path}: ") and len(str(error).splitlines()) <= 2
        return "refused"
    assert_same(got, made())
    return "same"


def metadata_of(path: Path) -> list[Path]:
    return sorted([*path.rglob("zarr.json"), path / SUMS])


def chunks_of(path: Path) -> list[Path]:
    return sorted(item for item in path.rglob("c/**/*") if item.is_file())


@pytest.mark.parametrize("mask", [0x01, 0x20])
def test_every_byte_flip_of_the_metadata_is_refused(stored: Path, mask: int) -> None:
    flips = 0
    for file in metadata_of(stored):
        whole = file.read_bytes()
        for position in range(len(whole)):
            file.write_bytes(whole[:position] + bytes([whole[position] ^ mask]) + whole[position + 1 :])
            assert outcome(stored) == "refused", (file, position)
            flips += 1
        file.write_bytes(whole)
    assert flips > 5000 and outcome(stored) == "same"


def test_sampled_byte_flips_of_chunks_are_refused(stored: Path) -> None:
    rng = np.random.default_rng(7)
    assert len(chunks_of(stored)) > 20
    for file in chunks_of(stored):
        whole = file.read_bytes()
        for position in rng.choice(len(whole), min(4, len(whole)), replace=False):
            mask = int(rng.integers(1, 256))
            file.write_bytes(whole[:position] + bytes([whole[position] ^ mask]) + whole[position + 1 :])
            assert outcome(stored) == "refused", (file, position)
        file.write_bytes(whole)
    assert outcome(stored) == "same"


def test_files_cut_off_grown_or_gone_are_refused(stored: Path) -> None:
    for file in (*metadata_of(stored), *chunks_of(stored)):
        whole = file.read_bytes()
        for changed in (b"", whole[:1], whole[: len(whole) // 2], whole[:-1], whole + b"\0", whole + whole):
            file.write_bytes(changed)
            assert outcome(stored) == "refused", file
        file.unlink()
        assert outcome(stored) == "refused", file
        file.mkdir()
        assert outcome(stored) == "refused", file
        file.rmdir()
        file.write_bytes(whole)
    assert outcome(stored) == "same"


def test_chunks_in_each_others_place_are_refused(stored: Path) -> None:
    """Zarr itself reads them: each has its own checksum."""
    first, second = (stored / "bits" / "c" / str(number) / "0" for number in (0, 1))
    one, two = first.read_bytes(), second.read_bytes()
    first.write_bytes(two)
    second.write_bytes(one)
    with pytest.raises(InputError, match="bits/c/0/0 does not match its hash"):
        Bake.load(stored)


@pytest.mark.parametrize("name", [".DS_Store", "bits/c/9/0", "notes/zarr.json", "bits/c/0/0.orig"])
def test_files_that_are_not_listed_are_not_read(stored: Path, name: str) -> None:
    (stored / name).parent.mkdir(parents=True, exist_ok=True)
    (stored / name).write_bytes(b"something else")
    assert outcome(stored) == "same"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"format": 2, "prtcl": "9.0"}, "a bake of format 2, made by prtcl 9.0; this prtcl"),
        ({"format": None}, "format None"),
        ({"kind": "cloud"}, "a Zarr store of something else"),
        ({"parameterisation": {"order": "row by row"}}, "parameterised in another way"),
        ({"rays": 4}, "bits expected u4 of shape"),
        ({"rays": "3"}, "bits expected u4 of shape"),
        ({"rays": 10**30}, "rays expected i of shape"),
        ({"mesh_sha256": "0" * 64}, "the mesh does not match its own hash"),
    ],
)  # fmt: skip
def test_a_whole_store_of_something_else_is_refused(stored: Path, change: dict[str, Any], word: str) -> None:
    change_attributes(stored, **change)
    with pytest.raises(InputError, match=word):
        Bake.load(stored)


def test_arrays_that_do_not_fit_are_refused_though_their_hashes_do(tmp_path: Path, stored: Path) -> None:
    attributes = ArrayStore(stored, "a bake").attributes
    arrays = {key: np.asarray(array[...]) for key, array in ArrayStore(stored, "a bake").arrays.items()}
    for change in (
        {"faces": arrays["faces"] + VERTICES},
        {"bits": arrays["bits"][:-1]},
        {"bits": arrays["bits"].astype(np.uint64)},
        {"normals": arrays["normals"] * np.float32(np.nan)},
    ):
        write_store(tmp_path / "b.zarr", {**arrays, **change}, attributes)
        with pytest.raises(InputError, match=f"{next(iter(change))} (expected|are NaN)"):
            Bake.load(tmp_path / "b.zarr")
    del arrays["parts"]
    write_store(tmp_path / "b.zarr", arrays, attributes)
    with pytest.raises(InputError, match="is no bake: parts missing"):
        Bake.load(tmp_path / "b.zarr")


@pytest.mark.parametrize("ending", [".zarr", ".npz"])
def test_a_bake_of_another_mesh_is_refused(tmp_path: Path, ending: str) -> None:
    path, mesh = tmp_path / f"a{ending}", made().mesh
    made().save(path)
    plain = replace(mesh, materials=(None, None), colours=None, name="plain")
    assert Bake.load(path, mesh=plain).mesh is plain  # materials and colours do not change visibility
    vertices, faces, normals = mesh.vertices.copy(), mesh.faces.copy(), mesh.normals
    vertices[17, 1] = np.nextafter(vertices[17, 1], 9.0)
    faces[3] = np.roll(faces[3], 1)
    assert normals is not None
    for changed, word in (
        (replace(mesh, vertices=vertices), "vertices differ"),
        (replace(mesh, vertices=vertices[:-1]), "vertices differ"),
        (replace(mesh, faces=faces), "faces differ"),
        (replace(mesh, normals=-normals), "normals differ"),
        (mesh.smooth(), "normals differ"),
    ):
        assert mesh_hash(changed) != mesh_hash(mesh)
        with pytest.raises(
            InputError, match=f"was baked from another mesh than thing: {word}; bake it again"
        ):
            Bake.load(path, mesh=changed)


def test_a_mesh_without_normals_is_matched_by_those_it_was_baked_with(tmp_path: Path) -> None:
    mesh = replace(made().mesh, normals=None)
    Bake.trace(mesh, rays=1).save(tmp_path / "a.zarr")
    assert Bake.load(tmp_path / "a.zarr", mesh=mesh).mesh.normals is not None


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda path: None, "no such file or folder"),
        (lambda path: path.write_bytes(b"PK"), "a folder, got a file"),
        (lambda path: path.mkdir(), f"without {SUMS}"),
    ],
)
def test_what_is_no_store_is_refused(tmp_path: Path, make: Callable[[Path], Any], word: str) -> None:
    make(tmp_path / "a.zarr")
    with pytest.raises(InputError, match=word):
        Bake.load(tmp_path / "a.zarr")


def test_without_zarr_the_extra_is_named(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zarr", None)
    for call in (lambda: Bake.load(stored), lambda: made().save(stored)):
        with pytest.raises(InputError, match=r"pip install 'prtcl\[bake\]'"):
            call()


def test_a_failed_writing_leaves_the_older_bake(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Path] = []

    def full(path: Path) -> str:
        calls.append(path)
        if len(calls) == 9:
            raise OSError(28, "No space left on device")
        return "0" * 64

    with monkeypatch.context() as patched:
        patched.setattr(array_store, "file_sha256", full)
        with pytest.raises(PrtclError, match=r"writing failed: .*No space left"):
            made(2).save(stored)
    assert outcome(stored) == "same" and [item.name for item in stored.parent.iterdir()] == [stored.name]
    with monkeypatch.context() as patched:
        patched.setattr(array_store, "file_sha256", lambda path: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            made(2).save(stored)
    assert outcome(stored) == "same" and [item.name for item in stored.parent.iterdir()] == [stored.name]
    made(2).save(stored)
    assert_same(Bake.load(stored), made(2))
    assert [item.name for item in stored.parent.iterdir()] == [stored.name]


def test_while_it_is_written_no_bake_has_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, seen = tmp_path / "a.zarr", []
    hashed = array_store.file_sha256
    monkeypatch.setattr(
        array_store, "file_sha256", lambda item: (seen.append(path.exists()), hashed(item))[1]
    )
    made().save(path)
    assert len(seen) > 10 and not any(seen) and path.exists()


def test_folders_that_are_not_ours_are_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    path.mkdir()
    (path / "work.txt").write_text("years of it")
    with pytest.raises(InputError, match="a folder that prtcl did not write"):
        made().save(path)
    assert (path / "work.txt").read_text() == "years of it"
    (tmp_path / "b.zarr").write_text("a file")
    with pytest.raises(InputError, match="is a file and not a folder"):
        made().save(tmp_path / "b.zarr")
    with pytest.raises(InputError, match="there is no folder"):
        made().save(tmp_path / "none" / "b.zarr")


def test_a_link_to_a_store_stays_a_link(stored: Path) -> None:
    link = stored.with_name("link.zarr")
    link.symlink_to(stored)
    made(2).save(link)
    assert link.is_symlink()
    assert_same(Bake.load(stored), made(2))


def test_a_lost_rename_puts_the_older_folder_back(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    renamed, calls = folder.os.replace, []

    def fails_once(source: Path, target: Path) -> None:
        if target == stored:
            calls.append(source)
            if len(calls) == 1:
                raise OSError(5, "Input/output error")
        renamed(source, target)

    monkeypatch.setattr(folder.os, "replace", fails_once)
    with pytest.raises(PrtclError, match=r"writing failed: .*Input/output error"):
        made(2).save(stored)
    assert len(calls) == 2 and outcome(stored) == "same"
    assert [item.name for item in stored.parent.iterdir()] == [stored.name]


@pytest.mark.parametrize("ending", [".zarr", ".npz"])
def test_info_describes_a_bake(tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]) -> None:
    path, bake = tmp_path / f"a{ending}", made()
    bake.save(path)
    assert cli.main(["info", str(path), "--json", "--verify"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["mesh"], found["vertices"], found["faces"], found["rays"]) == ("thing", VERTICES, 20, RAYS)
    assert found["mesh_sha256"] == mesh_hash(bake.mesh) and found["verified"] and found["format"] == 1
    arrays = [bake.bits, *(getattr(bake.mesh, name) for name in ("vertices", "faces", "normals", "parts"))]
    assert found["bytes"]["raw"] >= sum(array.nbytes for array in arrays)
    files = [path] if ending == ".npz" else [item for item in path.rglob("*") if item.is_file()]
    assert found["bytes"]["disk"] == sum(item.stat().st_size for item in files)
    assert cli.main(["info", str(path)]) == 0
    text = capsys.readouterr().out
    assert f"4^{RAYS} = {4**RAYS} a vertex" in text and mesh_hash(bake.mesh) in text and "Morton" in text


def test_info_finds_a_damaged_chunk_when_it_verifies(
    stored: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chunk = stored / "bits" / "c" / "2" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-1])
    assert not info.describe(str(stored))["verified"]  # it holds no bits
    assert cli.main(["info", str(stored), "--verify"]) == 2
    assert "bits/c/2/0 does not match its hash" in capsys.readouterr().err
    assert cli.main(["info", "a.ply"]) == 2
    assert "expected a bake" in capsys.readouterr().err


def test_info_misses_a_chunk_without_reading_any(stored: Path) -> None:
    (stored / "bits" / "c" / "1" / "0").unlink()
    with pytest.raises(InputError, match=r"a\.zarr: .* is damaged: bits/c/.* is missing"):
        info.describe(str(stored))


def test_bake_and_occlusion_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert cli.main(["bake", "m.obj", "-o", "m.zarr", "--rays", "2"]) == 0
    assert capsys.readouterr().out.startswith("m.zarr: 3 vertices, 48 rays, ")
    assert (Bake.load("m.zarr").bits == 0xFFFF).all()
    shutil.copytree("m.zarr", "copy.zarr")  # a store has no place of its own
    assert cli.main(["info", "copy.zarr", "--verify"]) == 0
    assert cli.main(["bake", "m.obj", "-o", "m.txt"]) == 2
    Path("own.zarr").mkdir()
    Path("own.zarr/x").touch()
    assert cli.main(["bake", "m.obj", "-o", "own.zarr"]) == 2
    assert "prtcl did not write" in capsys.readouterr().err

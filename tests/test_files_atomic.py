"""Outputs appear whole or not at all, and bad output paths are refused before work starts."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

from prtcl.errors import InputError
from prtcl.files.atomic import check_writable, replacing


def listing(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_success_replaces_and_leaves_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "image.exr"
    target.write_text("old")
    with replacing(target) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".exr"
        assert not temporary.exists()
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert listing(tmp_path) == ["image.exr"]


def test_new_file_has_usual_permissions(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.write_text("x")
    with replacing(tmp_path / "made") as temporary:
        temporary.write_text("x")
    assert (tmp_path / "made").stat().st_mode == plain.stat().st_mode


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_failure_keeps_the_old_file(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "image.png"
    target.write_text("old")
    with pytest.raises(error), replacing(target) as temporary:
        temporary.write_text("half")
        raise error
    assert target.read_text() == "old"
    assert listing(tmp_path) == ["image.png"]


def test_failure_before_writing_keeps_its_own_exception(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "image.png"):
        raise ZeroDivisionError
    assert listing(tmp_path) == []


def test_symbolic_link_is_followed(tmp_path: Path) -> None:
    real = tmp_path / "real.txt"
    real.write_text("old")
    link = tmp_path / "link.txt"
    link.symlink_to(real)
    with replacing(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"


def test_check_accepts_and_leaves_nothing(tmp_path: Path) -> None:
    check_writable(tmp_path / "new.exr")
    assert listing(tmp_path) == []
    (tmp_path / "old.exr").write_text("old")
    check_writable(tmp_path / "old.exr")
    assert (tmp_path / "old.exr").read_text() == "old"
    assert listing(tmp_path) == ["old.exr"]


def test_check_accepts_a_bare_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    check_writable("new.exr")
    with replacing("new.exr") as temporary:
        temporary.write_text("x")
    assert listing(tmp_path) == ["new.exr"]


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("missing/x.exr", "no folder"),
        ("file/x.exr", "is a file"),
        ("folder", "got a folder"),
        ("", "got a folder"),
        ("n" * 300 + ".exr", "cannot be written"),
        ("nul\0.exr", "cannot be written"),
    ],
)
def test_bad_paths_are_refused(tmp_path: Path, name: str, word: str) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder").mkdir()
    before = listing(tmp_path)
    path = f"{tmp_path}/{name}" if name else ""
    with pytest.raises(InputError, match=word):
        check_writable(path)
    with pytest.raises(InputError, match=word), replacing(path):
        pytest.fail("no work may start")
    assert listing(tmp_path) == before


def test_device_is_never_replaced() -> None:
    with pytest.raises(InputError, match="device"):
        check_writable(os.devnull)


def test_folder_without_permission(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere; test_refused_attempt_is_reported is the twin")
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    with pytest.raises(InputError, match="cannot be written"):
        check_writable(folder / "x.exr")


def test_refused_attempt_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    with pytest.raises(InputError, match="Permission denied"):
        check_writable(tmp_path / "x.exr")


def test_write_protected_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "old.exr"
    target.write_text("old")
    monkeypatch.setattr(os, "access", lambda *_: False)  # what a user other than root would get
    with pytest.raises(InputError, match="write protected"):
        check_writable(target)

"""A batch's folder: what it is to hold, what of that is finished, and files that survive whatever happens.

`manifest.json` says what every image is and what the batch was made of. `finished.jsonl` has a line for each image that
is done, with the SHA-256 of its files: written after the files themselves have reached the disk, so that what it says
is so after a reboot as well. An image whose line is missing or whose files are not those is made again.
"""

from __future__ import annotations

import errno
import json
import os
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from prtcl.apps.relight.inputs import file_digest
from prtcl.apps.relight.lock import locked, unchanged
from prtcl.apps.relight.manifest import (
    FORMAT,
    MANIFEST,
    alike,
    common,
    difference,
    images,
    is_image,
    laid_out,
)
from prtcl.errors import InputError, PrtclError
from prtcl.files.atomic import made_folder, replacing

JOURNAL = "finished.jsonl"
_ASIDE = re.compile(r"\.[0-9a-f]{32}(\.[0-9a-z]+)?")
"""Files written aside by a run that was killed (`prtcl.files.atomic.replacing`)."""

Write = Callable[[Path], object]


class Folder:
    """One batch's output folder; use `opened`.

    Attributes
    ----------
    finished : numbers of the images that are whole
    """

    def __init__(self, path: Path, manifest: dict[str, Any]) -> None:
        self.path, self.manifest = path, manifest
        self.files: list[list[str]] = [
            [entry[key] for key in ("file", "png") if key in entry] for entry in manifest["frames"]
        ]
        self._lines: dict[int, dict[str, str]] = {}

    @property
    def finished(self) -> set[int]:
        """Numbers of the images that are whole."""
        return set(self._lines)

    def start(self, overwrite: bool) -> None:
        """Take the folder over: continue its batch where it is this one, or one that this has grown from.

        Raises
        ------
        InputError
            If it holds finished images that are none of this batch's, or other files of the same names, and not
            `overwrite`.
        PrtclError
            If it cannot be written.
        """
        with _writing(self.path), unchanged(self.path / MANIFEST, alone=True):
            self._sweep()
            was = self._read_manifest()
            if was is not None and alike(was, self.manifest):
                self._lines = self._read_journal()
                self._rewrite()
                return
            carried = None if was is None else self._carried(was)
            if was is not None and carried is None and not overwrite:
                raise InputError(
                    f"{self.path}: holds another job's images; what differs is {difference(was, self.manifest)}\n"
                    "choose another folder with -o, or replace them with --overwrite"
                )
            if not overwrite:
                self._refuse_strangers(set() if was is None else images(was).keys())
            if carried is None:
                self._clear(was or {})
                self._write_manifest()
                self._rewrite()
            else:
                self._clear_unfinished(was or {}, carried)
                # Should this process end in between, the journal says to both jobs what is finished.
                self._lines = carried
                self._rewrite((was or {}).get("job"))
                self._write_manifest()
                self._rewrite()

    def record(self, number: int, digests: dict[str, str]) -> None:
        """Note that an image is done, its files being on the disk."""
        with _writing(self.path / JOURNAL):
            line = _line({"frame": number, "sha256": digests})
            file = os.open(self.path / JOURNAL, os.O_WRONLY | os.O_APPEND)
            try:
                size = os.fstat(file).st_size
                try:
                    if os.write(file, line) != len(line):
                        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                    os.fsync(file)
                except OSError:
                    os.ftruncate(file, size)
                    raise
            finally:
                os.close(file)
        self._lines[number] = digests

    def write(self, name: str, write: Write) -> str:
        """Write a file of the folder, aside and then renamed, through to the disk; returns its SHA-256.

        Raises
        ------
        PrtclError
            If it cannot be written whole: nothing of it is left then.
        """
        with _writing(self.path / name):
            with ExitStack() as held, replacing(self.path / name) as aside:
                write(aside)
                digest = _flushed(aside)
                held.enter_context(self.naming())
            _flush_folder(self.path)
        return digest

    @contextmanager
    def naming(self) -> Iterator[None]:
        """What is held while a file gets its name: whoever has the folder's lock need not ask."""
        yield

    def end(self) -> None:
        """Put the folder in order, as an uninterrupted run leaves it."""
        with _writing(self.path):
            self._sweep()
        if list(self._lines) != sorted(self._lines):
            self._rewrite()

    def _sweep(self) -> None:
        """Remove what a process that was killed has left half written."""
        for path in self.path.iterdir():
            if _ASIDE.fullmatch(path.name) and not path.is_dir():  # a folder is kept visibility's
                path.unlink(missing_ok=True)

    def _rewrite(self, was: Any = None) -> None:
        """Write the journal; of two jobs where this one takes over from another."""
        self._lines = dict(sorted(self._lines.items()))
        lines = [_line({"job": self.manifest["job"], **({} if was is None else {"was": was})})]
        lines += [_line({"frame": number, "sha256": digests}) for number, digests in self._lines.items()]
        self.write(JOURNAL, lambda path: path.write_bytes(b"".join(lines)))

    def _read_manifest(self) -> dict[str, Any] | None:
        """What is there; empty where it is no manifest of ours, None where there is none."""
        try:
            found = json.loads((self.path / MANIFEST).read_bytes())
        except FileNotFoundError:
            return None
        except (ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    def _carried(self, was: dict[str, Any]) -> dict[int, dict[str, str]] | None:
        """Lines of another batch's finished images, by their numbers here; None if one there is none of ours."""
        try:
            if was["format"] != FORMAT or common(was["inputs"]) != common(self.manifest["inputs"]):
                return None
            before, now = images(was), images(self.manifest)
            finished = self._read_journal() or Folder(self.path, was)._read_journal()
        except (KeyError, TypeError, ValueError, AttributeError):
            return None
        numbers = {names[0]: number for number, names in enumerate(self.files)}
        lines: dict[int, dict[str, str]] = {}
        for digests in finished.values():
            name = next(name for name in digests if name in before or name in now)
            if before.get(name, now.get(name)) != now.get(name):
                return None
            lines[numbers[name]] = digests
        return dict(sorted(lines.items()))

    def _clear_unfinished(self, was: dict[str, Any], carried: dict[int, dict[str, str]]) -> None:
        """Remove what another batch had begun: images that no line says are whole."""
        whole = {name for digests in carried.values() for name in digests}
        for entry in was["frames"]:
            for name in (entry[key] for key in ("file", "png") if key in entry):
                if name not in whole:
                    (self.path / name).unlink(missing_ok=True)

    def _write_manifest(self) -> None:
        text = laid_out(self.manifest)
        self.write(MANIFEST, lambda path: path.write_bytes(text.encode()))

    def _read_journal(self) -> dict[int, dict[str, str]]:
        """Lines of images whose files are what the line says; a last line that was cut off counts as none."""
        try:
            lines = (self.path / JOURNAL).read_bytes().split(b"\n")[:-1]
        except FileNotFoundError:
            return {}
        found: dict[int, dict[str, str]] = {}
        numbers = {tuple(sorted(names)): number for number, names in enumerate(self.files)}
        for place, text in enumerate(lines):
            try:
                entry = json.loads(text)
                if place == 0:
                    if self.manifest["job"] not in (entry["job"], entry.get("was")):
                        return {}
                    continue
                digests = dict(entry["sha256"])
                found[numbers[tuple(sorted(digests))]] = digests
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                continue
        return {number: digests for number, digests in sorted(found.items()) if self._whole(digests)}

    def _whole(self, digests: dict[str, str]) -> bool:
        try:
            return all(file_digest(self.path / name) == digest for name, digest in digests.items())
        except InputError:
            return False

    def _refuse_strangers(self, known: Collection[str]) -> None:
        for own in self.files:
            for name in own if own[0] not in known else ():
                if not os.path.lexists(self.path / name):
                    continue
                raise InputError(
                    f"{self.path / name}: is there already, and no run of `prtcl relight` is known to have made it\n"
                    "choose another folder with -o, or replace it with --overwrite"
                )

    def _clear(self, was: dict[str, Any]) -> None:
        """Remove the images of a batch: first what says that they are finished."""
        names = [JOURNAL]
        frames = was.get("frames")
        for entry in frames if isinstance(frames, list) else []:
            names += [entry[key] for key in ("file", "png") if isinstance(entry, dict) and key in entry]
        for name in names:
            if name == JOURNAL or is_image(name):
                with suppress(FileNotFoundError, IsADirectoryError, ValueError):
                    (self.path / name).unlink()
        _flush_folder(self.path)


@contextmanager
def opened(path: str, manifest: dict[str, Any], overwrite: bool) -> Iterator[Folder]:
    """The folder, made where it is not there, held against other runs while the block runs.

    Parameters
    ----------
    manifest : as it is after a round through JSON; "job" is the fingerprint, "frames" the images in their order

    Raises
    ------
    InputError, PrtclError
        As `Folder.start` and `locked` say.
    """
    with locked(made_folder(path)):
        folder = Folder(Path(path), manifest)
        folder.start(overwrite)
        yield folder
        folder.end()


@contextmanager
def _writing(what: Path) -> Iterator[None]:
    """What goes wrong with the disk is told in two lines, with what to do."""
    try:
        yield
    except Failed:
        raise
    except InputError as error:
        if not isinstance(error.__cause__, OSError):
            raise
        raise _failed(what, error.__cause__) from error
    except PrtclError as error:
        raise _failed(what, error.__cause__ if isinstance(error.__cause__, OSError) else error) from error
    except OSError as error:
        raise _failed(what, error) from error


class Failed(PrtclError):
    """Told already."""


def _failed(what: Path, error: BaseException) -> PrtclError:
    if isinstance(error, OSError):
        reason = error.strerror or str(error)
    else:  # a writer's own words, without the name of the file that it wrote aside
        reason = str(error).splitlines()[0].partition(": ")[2] or str(error)
    return Failed(
        f"{what}: cannot be written: {reason}\n"
        "finished images are kept; when there is room, the same command makes what is missing"
    )


def _line(entry: dict[str, Any]) -> bytes:
    return json.dumps(entry).encode() + b"\n"


def _flushed(path: Path) -> str:
    """Bring a file's bytes to the disk; returns their SHA-256."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())
    return file_digest(path)


def _flush_folder(path: Path) -> None:
    """Bring a folder's names to the disk, where the system can."""
    with suppress(OSError):
        file = os.open(path, os.O_RDONLY)
        try:
            os.fsync(file)
        finally:
            os.close(file)

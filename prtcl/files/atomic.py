"""Outputs appear whole or not at all: written beside their place under another name, then renamed over it."""

from __future__ import annotations

import os
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from prtcl.errors import InputError


def check_not_input(output: str | os.PathLike[str], *inputs: str | os.PathLike[str]) -> None:
    """Refuse an output that is one of the files the job reads: it would be replaced by the result.

    Raises
    ------
    InputError
        `output` and an input are the same file.
    """
    for path in inputs:
        if Path(path).exists() and Path(path).resolve() == Path(output).resolve():
            raise InputError(
                f"{os.fspath(output)}: is an input of this job and would be overwritten; name another output"
            )


def made_folder(path: str | os.PathLike[str]) -> Path:
    """The folder of a job's outputs, made where it is not there.

    Raises
    ------
    InputError
        If it cannot be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot make the folder ({error.strerror}); choose another with -o"
        ) from error
    return folder


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse an output path that cannot be written, before any work is done. Leaves nothing behind.

    Parameters
    ----------
    path : str or os.PathLike
        The file to be written later. It may exist, and is then going to be replaced.

    Raises
    ------
    InputError
        The folder is missing, is a file or is not writable; `path` is a folder, a device or write
        protected; or the file system refuses the name.
    """
    target = Path(path)
    try:
        if not target.name:
            raise InputError(f"{target}: expected the name of a file to write, got a folder")
        target = resolved(target)
        parent = target.parent
        if not parent.exists():
            raise InputError(f"{target}: cannot be written, there is no folder {parent}; create it first")
        if not parent.is_dir():
            raise InputError(f"{target}: cannot be written, {parent} is a file and not a folder")
        if target.is_dir():
            raise InputError(f"{target}: expected the name of a file to write, got a folder")
        if target.exists():
            # Renaming over /dev/null would replace the device itself.
            if not target.is_file():
                raise InputError(
                    f"{target}: cannot be written, it is a device or a pipe; name a regular file"
                )
            if not os.access(target, os.W_OK):
                raise InputError(f"{target}: cannot be written, the file is write protected")
        with suppress(FileNotFoundError):
            os.lstat(target)  # refuses names that the checks above take for missing files
        # Only an attempt tells for sure (access lists, read-only and network file systems); the file made
        # here has no name or loses it at once.
        with tempfile.TemporaryFile(dir=parent):
            pass
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written: {error}; choose another place") from error


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a path to write to that becomes `path` when the block ends without an exception.

    The yielded path lies in the same folder, so that the rename is atomic, keeps the suffix, because
    writers choose the format by it, and does not exist yet, so that the file gets the usual permissions.
    A symbolic link at `path` is followed: its target is replaced, the link stays.

    Parameters
    ----------
    path : str or os.PathLike
        The file to write or replace.

    Yields
    ------
    pathlib.Path
        Where to write.

    Raises
    ------
    InputError
        `path` cannot be written (see `check_writable`).
    """
    check_writable(path)
    target = resolved(Path(path))
    temporary = target.with_name(f".{uuid.uuid4().hex}{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except BaseException:
        # An interrupt (KeyboardInterrupt is no Exception) must not leave half a file either.
        with suppress(OSError):
            temporary.unlink()
        raise


def resolved(path: Path) -> Path:
    """Follow a symbolic link at `path` itself, and leave any other path as it was given."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path

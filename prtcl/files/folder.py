"""Folders appear whole or not at all, as `prtcl.files.atomic` has it for files."""

from __future__ import annotations

import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from prtcl.errors import InputError
from prtcl.files.atomic import resolved


def check_folder_writable(path: str | os.PathLike[str], mark: str) -> None:
    """Refuse an output folder that cannot be written, before any work is done. Leaves nothing behind.

    Parameters
    ----------
    path : str or os.PathLike
        The folder to be written later.
    mark : str
        A file that a folder of this kind holds: one without it is somebody's own and is not replaced.

    Raises
    ------
    InputError
        `path` is a file or another kind of folder, or its parent is missing or not writable.
    """
    target = Path(path)
    try:
        if not target.name:
            raise InputError(f"{target}: expected the name of a folder to write")
        parent = resolved(target).parent
        if not parent.is_dir():
            raise InputError(f"{target}: cannot be written, there is no folder {parent}; create it first")
        if target.exists():
            if not target.is_dir():
                raise InputError(f"{target}: cannot be written, it is a file and not a folder; name another")
            if not (target / mark).is_file() and any(target.iterdir()):
                raise InputError(
                    f"{target}: is a folder that prtcl did not write ({mark} is missing); name another output"
                )
        with tempfile.TemporaryDirectory(dir=parent):  # only an attempt tells for sure
            pass
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written: {error}; choose another place") from error


@contextmanager
def replacing_folder(path: str | os.PathLike[str], mark: str) -> Iterator[Path]:
    """Yield a new, empty folder beside `path` that becomes `path` when the block ends without an exception.

    No file system renames a folder over one that holds files, so an older one is first renamed out of the way, and
    removed at the end. Killed between these two renames, `path` is missing and the older one lies beside it under
    a name that starts with a dot; no half-written folder ever has the name.

    Parameters
    ----------
    path, mark
        See `check_folder_writable`.

    Yields
    ------
    pathlib.Path
        Where to write.

    Raises
    ------
    InputError
        `path` cannot be written.
    """
    check_folder_writable(path, mark)
    target = resolved(Path(path))
    aside, older = (target.with_name(f".{uuid.uuid4().hex}{target.suffix}") for _ in range(2))
    try:
        aside.mkdir()
        yield aside
        if target.exists():
            os.replace(target, older)
        try:
            os.replace(aside, target)
        except BaseException:
            with suppress(OSError):
                os.replace(older, target)
            raise
    finally:
        # An interrupt must not leave half a folder either.
        shutil.rmtree(aside, ignore_errors=True)
        if target.exists():
            shutil.rmtree(older, ignore_errors=True)

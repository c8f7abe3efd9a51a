"""Checks before a reader opens an input file: it exists, is a file, has bytes and a known extension."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from prtcl.errors import InputError


def check_source(path: str | os.PathLike[str], extensions: Sequence[str], what: str) -> Path:
    """Return `path` as a Path once it is known to be a non-empty readable file of a known extension.

    Parameters
    ----------
    path : str or os.PathLike
        The file a person named.
    extensions : sequence of str
        The extensions that are read, lower case with the dot. Case is ignored in `path`.
    what : str
        What the file should be, such as "an environment map"; it goes into the messages.

    Returns
    -------
    pathlib.Path
        The same path.

    Raises
    ------
    InputError
        The file is missing, a folder or a device, empty, unreadable, or has an unknown extension.
    """
    source = Path(path)
    known = ", ".join(extensions)
    try:
        if source.is_dir():
            raise InputError(f"{source}: expected {what}, got a folder; name a file inside it")
        if not source.exists():
            raise InputError(f"{source}: no such file; expected {what} ({known})")
        if not source.is_file():
            raise InputError(f"{source}: expected {what}, got a device or a pipe; name a regular file")
        if source.suffix.lower() not in extensions:
            got = f"the extension '{source.suffix}'" if source.suffix else "no extension"
            raise InputError(f"{source}: expected {what}, got {got}; these are read: {known}")
        with source.open("rb") as stream:
            if not stream.read(1):
                raise InputError(f"{source}: expected {what}, got an empty file; copy or export it again")
    except InputError:
        raise
    except (OSError, ValueError) as error:
        # ValueError is what an embedded null character gives.
        raise InputError(
            f"{source}: cannot be read as {what}: {error}; check the path and permissions"
        ) from error
    return source

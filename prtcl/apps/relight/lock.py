"""One run at a time in a folder: a lock that the operating system takes back from a process that dies."""

from __future__ import annotations

import errno
import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from prtcl.errors import PrtclError

NAME = ".relight.lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder while the block runs.

    The file stays, empty: deleting it would let two runs lock two files of one name. Whoever holds it has written who
    that is. A process that was killed holds nothing any more, so there is no stale lock to tell from a good one.

    Raises
    ------
    PrtclError
        If another run holds it, or the file system has no locks.
    """
    try:
        import fcntl
    except ImportError as error:  # Windows
        raise PrtclError(
            f"{folder}: cannot be locked against a second run on this system\nrun this under Linux or macOS"
        ) from error
    try:
        file = os.open(folder / NAME, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise PrtclError(f"{folder}: cannot be written: {error.strerror}\nchoose another with -o") from error
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES):
                raise PrtclError(
                    f"{folder}: cannot be locked against a second run ({error.strerror})\n"
                    "choose a folder on another file system with -o"
                ) from error
            raise PrtclError(
                f"{folder}: {_holder(file)} writes here\nwait for it to end, or choose another folder with -o"
            ) from error
        with suppress(OSError):  # a full disk has room for the lock, if not for the name
            os.ftruncate(file, 0)
            started = time.strftime("%Y-%m-%d %H:%M:%S")
            who = {"pid": os.getpid(), "host": socket.gethostname(), "since": started}
            os.pwrite(file, json.dumps(who).encode(), 0)
        try:
            yield
        finally:
            with suppress(OSError):
                os.ftruncate(file, 0)
    finally:
        os.close(file)


@contextmanager
def unchanged(path: Path, alone: bool) -> Iterator[int | None]:
    """Hold a file, which is only ever replaced whole, as it is now: those that replace it, or read it so, wait.

    Parameters
    ----------
    alone : for the one that replaces it; otherwise with others that read it

    Yields
    ------
    int or None
        A descriptor to read it by; None where there is no such file.

    Raises
    ------
    OSError
        If it cannot be opened, or the file system has no locks.
    """
    import fcntl

    while True:
        try:
            file = os.open(path, os.O_RDWR if alone else os.O_RDONLY)
        except FileNotFoundError:
            yield None
            return
        try:
            fcntl.flock(file, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
            same = False
            with suppress(FileNotFoundError):
                same = os.path.samestat(os.fstat(file), path.stat())
            if same:  # and was not replaced while we waited
                yield file
                return
        finally:
            os.close(file)


def _holder(file: int) -> str:
    """Who holds a lock, in words."""
    try:
        who = json.loads(os.pread(file, 4096, 0))
        return f"process {who['pid']} on {who['host']}, since {who['since']},"
    except (OSError, ValueError, KeyError, TypeError):
        return "another run"

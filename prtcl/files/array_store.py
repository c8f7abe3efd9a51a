"""Named arrays in a Zarr v3 folder, every file of which is checked against its SHA-256 before it is used.

OUT.zarr/
    SHA256SUMS          all other files, as `sha256sum -c` reads it; the last line is the hash of those above it
    zarr.json           the group: attributes
    NAME/zarr.json      an array: shape, dtype, chunks, codecs
    NAME/c/I/0          rows I·k … (I + 1)·k − 1 of it: little endian, Zstandard, CRC-32C

Any Zarr v3 reader opens it, and checks the chunks' CRC-32C. That finds damage inside a chunk, but not a chunk that is
missing (which Zarr reads as zeros), nor one in another's place, nor damaged metadata: the list of hashes does.
Files that are not in the list are never read.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from prtcl.errors import InputError, PrtclError
from prtcl.files.digest import file_sha256
from prtcl.files.folder import replacing_folder

SUMS = "SHA256SUMS"
CHUNK_BYTES = 1 << 20
"""Of a chunk before compression, about: small enough to fetch some points, large enough for the disk."""
_HEX = frozenset("0123456789abcdef")


def import_zarr() -> Any:
    """The zarr package, of version 3 at least; raises InputError where it is not installed."""
    try:
        import zarr
    except ImportError as error:
        raise InputError("a .zarr bake needs the zarr package: pip install 'prtcl[bake]'") from error
    if int(zarr.__version__.split(".")[0]) < 3:
        raise InputError(
            f"a .zarr bake needs zarr 3 or newer, found {zarr.__version__}: pip install -U 'prtcl[bake]'"
        )
    return zarr


def write_store(
    path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]], attributes: dict[str, Any]
) -> None:
    """Write arrays, aside and then renamed.

    Parameters
    ----------
    path : str or os.PathLike
        The folder, whose name ends in .zarr.
    arrays : mapping of str to array
        Of one dimension or more, none of length 0; numbers only.
    attributes : dict
        What JSON can hold.

    Raises
    ------
    InputError
        The folder cannot be written, or zarr is not installed.
    PrtclError
        Writing failed, such as on a full disk.
    """
    zarr = import_zarr()
    from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec

    try:
        with replacing_folder(path, SUMS) as aside:
            group = zarr.open_group(str(aside), mode="w", zarr_format=3, attributes=attributes)
            for name, array in arrays.items():
                rows = max(1, CHUNK_BYTES // max(1, array[:1].nbytes))
                stored = group.create_array(
                    name,
                    shape=array.shape,
                    dtype=array.dtype,
                    chunks=(min(rows, len(array)), *array.shape[1:]),
                    serializer=BytesCodec(endian="little" if array.dtype.itemsize > 1 else None),
                    compressors=[ZstdCodec(level=5), Crc32cCodec()],
                    config={"write_empty_chunks": True},  # so that a missing chunk is damage
                )
                stored[...] = array
            files = sorted(item for item in aside.rglob("*") if item.is_file())
            lines = "".join(f"{file_sha256(item)}  {item.relative_to(aside).as_posix()}\n" for item in files)
            lines += f"# {hashlib.sha256(lines.encode()).hexdigest()}\n"
            (aside / SUMS).write_bytes(lines.encode())
    except OSError as error:
        raise PrtclError(f"{os.fspath(path)}: writing failed: {error}") from error


class ArrayStore:
    """A store opened for reading. Its list of hashes and its metadata are checked, its chunks as they are read.

    Parameters
    ----------
    path : str or os.PathLike
        The folder.
    what : str
        What it should be, such as "a bake made by `prtcl bake`"; it goes into the messages.

    Attributes
    ----------
    attributes : dict of str to Any, as `write_store` got them

    Raises
    ------
    InputError
        The folder is missing, no store, or damaged, or zarr is not installed.
    """

    def __init__(self, path: str | os.PathLike[str], what: str) -> None:
        zarr = import_zarr()
        self.path, self.what = Path(path), what
        self._sums = self._read_sums()
        for name in self._sums:
            if name.rsplit("/", 1)[-1] == "zarr.json":
                self._checked(name)
        try:
            group = zarr.open_group(str(self.path), mode="r", zarr_format=3, use_consolidated=False)
            self.attributes: dict[str, Any] = json.loads(json.dumps(group.attrs.asdict()))
            names = [name.removesuffix("/zarr.json") for name in self._sums if name.endswith("/zarr.json")]
            self.arrays: dict[str, Any] = {name: group[name] for name in names}
        except Exception as error:  # metadata of another writer: KeyError, ValueError, zarr's own, …
            self._damaged(f"its metadata cannot be read ({_reason(error)})")

    def read(self, name: str, start: int = 0, stop: int | None = None) -> NDArray[Any]:
        """Rows start … stop − 1 of an array, after the check of the chunks that hold them.

        Raises
        ------
        InputError
            A chunk is missing or damaged.
        """
        array = self.arrays[name]
        stop = array.shape[0] if stop is None else stop
        for key in self._keys(name, start, stop):
            self._checked(key)
        try:
            return np.asarray(array[start:stop])
        except Exception as error:  # the hash fits, so this is a writer of another kind
            self._damaged(f"{name} cannot be read ({_reason(error)})")

    def verify(self) -> int:
        """Check every file and decode every chunk; returns the number of files.

        Raises
        ------
        InputError
            Anything is missing or damaged.
        """
        for name in self._sums:
            self._checked(name)
        for name, array in self.arrays.items():
            for start in range(0, array.shape[0], array.chunks[0]):
                self.read(name, start, min(start + array.chunks[0], array.shape[0]))
        return len(self._sums)

    @property
    def disk_bytes(self) -> int:
        """Bytes of all files that belong to the store.

        Raises
        ------
        InputError
            If one is missing.
        """
        try:
            return sum((self.path / name).stat().st_size for name in (*self._sums, SUMS))
        except OSError as error:
            self._damaged(f"{Path(error.filename).relative_to(self.path)} is missing")

    @property
    def raw_bytes(self) -> int:
        """Bytes of all arrays in memory."""
        return sum(array.size * array.dtype.itemsize for array in self.arrays.values())

    def _keys(self, name: str, start: int, stop: int) -> Iterator[str]:
        """The files of the chunks that hold some rows; chunks span all other axes."""
        array = self.arrays[name]
        rows, tail = array.chunks[0], "/0" * (array.ndim - 1)
        for chunk in range(start // rows, -(-stop // rows)):
            yield f"{name}/c/{chunk}{tail}"

    def _read_sums(self) -> dict[str, str]:
        """The hash of every file, by its path from the folder."""
        if not self.path.exists():
            raise InputError(f"{self.path}: no such file or folder; expected {self.what}")
        if not self.path.is_dir():
            raise InputError(f"{self.path}: expected {self.what}, a folder, got a file")
        if not (self.path / SUMS).is_file():
            raise InputError(
                f"{self.path}: expected {self.what}, got a folder without {SUMS}: it is something else, or was "
                "copied in part; copy or make it again"
            )
        try:
            text = (self.path / SUMS).read_bytes().decode("ascii")
        except (OSError, UnicodeDecodeError) as error:
            self._damaged(f"{SUMS} cannot be read ({_reason(error)})")
        lines = text.split("\n")
        body = "".join(f"{line}\n" for line in lines[:-2])
        if lines[-2:] != [f"# {hashlib.sha256(body.encode()).hexdigest()}", ""]:
            self._damaged(f"{SUMS} does not match its own hash")
        sums = {}
        for line in lines[:-2]:
            hashed, _, name = line.partition("  ")
            if (
                len(hashed) != 64
                or not set(hashed) <= _HEX
                or ".." in name.split("/")
                or name[:1] in ("", "/")
            ):
                self._damaged(f"{SUMS} has a line that names no file")
            sums[name] = hashed
        if "zarr.json" not in sums:
            self._damaged(f"{SUMS} does not list zarr.json")
        return sums

    def _checked(self, name: str) -> None:
        """Refuse a file that is missing or has another hash."""
        wanted = self._sums.get(name)
        if wanted is None:
            self._damaged(f"{name} is not listed in {SUMS}")
        try:
            got = file_sha256(self.path / name)
        except FileNotFoundError:
            self._damaged(f"{name} is missing")
        except OSError as error:
            self._damaged(f"{name} cannot be read ({_reason(error)})")
        if got != wanted:
            self._damaged(f"{name} does not match its hash")

    def _damaged(self, reason: str) -> NoReturn:
        raise InputError(f"{self.path}: {self.what} is damaged: {reason}; copy or make it again")


def _reason(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0][:160]

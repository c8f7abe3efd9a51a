"""EPFL RGL's tensor_file container: named arrays of numbers behind one index.

Little-endian throughout: 12 bytes "tensor_file\\0", two bytes of version, uint32 number of fields; then for each field
uint16 length of its name, the name, uint16 dimensions, uint8 type, uint64 offset of its data, and a uint64 for each
dimension. Arrays are row-major.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.files.source import check_source

MAGIC = b"tensor_file\0"
TYPES = ("", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")
"""NumPy's names of the types, by the container's numbers; 0 is none."""


def read_tensors(
    path: str | os.PathLike[str], wanted: Iterable[str], extensions: Sequence[str], what: str
) -> dict[str, npt.NDArray[Any]]:
    """The `wanted` fields that the file has, in native byte order.

    Every length the file claims is held against its size before memory is taken for it.

    Raises
    ------
    InputError
        If it is no such container, is damaged or cut off, or a field's data lie outside the file.
    """
    source, chosen = check_source(path, extensions, what), set(wanted)
    try:
        size = source.stat().st_size
        with source.open("rb") as stream:
            # An index of a few fields is short; one that is not is no BRDF's.
            index = _index(stream.read(min(size, 1 << 20)))
            found: dict[str, npt.NDArray[Any]] = {}
            for name, (dtype, offset, shape) in index.items():
                if name not in chosen:
                    continue
                count = math.prod(shape)
                # Beside a length of 0 the others are held to it as well: NumPy would refuse them, but not here.
                room = math.prod(max(1, length) for length in shape) * dtype.itemsize
                if room > size or offset + count * dtype.itemsize > size:
                    raise ValueError(f"field {name!r} of shape {shape} ends beyond the file's {size} bytes")
                stream.seek(offset)
                own = np.fromfile(stream, dtype, count=count).reshape(shape)
                found[name] = own.astype(dtype.newbyteorder("="))
            return found
    except OSError as error:
        raise InputError(f"{source}: cannot be read as {what}: {error}") from error
    except (ValueError, struct.error) as error:
        raise InputError(f"{source}: expected {what}, but {error}; copy it again") from error


def _index(head: bytes) -> dict[str, tuple[np.dtype[Any], int, tuple[int, ...]]]:
    """Type, offset and shape of every field.

    Raises
    ------
    ValueError
        Saying what is wrong.
    """
    if len(head) < 18 or head[:12] != MAGIC:
        raise ValueError("it does not begin like a tensor_file")
    if head[12] != 1:
        raise ValueError(f"it is of version {head[12]}.{head[13]}, and 1.0 is read")
    at, out = 18, {}
    for _ in range(struct.unpack_from("<I", head, 14)[0]):
        try:
            (length,) = struct.unpack_from("<H", head, at)
            name = head[at + 2 : at + 2 + length].decode("latin-1")
            n_dims, kind, offset = struct.unpack_from("<HBQ", head, at + 2 + length)
            at += 2 + length + 11
            shape = struct.unpack_from(f"<{n_dims}Q", head, at)
            at += 8 * n_dims
        except struct.error as error:
            raise ValueError("its index is cut off") from error
        if not 0 < kind < len(TYPES):
            raise ValueError(f"field {name!r} is of an unknown type {kind}")
        if n_dims > 8:
            raise ValueError(f"field {name!r} has {n_dims} dimensions")
        out[name] = np.dtype("<" + TYPES[kind]), offset, shape
    return out

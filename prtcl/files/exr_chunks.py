"""Finds a truncated or unfinished EXR file from its offset table, before any pixel is decoded.

The OpenEXR library does notice most such files, but it may rebuild a broken table from what is left, and it
prints a line per missing block. Reading the table here costs a few bytes per block and gives one message.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import NamedTuple

from prtcl.errors import InputError

MAGIC = b"\x76\x2f\x31\x01"
MAX_PIXELS = 2**29  # 32768 x 16384; a larger window comes from a damaged header and would exhaust memory

_FLAG_TILED = 0x200
_FLAG_DEEP = 0x800
_FLAG_MULTIPART = 0x1000
# Scanlines per block, by the number of the compression:
# none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB.
_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)


class _Part(NamedTuple):
    """What one part's header says: its number of blocks (None where not known here), and whether tiled."""

    blocks: int | None
    tiled: bool


def check_chunks(path: Path) -> None:
    """Raise unless every block of pixels that the EXR file announces lies inside the file.

    Files whose block count takes more than the header to tell (mip maps, compressions newer than this
    code) pass unchecked and are left to the library.

    Parameters
    ----------
    path : pathlib.Path
        A non-empty file.

    Raises
    ------
    InputError
        The file is no EXR, its header is damaged, it holds deep data, or blocks are missing.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[:4] != MAGIC:
            raise InputError(
                f"{path}: expected an EXR image, got something else (the first bytes are not EXR's)"
            )
        try:
            missing, total = _missing(path, data)
        except (struct.error, ValueError, KeyError, IndexError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"{path}: the EXR header is damaged or cut off; copy or export the file again"
            ) from error
    if missing:
        raise InputError(
            f"{path}: incomplete EXR image, {missing} of its {total} blocks of pixels are missing or "
            "cut off; copy or export the file again"
        )


def _missing(path: Path, data: mmap.mmap) -> tuple[int, int]:
    """Count the blocks that do not lie inside the file, and all blocks announced."""
    (flags,) = struct.unpack_from("<I", data, 4)
    if flags & _FLAG_DEEP:
        raise InputError(f"{path}: expected a flat EXR image, got deep data; flatten it first")
    multipart = bool(flags & _FLAG_MULTIPART)
    position = 8
    parts: list[_Part] = []
    while True:
        attributes, position = _header(data, position)
        parts.append(_part(path, attributes, bool(flags & _FLAG_TILED)))
        if not multipart:
            break
        if data[position] == 0:  # an empty header ends the list
            position += 1
            break
    missing = total = 0
    for part in parts:
        if part.blocks is None:
            break
        total += part.blocks
        offsets = struct.unpack_from(f"<{part.blocks}Q", data, position)
        position += 8 * part.blocks
        lead = (16 if part.tiled else 4) + (4 if multipart else 0)
        missing += sum(not _inside(data, offset, position, lead) for offset in offsets)
    return missing, total


def _inside(data: mmap.mmap, offset: int, first: int, lead: int) -> bool:
    """Whether a block whose size field follows `lead` bytes after `offset` ends inside the file."""
    if not first <= offset <= len(data) - lead - 4:
        return False
    (size,) = struct.unpack_from("<i", data, offset + lead)
    return 0 <= int(size) <= len(data) - offset - lead - 4


def _header(data: mmap.mmap, position: int) -> tuple[dict[bytes, bytes], int]:
    """Read one header's attributes, name to value, and the position after it."""
    attributes: dict[bytes, bytes] = {}
    while data[position] != 0:
        name, position = _text(data, position)
        _, position = _text(data, position)  # the type
        (size,) = struct.unpack_from("<i", data, position)
        position += 4
        if not 0 <= size <= len(data) - position:
            raise ValueError("attribute beyond the end of the file")
        attributes[name] = data[position : position + size]
        position += size
    return attributes, position + 1


def _text(data: mmap.mmap, position: int) -> tuple[bytes, int]:
    """Read a null-terminated name, at most 255 bytes as the format allows."""
    end = data.find(b"\0", position, position + 256)
    if end < 0:
        raise ValueError("name without an end")
    return data[position:end], end + 1


def _part(path: Path, attributes: dict[bytes, bytes], flag_tiled: bool) -> _Part:
    """Work out the number of blocks of a part, and refuse a window no image has."""
    kind = attributes.get(b"type", b"").rstrip(b"\0")
    if kind.startswith(b"deep"):
        raise InputError(f"{path}: expected a flat EXR image, got deep data; flatten it first")
    x0, y0, x1, y1 = struct.unpack("<4i", attributes[b"dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise InputError(
            f"{path}: the EXR header announces an image of {width}x{height} pixels; the file is damaged"
        )
    tiled = kind == b"tiledimage" or (flag_tiled and not kind)
    count: int | None = None
    if b"chunkCount" in attributes:
        (count,) = struct.unpack("<i", attributes[b"chunkCount"])
        if count < 1:
            raise ValueError("no blocks")
    elif tiled:
        tile_width, tile_height, mode = struct.unpack("<IIB", attributes[b"tiles"])
        if mode & 0xF == 0 and tile_width and tile_height:
            count = -(-width // tile_width) * -(-height // tile_height)
    else:
        compression = attributes[b"compression"][0]
        if compression < len(_LINES):
            count = -(-height // _LINES[compression])
    return _Part(count, tiled)

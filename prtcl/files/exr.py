"""Reads the channels of an EXR image and picks which of them are colour."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.files.exr_chunks import check_chunks

Channels = dict[str, NDArray[Any]]
_ALPHA = frozenset({"A", "AR", "AG", "AB"})


class Colour(NamedTuple):
    """The colour of an EXR image.

    Attributes
    ----------
    rgb : (h, w, 3) float32
        Linear values as stored, a single channel repeated three times.
    alpha : (h, w) float32 or None
        The alpha that goes with them, if there is one.
    notes : list of str
        What a reader should be told about the choice of channels.
    """

    rgb: NDArray[np.float32]
    alpha: NDArray[np.float32] | None
    notes: list[str]


def read_colour(path: Path) -> Colour:
    """Read the colour of the first part of an EXR file that has any.

    Plain R, G, B come first, then the first layer with all three (such as "diffuse.R"), then Y or the only
    channel as grey. The window read is the data window.

    Parameters
    ----------
    path : pathlib.Path
        A non-empty file.

    Returns
    -------
    Colour
        Its values are unchecked: they may be negative, NaN or infinite.

    Raises
    ------
    InputError
        Not an EXR, truncated or damaged, or without colour channels.
    """
    parts = _read_parts(path)
    for pick in (_plain, _layer, _grey):
        for number, channels in enumerate(parts):
            found = pick(channels)
            if found is None:
                continue
            names, alpha, notes = found
            if len(parts) > 1:
                notes.append(f"read part {number + 1} of {len(parts)}")
            planes = [_plane(path, name, channels[name]) for name in names]
            shape = planes[0].shape
            if any(plane.shape != shape for plane in planes):
                raise InputError(f"{path}: its colour channels differ in size (subsampled); export plain RGB")
            rgb = np.empty((*shape, 3), dtype=np.float32)
            for index in range(3):
                rgb[..., index] = planes[index % len(planes)]
            opacity = _plane(path, alpha, channels[alpha]) if alpha is not None else None
            if opacity is not None and opacity.shape != shape:
                raise InputError(f"{path}: its alpha differs in size from its colour; export plain RGBA")
            return Colour(rgb, opacity, notes)
    names = sorted({name for channels in parts for name in channels})
    raise InputError(
        f"{path}: no colour channels; expected R, G, B or a single channel, got "
        f"{', '.join(names) or 'none'}; export the image as RGB"
    )


def _read_parts(path: Path) -> list[Channels]:
    """Read every part's channels, name to (h, w) array, and make sure that none went missing."""
    check_chunks(path)
    try:
        # The header alone first: on damaged pixels the library drops the part and carries on, so what was
        # announced has to be compared with what came.
        announced = [part.header for part in OpenEXR.File(str(path), header_only=True).parts]
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        if len(parts) != len(announced):
            raise ValueError("some of its pixels cannot be decoded")
        return [_checked(part.channels, header) for part, header in zip(parts, announced, strict=True)]
    except InputError:
        raise
    except Exception as error:
        # The library raises RuntimeError, ValueError, TypeError and MemoryError for damaged files.
        raise InputError(
            f"{path}: cannot be read as an EXR image, it is damaged or cut off ({_line(error)}); "
            "copy or export the file again"
        ) from error


def _checked(channels: dict[str, Any], header: dict[str, Any]) -> Channels:
    """Return the arrays of a part once each has the size its header announces."""
    low, high = header["dataWindow"]
    width, height = (int(high[axis]) - int(low[axis]) + 1 for axis in (0, 1))
    names = {channel.name for channel in header["channels"]}
    if names != set(channels):
        raise ValueError("some of its channels cannot be decoded")
    for channel in channels.values():
        if channel.xSampling == channel.ySampling == 1 and channel.pixels.shape != (height, width):
            raise ValueError(f"channel {channel.name} came as {channel.pixels.shape}, not {(height, width)}")
    return {name: channel.pixels for name, channel in channels.items()}


_Choice = tuple[list[str], str | None, list[str]]


def _plain(channels: Channels) -> _Choice | None:
    """Choose R, G, B."""
    if not {"R", "G", "B"} <= channels.keys():
        return None
    return ["R", "G", "B"], "A" if "A" in channels else None, []


def _layer(channels: Channels) -> _Choice | None:
    """Choose the first layer, by name, that has R, G and B."""
    layers = sorted(name[:-2] for name in channels if name.endswith(".R"))
    for layer in layers:
        names = [f"{layer}.{letter}" for letter in "RGB"]
        if channels.keys() >= set(names):
            alpha = f"{layer}.A"
            return names, alpha if alpha in channels else None, [f"read the layer '{layer}'"]
    return None


def _grey(channels: Channels) -> _Choice | None:
    """Choose Y or, where it is alone but for alpha, any channel. Luminance with chroma is not grey."""
    rest = sorted(channels.keys() - _ALPHA)
    if {"RY", "BY"} & channels.keys() or not rest or (len(rest) > 1 and "Y" not in rest):
        return None
    name = "Y" if "Y" in rest else rest[0]
    return [name], "A" if "A" in channels else None, [f"read the single channel '{name}' as grey"]


def _plane(path: Path, name: str, pixels: NDArray[Any]) -> NDArray[np.float32]:
    """Return one channel as float32."""
    if pixels.ndim != 2 or pixels.dtype.kind != "f":
        raise InputError(
            f"{path}: channel {name} holds {pixels.dtype} values; expected half or float radiance"
        )
    return pixels.astype(np.float32)


def _line(error: Exception) -> str:
    """Return the first line of a library's message, short enough for one of ours."""
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0][:160]

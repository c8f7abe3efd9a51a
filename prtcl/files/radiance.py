"""Reads an environment map as linear radiance, and refuses values no light can have."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.files.exr import read_colour
from prtcl.files.source import check_source

EXTENSIONS = (".exr", ".hdr", ".pic")


def read_radiance(
    path: str | os.PathLike[str], *, repair: bool = False
) -> tuple[NDArray[np.float32], list[str]]:
    """Read an environment map.

    Parameters
    ----------
    path : str or os.PathLike
        An EXR (half or float; RGB, RGBA with the alpha ignored, a layer, or one channel read as grey), or a
        Radiance .hdr or .pic, which takes the optional package OpenImageIO.
    repair : bool
        Replace impossible values instead of refusing them: NaN and negative by 0, +infinity by the largest
        finite value of the image.

    Returns
    -------
    radiance : (h, w, 3) float32, C-contiguous
        Linear radiance in the file's units, finite and not negative; row 0 is the top row.
    notes : list of str
        What was chosen or repaired, a line each; empty where there is nothing to tell.

    Raises
    ------
    InputError
        The file is missing, no such image, truncated, without colour, or (without `repair`) holds NaN,
        infinite or negative values; for .hdr also where OpenImageIO is not installed.
    """
    source = check_source(path, EXTENSIONS, "an environment map")
    if source.suffix.lower() == ".exr":
        radiance, _, notes = read_colour(source)
    else:
        # Imported here, so that the optional package behind it is asked for only when needed.
        from prtcl.files.hdr import read_hdr

        radiance, notes = read_hdr(source)
    if radiance.shape[0] < 1 or radiance.shape[1] < 1:
        raise InputError(f"{source}: the image has no pixels; expected at least 1x1")
    repaired = _check_values(radiance, source, repair)
    return np.ascontiguousarray(radiance, dtype=np.float32), notes + repaired


def require_equirectangular(array: NDArray[np.float32], path: str | os.PathLike[str]) -> None:
    """Refuse an image that cannot be an equirectangular environment.

    Parameters
    ----------
    array : (h, w, ...) array
        The image.
    path : str or os.PathLike
        The file it came from, for the message.

    Raises
    ------
    InputError
        Its width is not twice its height.
    """
    height, width = array.shape[:2]
    if width != 2 * height:
        raise InputError(
            f"{Path(path)}: expected an equirectangular map, twice as wide as high; "
            f"got {width}x{height} pixels; convert or resize it"
        )


def _check_values(radiance: NDArray[np.float32], path: Path, repair: bool) -> list[str]:
    """Refuse NaN, infinite and negative values, or replace them in place and say so."""
    nan = np.isnan(radiance)
    infinite = np.isposinf(radiance)
    negative = radiance < 0  # false for NaN, true for -infinity
    counts = {
        "NaN": int(nan.sum()),
        "infinite": int(infinite.sum()),
        "negative": int(negative.sum()),
    }
    if not any(counts.values()):
        return []
    listed = ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)
    if not repair:
        row, column, channel = (int(i) for i in np.argwhere(nan | infinite | negative)[0])
        value = float(radiance[row, column, channel])
        raise InputError(
            f"{path}: expected finite radiance of at least 0, got {listed} of {radiance.size} values; "
            f"the first is {value:g} at row {row}, column {column}, channel {'RGB'[channel]}.\n"
            "Use --repair to replace them (NaN and negative by 0, infinite by the largest finite value)."
        )
    radiance[nan | negative] = 0
    largest = float(np.max(radiance, initial=0, where=~infinite))
    radiance[infinite] = largest
    notes = []
    if counts["NaN"] or counts["negative"]:
        notes.append(f"replaced {counts['NaN']} NaN and {counts['negative']} negative values by 0")
    if counts["infinite"]:
        notes.append(f"replaced {counts['infinite']} infinite values by the largest finite one, {largest:g}")
    return notes

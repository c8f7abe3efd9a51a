"""UTIA's .bin: an anisotropic BRDF at 6 × 48 incident by 6 × 48 outgoing directions.

Little-endian float64 without a header: three channels, each 288 rows for the incident and 288 columns for the outgoing
direction, in both of which the azimuth, in steps of 7.5°, runs faster than the elevation, 0 to 75° from the normal in
steps of 15° (Filip, Vávra, "Template-based sampling of anisotropic BRDFs", 2014).
"""

from __future__ import annotations

import os

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.files.source import check_source

SHAPE = (6, 48, 6, 48)
"""Incident θ and φ, outgoing θ and φ."""
STEP_THETA, STEP_PHI = np.radians(15.0), np.radians(7.5)
BYTES = 3 * 288 * 288 * 8
EXTENSION = ".bin"


def read_utia(path: str | os.PathLike[str]) -> npt.NDArray[np.float64]:
    """Reflectance at every pair of directions: (6, 48, 6, 48, 3) float64, as stored, so some may be negative.

    Raises
    ------
    InputError
        If the file cannot be read, is of another size, or holds NaN, infinite or huge numbers.
    """
    what = "a UTIA BRDF"
    source = check_source(path, (EXTENSION,), what)
    try:
        size = source.stat().st_size
        if size != BYTES:
            raise InputError(
                f"{source}: expected {what} of {BYTES} bytes (288 x 288 directions, 3 channels), got {size}; "
                "copy it again, or is it another kind of file?"
            )
        stored = np.fromfile(source, "<f8")
    except OSError as error:
        raise InputError(f"{source}: cannot be read as {what}: {error}") from error
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(stored) < 1e100)
    if stored.size != BYTES // 8 or bad.any():
        raise InputError(f"{source}: {int(bad.sum())} numbers are NaN, infinite or huge; copy it again")
    return np.moveaxis(stored.reshape(3, *SHAPE), 0, -1).astype(np.float64)

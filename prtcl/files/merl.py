"""MERL's .binary: an isotropic BRDF on 90 × 90 × 180 bins of (θ_h, θ_d, φ_d).

Three little-endian int32 (90, 90, 180), then three channels of 90 · 90 · 180 little-endian float64, red first, φ_d
running fastest. Stored numbers times `SCALES` are f in 1/sr. θ_h is divided in equal steps of √θ_h, θ_d and φ_d in
degrees; φ_d runs over half a turn, since by reciprocity f is the same half a turn further (Matusik, Pfister, Brand,
McMillan, "A data-driven reflectance model", 2003; Rusinkiewicz 1998 for the angles). Bins without a measurement hold
negative numbers.
"""

from __future__ import annotations

import math
import os

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.files.atomic import replacing
from prtcl.files.source import check_source

SHAPE = (90, 90, 180)
"""Bins of θ_h, θ_d and φ_d."""
SCALES = np.array([1.0 / 1500, 1.15 / 1500, 1.66 / 1500])
"""1/sr of a stored one, by channel."""
HEADER = 12
BYTES = HEADER + 3 * math.prod(SHAPE) * 8
"""Of a whole file; any other size is refused before anything is read."""
EXTENSION = ".binary"


def read_merl(path: str | os.PathLike[str]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Reflectance of every bin, and which bins were measured.

    Returns
    -------
    values : (90, 90, 180, 3) float64, 1/sr, RGB; what the file holds, also where it is negative
    valid : (90, 90, 180) bool, False where a channel is negative

    Raises
    ------
    InputError
        If the file cannot be read, has other dimensions or another size, or holds NaN or infinite numbers.
    """
    what = "a MERL BRDF"
    source = check_source(path, (EXTENSION,), what)
    try:
        size = source.stat().st_size
        with source.open("rb") as stream:
            head = stream.read(HEADER)
            if len(head) < HEADER:
                raise InputError(f"{source}: expected {what}, got {size} bytes; copy it again")
            dims = tuple(int(d) for d in np.frombuffer(head, "<i4"))
            if dims != SHAPE:
                raise InputError(
                    f"{source}: expected {what} of 90 x 90 x 180 bins, got {' x '.join(map(str, dims))}; "
                    "is it another kind of file?"
                )
            if size != BYTES:
                state = "is cut off" if size < BYTES else "is too long"
                raise InputError(f"{source}: {state}: expected {BYTES} bytes, got {size}; copy it again")
            stored = np.fromfile(stream, "<f8", count=3 * math.prod(SHAPE))
    except OSError as error:
        raise InputError(f"{source}: cannot be read as {what}: {error}") from error
    if stored.size != 3 * math.prod(SHAPE):
        raise InputError(f"{source}: became shorter while it was read; copy it again")
    bad = ~np.isfinite(stored)
    if bad.any():
        first = np.unravel_index(int(np.argmax(bad)), (3, *SHAPE))
        raise InputError(
            f"{source}: {int(bad.sum())} numbers are NaN or infinite, the first in channel {first[0]}, bin "
            f"{tuple(int(i) for i in first[1:])}; copy it again"
        )
    with np.errstate(over="ignore"):
        values = np.moveaxis(stored.reshape(3, *SHAPE), 0, -1).astype(np.float64) * SCALES
    if not np.isfinite(values).all():
        raise InputError(f"{source}: some numbers are too large for a reflectance; copy it again")
    return values, (values >= 0.0).all(axis=-1)


def write_merl(
    path: str | os.PathLike[str], values: npt.ArrayLike, valid: npt.ArrayLike | None = None
) -> None:
    """Write `values` (90, 90, 180, 3), 1/sr; bins that are not `valid` (90, 90, 180) become −1, as MERL marks them.

    Raises
    ------
    InputError
        If the shape is another, a valid value is not finite or negative, or the file cannot be written.
    """
    own = np.asarray(values, np.float64)
    mask = np.ones(SHAPE, np.bool_) if valid is None else np.asarray(valid, np.bool_)
    if own.shape != (*SHAPE, 3) or mask.shape != SHAPE:
        raise InputError(
            f"{os.fspath(path)}: a MERL file takes values {(*SHAPE, 3)} and valid {SHAPE}, got {own.shape} and "
            f"{mask.shape}"
        )
    if not (np.isfinite(own[mask]).all() and (own[mask] >= 0).all()):
        raise InputError(
            f"{os.fspath(path)}: a MERL file takes finite reflectance, 0 or more, where it is valid"
        )
    stored = np.where(mask[..., None], own / SCALES, -1.0)
    with replacing(path) as aside, aside.open("wb") as file:
        file.write(np.array(SHAPE, "<i4").tobytes())
        np.ascontiguousarray(np.moveaxis(stored, -1, 0)).astype("<f8").tofile(file)

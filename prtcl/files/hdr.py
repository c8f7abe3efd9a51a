"""Reads a Radiance picture (.hdr, .pic) by the optional package OpenImageIO."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.files.exr_chunks import MAX_PIXELS


def read_hdr(path: Path) -> tuple[NDArray[np.float32], list[str]]:
    """Read a Radiance picture.

    Parameters
    ----------
    path : pathlib.Path
        A non-empty file.

    Returns
    -------
    radiance : (h, w, 3) float32
        Linear values as stored: an EXPOSURE line of the header is reported and not applied.
    notes : list of str
        What to tell the reader.

    Raises
    ------
    InputError
        OpenImageIO is missing, or the file is no Radiance picture, damaged, or stored by columns.
    """
    # The library goes by the content, and would read a PNG named .hdr as if it were linear radiance.
    with path.open("rb") as stream:
        if stream.read(2) != b"#?":
            raise InputError(
                f"{path}: expected a Radiance picture, got something else (the first bytes are not '#?')"
            )
    try:
        import OpenImageIO
    except ImportError as error:
        raise InputError(
            f"{path}: reading Radiance pictures takes OpenImageIO (prtcl's extra hdr); run: pip install openimageio"
        ) from error
    image = OpenImageIO.ImageInput.open(str(path))
    if image is None:
        raise _damaged(path, OpenImageIO.geterror())
    try:
        spec = image.spec()
        if image.format_name() != "hdr" or spec.nchannels != 3:
            raise InputError(
                f"{path}: expected a Radiance picture of 3 channels, got {image.format_name()} "
                f"of {spec.nchannels}"
            )
        if spec.width < 1 or spec.height < 1 or spec.width * spec.height > MAX_PIXELS:
            raise InputError(
                f"{path}: the header announces an image of {spec.width}x{spec.height} pixels; "
                "the file is damaged"
            )
        orientation = int(spec.getattribute("Orientation") or 1)
        exposure = spec.getattribute("hdr:exposure")
        pixels = image.read_image("float")
        if pixels is None or image.has_error:
            raise _damaged(path, image.geterror())
    finally:
        image.close()
    notes = []
    if exposure is not None and float(exposure) != 1.0:
        notes.append(f"the header's EXPOSURE of {float(exposure):g} was not applied")
    return _upright(path, np.asarray(pixels, dtype=np.float32), orientation), notes


def _upright(path: Path, pixels: NDArray[np.float32], orientation: int) -> NDArray[np.float32]:
    """Turn rows and columns the way the header's resolution line says ("-Y +X" is upright)."""
    if orientation not in (1, 2, 3, 4):
        # The library misreads these: it takes the scanline width for the height.
        raise InputError(
            f"{path}: stored by columns (resolution line with X first); save it in the usual order"
        )
    rows = slice(None, None, -1 if orientation in (3, 4) else 1)
    columns = slice(None, None, -1 if orientation in (2, 3) else 1)
    return np.ascontiguousarray(pixels[rows, columns])


def _damaged(path: Path, reason: str) -> InputError:
    """Build the error for a file the library gave up on."""
    first = (reason.strip() or "no reason given").splitlines()[0][:160]
    return InputError(
        f"{path}: cannot be read as a Radiance picture, it is damaged or cut off ({first}); "
        "copy or export it again"
    )

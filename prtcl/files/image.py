"""Writes rendered images: EXR with the values as they are, PNG as a preview, and reads an EXR back."""

from __future__ import annotations

import io
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from prtcl._version import __version__
from prtcl.errors import InputError, PrtclError
from prtcl.files.atomic import replacing
from prtcl.files.exr import read_colour
from prtcl.files.exr_chunks import check_chunks
from prtcl.files.source import check_source

# Header entries the format itself defines; text under these names would break the file.
_RESERVED = frozenset(
    {"channels", "chunkCount", "compression", "dataWindow", "displayWindow", "lineOrder", "name"}
    | {"pixelAspectRatio", "screenWindowCenter", "screenWindowWidth", "tiles", "type", "version", "view"}
)


def write_exr(
    path: str | os.PathLike[str],
    image: NDArray[np.float32],
    metadata: dict[str, str] | None = None,
    extra: dict[str, NDArray[np.float32]] | None = None,
) -> None:
    """Write an image as float32 EXR with channels R, G, B, A, ZIP compressed by scanlines.

    Parameters
    ----------
    path : str or os.PathLike
        The file to write; it appears whole or not at all.
    image : (h, w, 4) float
        Linear radiance times alpha (premultiplied), and alpha. Stored as float32, nothing is clipped.
    metadata : dict of str to str, optional
        Text attributes for the header.
    extra : dict of str to (h, w) float, optional
        Further channels, stored as float32.

    Raises
    ------
    InputError
        The path cannot be written, an image has another shape, or a metadata name belongs to the format.
    PrtclError
        Writing failed, such as on a full disk.
    """
    pixels = _checked(image, (4,))
    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    for name, text in (metadata or {}).items():
        if name in _RESERVED or not name or len(name) > 255:
            raise InputError(f"metadata '{name}': expected a free name of 1 to 255 characters; rename it")
        header[name] = str(text)
    planes = {name: np.ascontiguousarray(pixels[..., index]) for index, name in enumerate("RGBA")}
    for name, plane in (extra or {}).items():
        if np.shape(plane) != pixels.shape[:2]:
            raise InputError(
                f"channel '{name}': expected {pixels.shape[:2]} like the image, got {np.shape(plane)}"
            )
        planes[name] = np.ascontiguousarray(plane, dtype=np.float32)
    with replacing(path) as temporary:
        try:
            OpenEXR.File(header, planes).write(str(temporary))
        except Exception as error:
            raise PrtclError(f"{os.fspath(path)}: writing the EXR failed: {error}") from error
        try:
            check_chunks(temporary)
        except ValueError as error:  # InputError is one, and so is what an empty file gives
            # The library does not look whether its last bytes arrive.
            raise PrtclError(
                f"{os.fspath(path)}: writing the EXR failed: it came out cut off, as on a full disk"
            ) from error


def encode_png(image: NDArray[np.floating], exposure: float = 0.0) -> bytes:
    """The bytes that `write_png` writes.

    Raises
    ------
    InputError
        The image has another shape, or `exposure` is not a number.
    """
    file = io.BytesIO()
    _save_png(file, _preview(image, exposure), exposure)
    return file.getvalue()


def write_png(path: str | os.PathLike[str], image: NDArray[np.floating], exposure: float = 0.0) -> None:
    """Write an 8-bit sRGB preview.

    Colour is divided by alpha (PNG is not premultiplied), scaled by 2**exposure, clipped to what the
    format can show, and encoded; NaN shows as black. The text chunks "exposure" and "Software" state how.

    Parameters
    ----------
    path : str or os.PathLike
        The file to write; it appears whole or not at all.
    image : (h, w, 3) or (h, w, 4) float
        Linear premultiplied radiance, with alpha if there are four channels; not modified.
    exposure : float
        Stops.

    Raises
    ------
    InputError
        The path cannot be written, the image has another shape, or `exposure` is not a number.
    PrtclError
        Writing failed, such as on a full disk.
    """
    preview = _preview(image, exposure)
    with replacing(path) as temporary:
        try:
            _save_png(temporary, preview, exposure)
        except Exception as error:
            raise PrtclError(f"{os.fspath(path)}: writing the PNG failed: {error}") from error


def _save_png(target: Path | io.BytesIO, preview: Image.Image, exposure: float) -> None:
    info = PngInfo()
    info.add_text("exposure", f"{exposure:g} stops")
    info.add_text("Software", f"prtcl {__version__}")
    preview.save(target, format="PNG", pnginfo=info)


def _preview(image: NDArray[np.floating], exposure: float) -> Image.Image:
    """An 8-bit sRGB image of linear premultiplied radiance."""
    if not math.isfinite(exposure) or abs(exposure) > 1000:
        raise InputError(f"exposure: expected stops between -1000 and 1000, got {exposure}")
    pixels = _checked(image, (3, 4)).astype(np.float64)
    colour = pixels[..., :3]
    encoded = np.empty(pixels.shape, dtype=np.float64)
    # Infinite and NaN radiance is allowed in a preview, and so is what comes of it.
    with np.errstate(over="ignore", invalid="ignore"):
        if pixels.shape[2] == 4:
            alpha = np.clip(np.nan_to_num(pixels[..., 3:], nan=0.0), 0.0, 1.0)
            colour = np.divide(colour, alpha, out=np.zeros_like(colour), where=alpha > 0)
            encoded[..., 3:] = alpha
        encoded[..., :3] = srgb(np.clip(np.nan_to_num(colour * 2.0**exposure, nan=0.0), 0.0, 1.0))
    return Image.fromarray(np.floor(encoded * 255.0 + 0.5).astype(np.uint8))


def srgb(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """Encode linear values by the transfer curve of IEC 61966-2-1.

    Parameters
    ----------
    linear : array of float
        Values of at least 0; 1 is white, more is continued along the curve.

    Returns
    -------
    array of float64
        Same shape, 0 to 0 and 1 to 1.
    """
    values = np.asarray(linear, dtype=np.float64)
    # The power is taken of the clamped value, since np.where evaluates both sides.
    curve = 1.055 * np.maximum(values, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(values <= 0.0031308, 12.92 * values, curve)


def linear(encoded: ArrayLike) -> NDArray[np.float64]:
    """Decode sRGB values to linear ones, by the transfer curve of IEC 61966-2-1.

    Parameters
    ----------
    encoded : array of float
        1 is white; below 0 and above 1 the curve is continued.

    Returns
    -------
    array of float64
        Same shape, 0 to 0 and 1 to 1.
    """
    values = np.asarray(encoded, dtype=np.float64)
    # The power is taken of the clamped value, since np.where evaluates both sides.
    curve = ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 0.04045, values / 12.92, curve)


def read_image(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read an EXR image back.

    Parameters
    ----------
    path : str or os.PathLike
        An EXR file.

    Returns
    -------
    (h, w, 4) float32, C-contiguous
        Colour as stored, and alpha, 1 where the file has none.

    Raises
    ------
    InputError
        The file is missing, no EXR, truncated, or without colour.
    """
    source = check_source(path, (".exr",), "an EXR image")
    rgb, alpha, _ = read_colour(source)
    image = np.ones((*rgb.shape[:2], 4), dtype=np.float32)
    image[..., :3] = rgb
    if alpha is not None:
        image[..., 3] = alpha
    return image


def _checked(image: NDArray[np.floating], channels: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the image as float32 once it has a shape that can be written."""
    array = np.asarray(image)
    if array.ndim != 3 or array.shape[2] not in channels or array.size == 0:
        wanted = " or ".join(str(count) for count in channels)
        raise InputError(f"image: expected shape (h, w, {wanted}), got {array.shape}")
    with np.errstate(over="ignore"):  # beyond float32 is infinite there, which a preview shows as white
        return array.astype(np.float32, copy=False)

"""Base colour textures: decoding image files, finding those that a mesh file names, and looking colours up."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from prtcl.errors import InputError
from prtcl.files.image import linear

Wrap = Literal["repeat", "clamp", "mirror"]
WRAPS: tuple[Wrap, ...] = ("repeat", "clamp", "mirror")
# Named, since Pillow would also try formats that start other programs (EPS runs Ghostscript).
_FORMATS = ("PNG", "JPEG", "WEBP", "TGA", "BMP", "TIFF", "GIF", "PPM", "DDS")


_LINEAR = linear(np.arange(256) / 255.0).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Texture:
    """An image that texture coordinates look colours up in.

    Attributes
    ----------
    image : (h, w, 3) uint8
        sRGB as read, row 0 at the top.
    wrap : tuple of 2 of "repeat", "clamp", "mirror"
        What coordinates outside 0 to 1 mean, along u and along v.

    Raises
    ------
    InputError
        Another shape or dtype, no texels, or an unknown wrap mode.
    """

    image: NDArray[np.uint8]
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")

    def __post_init__(self) -> None:
        shape, dtype = self.image.shape, self.image.dtype
        if len(shape) != 3 or shape[2] != 3 or not self.image.size or dtype != np.uint8:
            raise InputError(f"image: expected shape (h, w, 3) uint8, got {shape} {dtype}")
        if len(self.wrap) != 2 or not set(self.wrap) <= set(WRAPS):
            raise InputError(f"wrap: expected two of {', '.join(WRAPS)}, got {self.wrap}")

    def lookup(self, uv: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Look colours up, bilinearly between texel centres, which lie at ((i + 0.5) / w, (j + 0.5) / h).

        Texels are decoded before they are mixed, so that a mean is one of light.

        Parameters
        ----------
        uv : (k, 2) float
            Finite; u to the right, v down, (0, 0) at the top left corner of the image.

        Returns
        -------
        (k, 3) float32
            Linear RGB in 0 to 1.
        """
        height, width = self.image.shape[:2]
        left, right, across = _texels(uv[:, 0], width, self.wrap[0])
        upper, lower, down = _texels(uv[:, 1], height, self.wrap[1])
        above, below = (
            _LINEAR[self.image[row, left]] * (1 - across) + _LINEAR[self.image[row, right]] * across
            for row in (upper, lower)
        )
        return np.asarray(above * (1 - down) + below * down, dtype=np.float32)


def _texels(
    coordinate: NDArray[np.floating[Any]], size: int, wrap: Wrap
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """Return the two texels each coordinate lies between, and the (k, 1) share of the second."""
    at = coordinate.astype(np.float64)
    # Brought into 0 to 1 before it becomes an index, which a coordinate of 1e30 would overflow.
    if wrap == "repeat":
        at = at - np.floor(at)
    elif wrap == "mirror":
        at = 1.0 - np.abs(np.mod(at, 2.0) - 1.0)
    else:
        at = np.clip(at, 0.0, 1.0)
    at = at * size - 0.5
    first = np.floor(at)
    share = (at - first).astype(np.float32)[:, None]
    index = first.astype(np.intp)
    if wrap == "repeat":
        return index % size, (index + 1) % size, share
    # Beyond the last texel centre a mirror shows the same texel again, as clamping does.
    return np.maximum(index, 0), np.minimum(index + 1, size - 1), share


def decode_image(data: bytes) -> NDArray[np.uint8]:
    """Decode an image file of 8 bits, 16 bits, a palette or grey.

    Parameters
    ----------
    data : bytes
        PNG, JPEG, WebP, TGA, BMP, TIFF, GIF, PPM or DDS.

    Returns
    -------
    (h, w, 3) uint8, C-contiguous
        RGB as stored; alpha is dropped, 16 bits are rounded to 8.

    Raises
    ------
    ValueError
        Something else, damaged, too large for Pillow, or numbers that are no sRGB (float).
    """
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # Pillow's on large images and odd headers; what it cannot read it raises
        try:
            with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
                return _pixels(image)
        except UnidentifiedImageError as error:
            raise ValueError(f"none of {', '.join(_FORMATS)}") from error
        except (
            Exception
        ) as error:  # damage comes as OSError, SyntaxError, EOFError, struct.error, zlib.error, …
            raise ValueError(str(error) or type(error).__name__) from error


def _pixels(image: Image.Image) -> NDArray[np.uint8]:
    """Return the colours of an open image."""
    if image.mode == "F":
        raise ValueError("an image of floating point numbers")
    if image.mode.startswith("I"):
        # 16 bits of grey ("I;16", and "I" in older Pillows), which convert() clips instead of scaling.
        grey = np.clip(np.asarray(image).astype(np.int64), 0, 65535)
        return np.repeat(((grey + 128) // 257).astype(np.uint8)[..., None], 3, axis=2)
    return np.ascontiguousarray(image.convert("RGB"))


def beside(folder: Path, *names: str) -> bytes:
    """Read a file that a mesh file names, which must lie in its folder or below.

    Parameters
    ----------
    folder : pathlib.Path
        Where the file that names it lies.
    *names : str
        What the name may mean, relative to the folder; the first that is there is read.

    Raises
    ------
    ValueError
        All names lead out of the folder.
    OSError
        None is there, or it cannot be read.
    """
    root = folder.resolve()
    paths = [(root / name).resolve() for name in names]
    inside = [path for path in paths if path.is_relative_to(root)]
    if not inside:
        raise ValueError("it lies outside the mesh's folder")
    for path in inside:
        if path.is_file():
            return path.read_bytes()
    raise FileNotFoundError("no such file")


def beside_by_name(folder: Path, name: str) -> bytes:
    """`beside` for formats where names are those of the author's disk: a\\b.png and C:/x/b.png may mean b.png."""
    slashes = name.replace("\\", "/")
    return beside(folder, name, slashes, slashes.rsplit("/", 1)[-1])


def unread(owner: str, label: str, error: Exception) -> str:
    """The note on a texture that cannot be read.

    Parameters
    ----------
    owner : str
        Which material names it, such as "material 'wood': "; empty where there is none, and so no factor.
    label : str
        The file, or what to call an image without one.
    error : Exception
        What reading it raised.
    """
    reason = (str(error).strip() or type(error).__name__).splitlines()[0][:120]
    note = f"{owner}texture '{' '.join(label.split())[:80]}' cannot be read ({reason})"
    return note + "; its factor is used alone" if owner else note

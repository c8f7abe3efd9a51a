"""What one page shows, as values: camera, light, looks, exposure; and the picture that is made of a render."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from prtcl.apps.view.look import Look
from prtcl.files.image import linear, srgb
from prtcl.scene.camera import Camera, Triple

BACKDROP = 0.035
"""Linear grey behind the object."""
MOVING_PIXELS = 128_000
"""The most pixels of a picture while something moves: their rays are most of its time on a CPU."""
STOPS = 8.0
"""Range of the exposure slider to either side."""

_CURVE = np.rint(255 * srgb((np.arange(4096) / 4095.0) ** 2)).astype(np.uint8)
"""sRGB of the square of i/4095: finer steps where the curve is steep, and one look-up instead of a power."""


@dataclass(frozen=True)
class Eye:
    """A camera as a page has it.

    Attributes
    ----------
    position, target, up : world
    fov : vertical, radians
    canvas : the page's canvas in pixels
    """

    position: Triple
    target: Triple
    up: Triple
    fov: float
    canvas: tuple[int, int]

    def camera(self, most: tuple[int, int], scale: float = 1.0) -> Camera:
        """A camera that sees the same, its image the canvas or less.

        Parameters
        ----------
        most : width and height that an image may have
        scale : of the image's sides; below 1 it also has at most `MOVING_PIXELS`

        Raises
        ------
        InputError
            If the page's values are no camera.
        """
        width, height = (max(1, min(side, 1 << 14)) for side in self.canvas)
        fit = min(1.0, most[0] / width, most[1] / height) * scale
        if scale < 1.0:
            fit = min(fit, math.sqrt(MOVING_PIXELS / (width * height)))
        size = max(1, round(width * fit)), max(1, round(height * fit))
        across = 2 * math.degrees(math.atan(math.tan(self.fov / 2) * width / height))
        return Camera(self.position, self.target, self.up, across, size)

    @classmethod
    def of(cls, camera: Camera) -> Eye:
        """The page's view of a camera."""
        width, height = camera.size
        fov = 2 * math.atan(math.tan(math.radians(camera.fov) / 2) * height / width)
        return cls(camera.eye, camera.target, camera.up, fov, camera.size)


@dataclass(frozen=True)
class State:
    """All that a page's picture depends on.

    Attributes
    ----------
    looks : one for each part of the mesh
    environment : its name in the page's list
    rotate : degrees, of the environment
    exposure : stops, above what suits the environment
    """

    eye: Eye
    looks: tuple[Look, ...]
    environment: str
    rotate: float = 0.0
    exposure: float = 0.0

    @property
    def light(self) -> tuple[str, float]:
        """What L ⊕ V depends on."""
        return self.environment, self.rotate

    @property
    def drawn(self) -> State:
        """Without what only develops the picture."""
        return replace(self, exposure=0.0)


def develop(image: npt.NDArray[np.float32], exposure: float) -> npt.NDArray[np.uint8]:
    """An 8-bit sRGB picture (h, w, 3) of a render (h, w, 4): exposed by stops, over a plain grey."""
    shown = image[..., :3] * np.float32(2.0**exposure) + (1 - image[..., 3:]) * np.float32(BACKDROP)
    # NaN becomes black: a picture with a fault in it beats none.
    index = np.sqrt(np.clip(np.nan_to_num(shown, nan=0.0), 0.0, 1.0)) * 4095.0 + 0.5
    return np.asarray(_CURVE[index.astype(np.int16)])


def metered_exposure(image: npt.NDArray[np.float32]) -> float:
    """Stops under which a white matt surface that faces the light best just reaches 1, as an incident meter sets it.

    Parameters
    ----------
    image : (h, 2 h, 3) radiance, conventions as in `prtcl.factors.environment`; the six axes are tried as normals
    """
    height, width = image.shape[:2]
    theta, phi = (np.arange(height) + 0.5) * np.pi / height, (np.arange(width) + 0.5) * 2 * np.pi / width
    solid = np.sin(theta) * (np.pi / height) * (2 * np.pi / width)
    grey = image.mean(axis=2, dtype=np.float64) * solid[:, None]
    up, across = np.cos(theta), np.sin(theta)
    best = max(
        float((grey * np.maximum(cosine, 0.0)).sum())
        for sign in (1.0, -1.0)
        for cosine in (
            sign * up[:, None], sign * np.outer(across, np.sin(phi)), sign * np.outer(across, np.cos(phi)),
        )
    )  # fmt: skip
    return round(math.log2(np.pi / best), 2) if best > 0.0 else 0.0


def linear_colour(picked: tuple[int, ...]) -> tuple[float, float, float]:
    """Linear colour of an 8-bit sRGB one."""
    red, green, blue = (float(v) for v in linear(np.clip(np.asarray(picked[:3]) / 255, 0.0, 1.0)))
    return red, green, blue


def picked_colour(colour: tuple[float, float, float]) -> tuple[int, int, int]:
    """8-bit sRGB of a linear colour."""
    red, green, blue = (round(255 * float(v)) for v in srgb(np.clip(colour, 0.0, 1.0)))
    return red, green, blue

"""The pinhole camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError

Triple = tuple[float, float, float]

MARGIN = 1.06
"""Room around the object when the camera frames it by itself."""


@dataclass(frozen=True)
class Camera:
    """A pinhole.

    Parameters
    ----------
    eye, target : world positions
    up : a direction that appears upwards
    fov : horizontal field of view in degrees
    size : width and height in pixels

    Raises
    ------
    InputError
        If eye and target coincide, `up` runs along the view, `fov` is not in (0, 180) or the size is not positive.
    """

    eye: Triple
    target: Triple
    up: Triple = (0.0, 1.0, 0.0)
    fov: float = 40.0
    size: tuple[int, int] = (512, 512)

    def __post_init__(self) -> None:
        _check(self.fov, self.size, eye=self.eye, target=self.target, up=self.up)
        forward = np.subtract(self.target, self.eye)
        if not np.linalg.norm(forward) > 0.0:
            raise InputError(f"eye and target are the same point {tuple(self.eye)}; move one")
        forward = forward / np.linalg.norm(forward)
        length = np.linalg.norm(self.up)
        if not length > 0.0 or np.linalg.norm(np.cross(forward, np.asarray(self.up) / length)) < 1e-6:
            raise InputError(f"up: {tuple(self.up)} is zero or runs along the view; choose another")

    @classmethod
    def framing(
        cls,
        bounds: npt.NDArray[np.float64],
        *,
        eye: Triple | None = None,
        target: Triple | None = None,
        up: Triple = (0.0, 1.0, 0.0),
        fov: float = 40.0,
        size: tuple[int, int] = (512, 512),
    ) -> Camera:
        """A camera that sees the whole bounding box; a given eye or target is kept.

        Without an eye it looks from the front right and somewhat above, as product shots do.
        """
        aim: Triple = tuple(bounds.mean(axis=0).tolist()) if target is None else target
        if eye is None:
            _check(fov, size, target=aim, up=up)
            vertical = np.asarray(up, dtype=np.float64) / max(float(np.linalg.norm(up)), 1e-300)
            side = np.array([0.0, 0.0, 1.0]) if abs(vertical[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
            towards = 0.5 * np.cross(vertical, side) + 0.4 * vertical + side
            towards = towards / np.linalg.norm(towards)
            across = np.cross(vertical, towards)
            across = across / max(float(np.linalg.norm(across)), 1e-300)
            # As near as lets every corner of the box project into the frame: depth · tan ≥ offset on both axes.
            corners = np.array(list(product(*bounds.T))) - aim
            tangent = math.tan(math.radians(fov) / 2) / MARGIN
            offsets = np.maximum(
                np.abs(corners @ across) / tangent,
                np.abs(corners @ np.cross(towards, across)) / (tangent * size[1] / size[0]),
            )
            eye = tuple((aim + float((offsets + corners @ towards).max()) * towards).tolist())
        return cls(eye, aim, up, fov, size)

    def rays(self, x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """World unit directions through image positions.

        Parameters
        ----------
        x, y : (n,) in pixels from the left and from the top; pixel (i, j) covers [j, j + 1) × [i, i + 1)

        Returns
        -------
        directions : (n, 3)
        """
        width, height = self.size
        forward = np.subtract(self.target, self.eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, self.up)
        right = right / np.linalg.norm(right)
        above = np.cross(right, forward)
        half = math.tan(math.radians(self.fov) / 2)
        across = (2 * x / width - 1) * half
        along = (1 - 2 * y / height) * half * height / width
        directions = forward + across[:, None] * right + along[:, None] * above
        return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


def _check(fov: float, size: tuple[int, int], **vectors: Triple) -> None:
    for name, given in vectors.items():
        value = np.asarray(given, dtype=np.float64)
        if value.shape != (3,) or not np.isfinite(value).all():
            raise InputError(f"{name}: expected three finite numbers, got {given}")
    if not 0.0 < fov < 180.0:
        raise InputError(f"fov: expected degrees between 0 and 180, got {fov:g}")
    if len(size) != 2 or min(size) < 1:
        raise InputError(f"size: expected WIDTHxHEIGHT of at least 1x1, got {size}")

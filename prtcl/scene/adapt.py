"""Points where they are needed: a film exposed, more points where its estimated error is largest, layers added up."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.points import shoot
from prtcl.scene.report import covered
from prtcl.scene.shaders import Layer

BATCH = 1 << 17
"""Sub-pixel points in flight: bounds the host's memory whatever the image's size."""
MOST, MOST_HARD = 1024, 4096
"""Points that an adaptive pixel may end with: 32 × 32 of soft light; 64 × 64 of hard light, whose glints on facets
smaller than a pixel vary most, and whose points cost least."""


class Exposure:
    """Exposes films to what a camera sees.

    Parameters
    ----------
    device : whose profile counts the time of the camera's rays
    """

    def __init__(self, device: Device, tracer: Tracer, camera: Camera) -> None:
        self.device, self.tracer, self.camera = device, tracer, camera

    def begin(self, layer: Layer, points: int) -> None:
        """The first points of all pixels."""
        self._expose(layer, np.arange(len(layer.film.pixels)), 0, points)

    def refine(self, layers: list[Layer], error: float) -> None:
        """Four times the points, again and again, where the estimated error is largest.

        Parameters
        ----------
        error : relative RMSE over the covered pixels, as estimated, that may be left
        """
        for reached in (4**k for k in range(1, 8)):
            active = [layer for layer in layers if reached < layer.most]
            if not active:
                return
            # The whole image's mean and the number of its pixels turn a relative error into a sum of squares.
            seen = covered(layers)
            mean = np.sum([layer.film.mean().mean(axis=1) for layer in layers], axis=0)
            allowed = (error * mean[seen].mean()) ** 2 * seen.sum() if seen.any() else 0.0
            for layer in active:
                pixels = layer.film.worst(allowed * layer.share)
                # A pixel that waited a round or more catches up round by round.
                pixels = pixels[layer.film.points[pixels] <= reached]
                for have in np.unique(layer.film.points[pixels]):
                    behind = pixels[layer.film.points[pixels] == have]
                    while have <= reached:
                        self._expose(layer, behind, int(have), 4 * int(have))
                        have *= 4

    def complete(self, layers: list[Layer]) -> None:
        """Points where a layer saw nothing of the mesh but the one with most points did: its colour would be missing.

        Layers share their places in the pixel, so with as many points it sees the mesh too. Few of them do.
        """
        seen, most = coverage(layers), np.max([layer.film.points for layer in layers], axis=0)
        for layer in layers:
            film = layer.film
            while (blind := np.flatnonzero((seen > 0) & (film.coverage() == 0) & (film.points < most))).size:
                self.advance(layer, blind)

    def advance(self, layer: Layer, pixels: npt.NDArray[np.int64]) -> None:
        """Four times the points of each of the pixels."""
        have = layer.film.points[pixels]
        for number in np.unique(have):
            self._expose(layer, pixels[have == number], int(number), 4 * int(number))

    def _expose(self, layer: Layer, pixels: npt.NDArray[np.int64], first: int, last: int) -> None:
        """Points first … last − 1 of each of the pixels."""
        film, each = layer.film, last - first
        step = max(1, BATCH // each)
        for start in range(0, len(pixels), step):
            some = pixels[start : start + step]
            sub = film.first + np.tile(np.arange(first, last), len(some))
            with self.device.profile.host("camera_rays"):
                hits = shoot(self.tracer, self.camera, np.repeat(film.pixels[some], each), sub)
            film.add(some, first, last, hits.ray, layer.shader(hits, sub[hits.ray]))


def coverage(layers: list[Layer]) -> npt.NDArray[np.float64]:
    """(pixels,) the coverage that the layer with most points saw."""
    most = np.argmax([layer.film.points for layer in layers], axis=0)
    return np.stack([layer.film.coverage() for layer in layers])[most, np.arange(len(most))]


def colours(layers: list[Layer]) -> npt.NDArray[np.float64]:
    """(pixels, 4) the layers' sum, with the coverage that most points saw.

    Each layer's mean over the points that saw the mesh, times that one coverage: with its own, which differs where
    it has other points, colour and alpha would not belong together and silhouettes would get fringes.
    """
    rgba = np.zeros((len(layers[0].film.pixels), 4))
    rgba[:, 3] = coverage(layers)
    for layer in layers:
        own = layer.film.coverage()
        # One where they agree, so that nothing is rounded then.
        scale = np.divide(rgba[:, 3], own, out=np.zeros_like(own), where=own > 0)
        rgba[:, :3] += layer.film.mean() * scale[:, None]
    return rgba

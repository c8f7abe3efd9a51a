"""A pilot: points of some of an image's pixels, shaded as the image's would be, against float64 and against each other.

Two questions. *Bias* is what stays however many points a pixel gets: the finite resolution of light and lobe, rays too
few, what hard light leaves. *Noise* is what more points take away. Both come from products of differences between
things that were sampled apart, in which what is random has mean zero: of two points of one pixel, each against `Truth`;
of two means of a pixel's points, each against those of other settings; of these two means against each other.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.scene.adapt import MOST_HARD, Exposure
from prtcl.scene.film import FIRST, Film
from prtcl.scene.points import Hits, pixel_points, shoot
from prtcl.scene.shaders import Counter, Layer, PixelShader
from prtcl.scene.tint import Rows
from prtcl.transport.pipeline import Pipelines, Points
from prtcl.transport.settings import Settings
from prtcl.transport.truth import Truth

if TYPE_CHECKING:
    from prtcl.scene.scene import Scene

Array = npt.NDArray[np.float64]

PIXELS, POINTS = 128, 8
"""Pixels at which bias is measured, and sub-pixel points of each."""
AMONG = 64
"""Points of a pixel that those are drawn from."""
SAMPLES = 512
"""Directions of the reference at each of them, at a time."""
NOISY = 16
"""Points of a pixel, twice, that noise is measured of."""
SEARCHED = 1 << 16
"""Pixels that are looked at for the mesh, at most."""


@dataclass(frozen=True)
class Squared:
    """A squared error over the square of the mean, and one standard error of that estimate."""

    value: float
    uncertain: float


@dataclass(frozen=True)
class Noise:
    """Of one part of the light.

    Attributes
    ----------
    squared : error of a mean of `NOISY` points, over the square of the mean of soft and hard light together
    seconds : of the wall that a point takes
    took : seconds that measuring it took
    halves : (2, pixels, 3) means of as many points, of points apart
    """

    squared: Squared
    seconds: float
    took: float
    halves: Array

    def gathered(self, rate: float) -> float:
        """Points that a picture takes whose pixels get them where the noise is, over those of all pixels alike.

        Where a pixel's squared error goes as v N^(-1/rate), the sum of points N is least for a given sum of errors
        if N ∝ v^p, p = rate / (1 + rate), and then ⟨v^p⟩^(1 + rate) / ⟨v⟩^rate of what it is with the same N for all.
        Of one difference a pixel v is known by its square alone, whose own spread (χ² of one degree) is taken off.
        """
        each = ((self.halves[0] - self.halves[1]) ** 2).mean(axis=1)
        power = rate / (1.0 + rate)
        mean = each.mean()
        alike = (2.0**power * math.gamma(power + 0.5) / math.sqrt(math.pi)) ** (1.0 + rate)
        found = (each**power).mean() ** (1.0 + rate) / mean**rate if mean > 0.0 else 1.0
        return float(min(found / alike, 1.0))


class Pilot:
    """A sample of what a camera sees.

    Parameters
    ----------
    pixels : of the sample, at most

    Attributes
    ----------
    covered : pixels of the whole image that see the mesh, about
    points : `POINTS` of each pixel of the sample, but those that miss the mesh
    truth : (n, 3) float64 radiance of the points, noisy and without bias
    sharpening : seconds that one `sharpen` takes
    """

    def __init__(self, scene: Scene, pixels: int = PIXELS) -> None:
        self.scene, self._rng = scene, np.random.default_rng(0)
        rng, (width, height) = self._rng, scene.camera.size
        looked = searched(scene, rng)
        found = self._found(looked)
        if len(found) < pixels and len(looked) < width * height:  # a mesh of few pixels
            looked = np.arange(width * height)
            found = self._found(looked)
        self.covered = len(found) / len(looked) * width * height
        self.pixels = np.sort(rng.choice(found, min(pixels, len(found)), replace=False))
        # Of each pixel others: neighbours in the sequence avoid each other, and the products of their errors would
        # come out negative.
        sub = np.argsort(rng.random((len(self.pixels), AMONG)), axis=1)[:, :POINTS].ravel()
        self.points, self._pixel, self._hits = self._seen(np.repeat(np.arange(len(self.pixels)), POINTS), sub)
        self.truth, self._runs = np.zeros((len(self.points), 3)), 0
        self.sharpen()

    def _found(self, looked: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Those of some pixels whose first points see the mesh."""
        every = np.tile(np.arange(FIRST), len(looked))
        hits = shoot(self.scene.tracer, self.scene.camera, np.repeat(looked, FIRST), every)
        return looked[np.unique(hits.ray // FIRST)]

    def _seen(
        self, pixel: npt.NDArray[np.int64], sub: npt.NDArray[np.int64]
    ) -> tuple[Points, npt.NDArray[np.int64], Hits]:
        """Points where some of the pixels' rays hit, and the pixel of each."""
        scene = self.scene
        hits = shoot(scene.tracer, scene.camera, self.pixels[pixel], sub)
        points = pixel_points(scene.mesh, scene.tracer, hits, sub[hits.ray], scene.two_sided)
        return scene.single_material(points), pixel[hits.ray], hits

    # --- bias -----------------------------------------------------------------------------------------------

    @cached_property
    def _truth(self) -> Truth:
        return Truth(self.scene.environment, self.scene.tracer, self.scene.tints.materials)

    def sharpen(self) -> None:
        """`SAMPLES` directions more at every point of `truth`."""
        start = time.perf_counter()
        more = self._true(self.points, self._hits, SAMPLES)
        self.truth += (more - self.truth) / (self._runs + 1)
        self._runs += 1
        self.sharpening = time.perf_counter() - start

    @property
    def mean(self) -> float:
        """Radiance of the covered pixels, about."""
        return float(self.truth.sum() / 3.0 / POINTS / len(self.pixels))

    def shade(self, pipelines: Pipelines) -> Array:
        """(n, 3) radiance of the pilot's points as rendered."""
        return self._tinted(
            lambda some, _: pipelines.radiance(self.scene.tracer, some), self.points, self._hits
        )

    def bias(self, radiance: Array) -> Squared:
        """What pixels err by in the limit of many points, where their points' radiance (n, 3) is that."""
        off = (radiance - self.truth) / self.mean
        count = np.bincount(self._pixel, minlength=len(self.pixels))
        sums, squares = (
            np.stack([np.bincount(self._pixel, part[:, c], len(self.pixels)) for c in range(3)])
            for part in (off, off**2)
        )
        two = count > 1
        # A pixel's mean is over all its points; those that miss the mesh are black, and right.
        share = (count[two] / POINTS) ** 2 / (count[two] * (count[two] - 1.0))
        return squared(((sums**2 - squares)[:, two] * share).mean(axis=0))

    def bias_beside(self, own: Noise, other: Noise) -> Squared:
        """The same of some settings, beside that of others, from the means of both."""
        off = (own.halves - other.halves) / self.mean
        return squared(off.prod(axis=0).mean(axis=1))

    def true_pixels(self, each: int, samples: int, first: int) -> Array:
        """(pixels, 3) means of `each` points from number `first` on, by `Truth` with `samples` directions each."""
        out, step = np.zeros((len(self.pixels), 3)), max(1, (1 << 15) // each)
        for start in range(0, len(self.pixels), step):
            pixel = np.repeat(np.arange(start, min(start + step, len(self.pixels))), each)
            sub = first + np.tile(np.arange(each), len(pixel) // each)
            points, of, hits = self._seen(pixel, sub)
            radiance = self._true(points, hits, samples)
            for channel in range(3):
                out[:, channel] += np.bincount(of, radiance[:, channel], len(out)) / each
        return out

    def _true(self, points: Points, hits: Hits, samples: int) -> Array:
        return self._tinted(lambda some, _: self._truth.radiance(some, samples, self._rng), points, hits)

    def _tinted(
        self, shade: Callable[[Points, Rows], npt.NDArray[np.floating]], points: Points, hits: Hits
    ) -> Array:
        mesh = self.scene.mesh
        radiance = self.scene.tints.radiance(
            shade, points, lambda at: mesh.base_colour(hits.face[at], hits.barycentric[at])
        )
        return np.asarray(radiance, dtype=np.float64)

    # --- noise ----------------------------------------------------------------------------------------------

    def noise(self, light: Callable[..., npt.NDArray[np.floating]]) -> Noise:
        """Of soft or hard light, `Pipelines.soft` or `Pipelines.hard`."""
        size, exposure = (
            self.scene.camera.size,
            Exposure(self.scene.device, self.scene.tracer, self.scene.camera),
        )
        films = [Film(size, self.pixels, half * MOST_HARD) for half in (0, 1)]
        few = self.points[: max(8, len(self.points) // 8)]
        light(self.scene.tracer, few)  # kernels built: they are no part of a point's time
        start = time.perf_counter()
        light(self.scene.tracer, few)
        idle = time.perf_counter() - start
        for film in films:
            exposure.begin(
                Layer(film, PixelShader(self.scene, light, Counter(None), "pilot"), NOISY, NOISY), NOISY
            )
        took = time.perf_counter() - start - idle
        halves = np.stack([film.mean() for film in films])
        apart = (halves[0] - halves[1]) / self.mean
        # A call costs more than its points, and an image's have more of them: what the first few took is taken off.
        each = max(took / 2.0 - idle, 0.1 * took) / max(NOISY * len(self.pixels) - len(few), 1)
        return Noise(squared((apart**2).mean(axis=1) / 2.0), each, took, halves)


def searched(scene: Scene, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Pixels in which the mesh is looked for: all, or `SEARCHED` of them, ascending."""
    count = scene.camera.size[0] * scene.camera.size[1]
    return np.arange(count) if count <= SEARCHED else np.sort(rng.choice(count, SEARCHED, replace=False))


def squared(each: Array) -> Squared:
    """The mean over pixels of what each estimates, and its standard error."""
    if len(each) < 2:
        return Squared(0.0, 0.0)
    return Squared(float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each))))


def told(known: Squared) -> float:
    """What is held against settings: what the reference cannot tell from nothing is not."""
    return known.value if known.value > 2.0 * known.uncertain else 0.0


def likely(known: Squared) -> float:
    """What is expected where an estimate may be noise: of a value v known to σ, v / (1 + (σ / v)²).

    As of a signal of which v² is the power and σ² the noise's.
    """
    value = max(known.value, 0.0)
    return value**3 / (value**2 + known.uncertain**2) if value > 0.0 else 0.0


def pipelines(scene: Scene, settings: list[Settings], device: Device | None = None) -> Pipelines:
    """As a render's; without a device on the first of the scene's."""
    return Pipelines(
        device or scene.device, scene.environment, scene.tints.materials,
        [settings[parent] for parent in scene.tints.parent], polar=scene.bake is None,
    )  # fmt: skip

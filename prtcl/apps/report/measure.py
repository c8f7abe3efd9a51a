"""What a report measures: every setting's error and time on a sample of pixels, and each factor's error by itself."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.errors import InputError
from prtcl.scene.adapt import MOST_HARD, Exposure, colours
from prtcl.scene.film import Film
from prtcl.scene.pilot import Pilot, pipelines
from prtcl.scene.points import check_eye
from prtcl.scene.scene import Scene
from prtcl.scene.shaders import Counter, Layer, PixelShader
from prtcl.transport.settings import Settings

Row = dict[str, Any]
Array = npt.NDArray[np.float64]

PIXELS = 160
"""Pixels of the sample."""
POINTS, DIRECTIONS = 512, 64
"""Of the reference: points of a pixel and directions of each point, twice."""
SAMPLES = (1, 2, 4, 8)
"""N × N points of a pixel that settings are tried with."""
SHIFTS, FINER = (-3, -2, -1, 0, 1), (-1, 0, 1)
"""Levels of rays and of directions beside the usual ones that are tried."""
FINEST = Settings(levels=7, rays=6, keep=7, views=512)
"""What each factor's own approximations are held against."""


class Sample:
    """Pixels of a scene's picture and what they should be.

    Attributes
    ----------
    halves : (2, pixels, 3) float64 radiance by importance sampling, twice; a picture's error is the root of the mean
        product of its differences from the two, in which their noise has mean zero

    Raises
    ------
    InputError
        If the camera sees nothing, or the picture is black.
    """

    def __init__(self, scene: Scene) -> None:
        check_eye(scene.tracer, scene.mesh, scene.camera)
        self.scene, self.pilot = scene, Pilot(scene, PIXELS)
        # Of other places in the pixel than a film's: where they are shared, what both err is not seen.
        self.halves = np.stack(
            [self.pilot.true_pixels(POINTS, DIRECTIONS, first) for first in (MOST_HARD, 2 * MOST_HARD)]
        )
        self.mean = float(self.halves.mean())
        if not self.mean > 0.0:
            raise InputError(
                "report: the picture is black, so that it has no relative error\n"
                "choose a light and materials that show something"
            )

    def error(self, radiance: Array) -> float:
        """Relative RMSE of (pixels, 3)."""
        off = (radiance - self.halves) / self.mean
        return float(np.sqrt(max(0.0, off.prod(axis=0).mean())))

    @property
    def noise(self) -> float:
        """Relative RMSE of the mean of the halves themselves."""
        return float(np.sqrt(((self.halves[0] - self.halves[1]) ** 2).mean()) / 2.0 / self.mean)


def settings(sample: Sample) -> Iterator[Row]:
    """A row for every setting: numbers of rays, levels of directions, points a pixel."""
    scene = sample.scene
    base = [own for own, _ in scene.choose_settings(False)]
    for shift in SHIFTS:
        for finer in FINER:
            own = [_moved(one, shift, finer) for one in base]
            if any(one is None for one in own):
                continue
            yield from _progressive(sample, [one for one in own if one is not None])


def _moved(one: Settings, shift: int, finer: int) -> Settings | None:
    """A material's settings with other rays and levels; None where they make no sense."""
    rays, levels = one.rays + shift, one.levels + finer
    if not 2 <= rays <= levels <= quadtree.MAX_LEVELS - 1:
        return None
    return replace(one, rays=rays, levels=levels, keep=min(max(one.keep + finer, 1), levels))


def _progressive(sample: Sample, own: list[Settings]) -> Iterator[Row]:
    """A row for every number of points, of one film that gets more and more."""
    scene, pilot = sample.scene, sample.pilot
    made = pipelines(scene, own)
    made.radiance(scene.tracer, pilot.points)  # kernels built, slices made
    exposure = Exposure(scene.device, scene.tracer, scene.camera)
    layers = [
        Layer(Film(scene.camera.size, pilot.pixels), PixelShader(scene, light, Counter(None), "report"), 1, 1)
        for light in (made.soft, made.hard)[: 1 + (len(made.light.hard) > 0)]
    ]
    seconds = 0.0
    for side in SAMPLES:
        start = time.perf_counter()
        for layer in layers:
            if side == SAMPLES[0]:
                exposure.begin(layer, side**2)
            else:
                exposure.advance(layer, np.arange(len(pilot.pixels)))
        seconds += time.perf_counter() - start
        yield {
            "levels": max(one.levels for one in own),
            "rays": max(one.rays for one in own),
            "samples": side,
            "error": sample.error(colours(layers)[:, :3]),
            "seconds": seconds / len(pilot.pixels) * pilot.covered,
            "bytes_per_point": sum(made.all[0].bytes_per_point().values()),
        }


def factors(sample: Sample) -> dict[str, list[Row]]:
    """What approximating one factor alone costs a point, the others being as fine as `FINEST`.

    Returns
    -------
    curves : light, visibility, reflectance and view, each rows of a number and the relative RMSE over points
        against the finest of that factor
    """
    scene, pilot = sample.scene, sample.pilot

    def shade(own: Settings) -> Array:
        return pilot.shade(pipelines(scene, [own] * len(scene.materials)))

    def curve(name: str, variants: dict[int, Settings], finest: Settings) -> list[Row]:
        wanted = shade(finest)
        return [
            {name: number, "error": float(np.sqrt(((shade(own) - wanted) ** 2).mean())) / sample.mean}
            for number, own in variants.items()
        ]

    coarse = replace(FINEST, rays=2)
    return {
        # Rays are no finer than the light: few of them, so that light alone differs.
        "light": curve(
            "levels", {n: replace(coarse, levels=n, keep=n) for n in range(2, FINEST.levels)}, coarse
        ),
        "visibility": curve("rays", {n: replace(FINEST, rays=n) for n in range(1, FINEST.rays)}, FINEST),
        "reflectance": curve("keep", {n: replace(FINEST, keep=n) for n in range(1, FINEST.keep)}, FINEST),
        "view": curve("views", {n: replace(FINEST, views=n) for n in (4, 8, 16, 32, 64, 128, 256)}, FINEST),
    }


def frontier(rows: list[Row]) -> list[Row]:
    """Rows that no other beats in both error and time, the fastest first."""
    best, out = np.inf, []
    for row in sorted(rows, key=lambda row: (row["seconds"], row["error"])):
        if row["error"] < best:
            best = row["error"]
            out.append(row)
    return out


def material(scene: Scene, error: float) -> tuple[Row, npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """All that is told of one material, its picture (h, w, 4) and the picture's error (h, w).

    Where nothing meets the error the picture is that of the usual settings, and `plan` says why under "refused".

    Raises
    ------
    InputError
        If the camera sees nothing, or the picture is black.
    """
    sample = Sample(scene)
    rows = list(settings(sample))
    curves = factors(sample)
    plan: Row = {"asked": error}
    start = time.perf_counter()
    try:
        render = scene.render(error=error)
    except InputError as refused:
        start, render = time.perf_counter(), scene.render()
        plan["refused"] = str(refused)
    plan["seconds"] = time.perf_counter() - start
    assert render.error is not None
    plan["found"] = sample.error(render.image.reshape(-1, 4)[sample.pilot.pixels, :3].astype(np.float64))
    if render.plan is not None:
        plan |= {
            "predicted": render.plan.predicted,
            "confidence": render.plan.confidence,
            "pilot_seconds": render.plan.pilot_seconds,
            "why": render.plan.explain(),
            "settings": [own.plain() for own in render.plan.settings],
        }
    told = {
        "material": ", ".join(dict.fromkeys(own.spec for own in scene.materials)),
        "reference_noise": sample.noise,
        "settings": rows,
        "frontier": frontier(rows),
        "factors": curves,
        "plan": plan,
        "render": render.report,
    }
    return told, render.image, render.error

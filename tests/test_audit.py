"""What audits find, of films whose error is known: by construction, and by rendering again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl.factors.sequence import stratified
from prtcl.scene.audit import MOVED, audit
from prtcl.scene.film import Film
from prtcl.scene.shaders import Layer

Array = NDArray[np.float64]
SIZE = (48, 40)


@dataclass
class Drawn:
    """Exposes a film to a function of the place in the pixel, in place of a scene."""

    value: Any
    asked: int = 0
    film: Film = field(default_factory=lambda: Film(SIZE))

    def begin(self, layer: Layer, points: int) -> None:
        self._expose(layer, layer.film.pixels, 0, points)

    def advance(self, layer: Layer, pixels: NDArray[np.int64]) -> None:
        have = layer.film.points[pixels]
        for number in np.unique(have):
            self._expose(layer, pixels[have == number], int(number), 4 * int(number))

    def _expose(self, layer: Layer, pixels: NDArray[np.int64], first: int, last: int) -> None:
        x, y = stratified(np.tile(np.arange(first, last), len(pixels)))
        radiance = self.value(np.repeat(pixels, last - first), x, y)
        self.asked += len(x)
        layer.film.add(pixels, first, last, np.arange(len(x)), np.repeat(radiance[:, None], 3, axis=1))


def begun(value: Any, points: int) -> tuple[Drawn, Layer]:
    drawn, layer = Drawn(value), Layer(Film(SIZE), None, 4, 1024)  # type: ignore[arg-type]
    drawn.begin(layer, points)
    return drawn, layer


@pytest.mark.parametrize("points", [4, 16])
def test_of_points_that_know_nothing_of_each_other(points: int) -> None:
    """Radiance is noise: a mean of n points errs by σ²/n, and moves by three quarters of that, which is 4/3 short."""
    rng = np.random.default_rng(0)
    drawn, layer = begun(lambda pixel, x, y: 5.0 + rng.normal(size=len(x)), points)
    found = audit(drawn, [layer], np.random.default_rng(1))  # type: ignore[arg-type]
    wanted = np.sqrt(1.0 / points) * np.sqrt(0.75 * MOVED)
    assert abs(found.error / wanted - 1.0) < 5 * 0.5 * found.uncertain / found.ratio
    assert found.uncertain < 0.3 * found.ratio


def test_of_a_smooth_pixel_the_estimate_is_far_too_large() -> None:
    """Of a ramp over the pixel a stratified mean errs by less than its points' variance says; an audit finds out."""
    slopes = np.random.default_rng(2).uniform(1.0, 3.0, SIZE[0] * SIZE[1])

    def ramp(pixel: NDArray[np.int64], x: Array, y: Array) -> Array:
        return np.asarray(10.0 + slopes[pixel] * (x + 0.5 * y - 0.75))

    drawn, layer = begun(ramp, 16)
    true = np.sqrt(((layer.film.mean()[:, 0] - 10.0) ** 2).mean())
    found = audit(drawn, [layer], np.random.default_rng(3))  # type: ignore[arg-type]
    assert found.ratio < 0.3
    assert 0.5 < found.error / true < 1.5


def test_few_pixels_are_drawn_and_few_expensive_ones() -> None:
    rng = np.random.default_rng(4)
    drawn, layer = begun(lambda pixel, x, y: 5.0 + rng.normal(size=len(x)), 4)
    dear = np.arange(0, SIZE[0] * SIZE[1], 10)
    for _ in range(3):
        drawn.advance(layer, dear)
    before = drawn.asked
    audit(drawn, [layer], np.random.default_rng(5))  # type: ignore[arg-type]
    drew = layer.film.points > np.where(np.isin(layer.film.pixels, dear), 256, 4)
    assert 120 <= drew.sum() <= 300
    assert drew[dear].mean() < drew.mean()
    assert drawn.asked > before


def test_a_picture_without_error_has_none() -> None:
    drawn, layer = begun(lambda pixel, x, y: np.full(len(x), 3.0), 4)
    found = audit(drawn, [layer], np.random.default_rng(6))  # type: ignore[arg-type]
    assert found.error == 0.0


def test_pixels_that_have_all_their_points_are_not_drawn() -> None:
    rng = np.random.default_rng(7)
    drawn, layer = begun(lambda pixel, x, y: 5.0 + rng.normal(size=len(x)), 1024)
    found = audit(drawn, [layer], np.random.default_rng(8))  # type: ignore[arg-type]
    assert (layer.film.points == 1024).all()
    assert found.ratio == 1.0
    # What they err is then what the film says, which is σ²/n.
    assert abs(found.error - np.sqrt(1.0 / 1024)) < 0.1 / 32


def test_pixels_beside_the_covered_ones_count() -> None:
    """Of an edge that covers a fifth of a pixel, four points may see nothing: the picture errs there all the same."""
    edge = 8
    width, height = SIZE
    drawn, film = Drawn(None), Film(SIZE)
    layer = Layer(film, None, 4, 1024)  # type: ignore[arg-type]

    def expose(own: Layer, pixels: NDArray[np.int64], first: int, last: int) -> None:
        x, _ = stratified(np.tile(np.arange(first, last), len(pixels)))
        column = np.repeat(pixels % width, last - first)
        # Its share differs from row to row, around the fifth.
        share = 0.2 + 0.1 * np.sin(np.repeat(pixels // width, last - first))
        hit = np.flatnonzero((column < edge) | ((column == edge) & (x < share)))
        own.film.add(pixels, first, last, hit, np.ones((len(hit), 3)))

    drawn._expose = expose  # type: ignore[method-assign]
    drawn.begin(layer, 4)
    covered = film.coverage() > 0
    wanted = np.where(film.pixels % width < edge, 1.0, 0.0)
    wanted[film.pixels % width == edge] = 0.2 + 0.1 * np.sin(np.arange(height))
    true = np.sqrt(((film.mean()[:, 0] - wanted) ** 2).sum() / covered.sum())
    found = audit(drawn, [layer], np.random.default_rng(9))  # type: ignore[arg-type]
    assert 0.5 < found.error / true < 2.0

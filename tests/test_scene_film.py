"""Sub-pixel points gathered into pixels: averages, coverage, the error estimate, and the choice of what to refine."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from prtcl.factors.sequence import stratified
from prtcl.scene.film import FIRST, Film

Array = NDArray[np.float64]
Picture = Callable[[Array, Array], Array]
"""Grey radiance at image positions x, y in pixels; NaN where nothing is seen."""


def expose(
    film: Film, picture: Picture, first: int, last: int, pixels: NDArray[np.int64] | None = None
) -> None:
    """Points first … last − 1 of some pixels (default: all) of a picture that is known everywhere."""
    some = np.arange(film.width * film.height) if pixels is None else pixels
    pixel, sub = np.repeat(some, last - first), np.tile(np.arange(first, last), len(some))
    dx, dy = stratified(sub)
    values = picture(pixel % film.width + dx, pixel // film.width + dy)
    hit = np.nonzero(~np.isnan(values))[0]
    film.add(some, first, last, hit, np.repeat(values[hit, None], 3, axis=1))


def exposed(picture: Picture, size: tuple[int, int], rounds: int) -> Film:
    """All pixels with 4, 16, 64 … points: as adaptive sampling adds them."""
    film = Film(size)
    have = 0
    for k in range(rounds):
        expose(film, picture, have, FIRST * 4**k)
        have = FIRST * 4**k
    return film


# --- averages ------------------------------------------------------------------------------------------------


def test_a_pixel_is_the_mean_of_its_points() -> None:
    film = Film((3, 2))
    values = np.arange(24.0 * 3).reshape(24, 3)
    film.add(np.arange(6), 0, 4, np.arange(24), values)
    assert (film.points == 4).all() and (film.coverage() == 1).all()
    assert (film.mean() == values.reshape(6, 4, 3).mean(axis=1)).all()


def test_points_added_later_weigh_like_the_first() -> None:
    film = Film((2, 1))
    rng = np.random.default_rng(1)
    values = rng.integers(0, 100, (2, 16, 3)).astype(np.float64)
    film.add(np.array([0, 1]), 0, 4, np.arange(8), values[:, :4].reshape(-1, 3))
    film.add(np.array([1]), 4, 16, np.arange(12), values[1, 4:])
    assert film.points.tolist() == [4, 16]
    assert (film.mean() == [values[0, :4].mean(axis=0), values[1].mean(axis=0)]).all()


def test_points_that_miss_are_black_and_transparent() -> None:
    """Colour is premultiplied: half a pixel of radiance 2 is colour 1, coverage one half."""
    film = Film((2, 2))
    film.add(np.array([1, 3]), 0, 4, np.array([0, 2, 4, 5, 6]), np.full((5, 3), 2.0))
    assert film.coverage().tolist() == [0, 0.5, 0, 0.75]
    assert film.mean()[:, 0].tolist() == [0, 1, 0, 1.5]


def test_a_film_without_points_is_black_not_nan() -> None:
    film = Film((2, 2))
    assert not film.mean().any() and not film.coverage().any() and not film.variance().any()
    film.add(np.arange(4), 0, 4, np.empty(0, np.int64), np.empty((0, 3)))
    assert not film.mean().any() and not film.coverage().any() and film.worst(0.0).size == 0


def test_box_average_of_a_ramp_is_its_value_at_the_centre() -> None:
    """To within the points' own shift, a tenth of a stratum: slope · 0.1/side."""
    for rounds, side in ((1, 2), (2, 4), (3, 8)):
        film = exposed(lambda x, y: 5 + 3 * x - 2 * y, (6, 5), rounds)
        i, j = np.mgrid[:5, :6]
        expected = 5 + 3 * (j + 0.5) - 2 * (i + 0.5)
        assert np.abs(film.mean()[:, 0].reshape(5, 6) - expected).max() <= (3 + 2) * 0.1 / side


# --- the error estimate ---------------------------------------------------------------------------------------


def edge(nx: float, ny: float, at: float) -> Picture:
    return lambda x, y: np.where(nx * x + ny * y < at, 3.0, 1.0)


def exact_edge(nx: float, ny: float, at: float, size: tuple[int, int]) -> Array:
    """Box averages by 128 × 128 points a pixel: good to 2 / 128 / √128 of the step or so, 1e-3."""
    fine = (np.arange(128) + 0.5) / 128
    x = np.arange(size[0])[:, None] + fine
    y = np.arange(size[1])[:, None] + fine
    values = edge(nx, ny, at)(x.reshape(1, -1), y.reshape(-1, 1))
    return np.asarray(values.reshape(size[1], 128, size[0], 128).mean(axis=(1, 3)).ravel())


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_the_estimate_bounds_the_error_of_edges(rounds: int) -> None:
    """Summed over an image's worth of edges of any direction, as `worst` uses it; and it is not absurdly safe."""
    rng = np.random.default_rng(5)
    estimated = true = 0.0
    size = (12, 10)
    for _ in range(40):
        angle, at = rng.uniform(0, 2 * np.pi), rng.uniform(-2, 2)
        nx, ny = np.cos(angle), np.sin(angle)
        at += nx * 6 + ny * 5
        film = exposed(edge(nx, ny, at), size, rounds)
        estimated += film.variance().sum()
        true += ((film.mean()[:, 0] - exact_edge(nx, ny, at, size)) ** 2).sum()
    print(f"estimate/true {estimated / true:.2f}")
    assert true > 0 and 1.0 < estimated / true < 30.0


@pytest.mark.parametrize("rounds", [1, 2, 3, 4])
def test_the_estimate_bounds_the_error_of_a_ramp_in_every_pixel(rounds: int) -> None:
    film = exposed(lambda x, y: 5 + 3 * x - 2 * y, (6, 5), rounds)
    i, j = np.mgrid[:5, :6]
    error = film.mean()[:, 0] - (5 + 3 * (j + 0.5) - 2 * (i + 0.5)).ravel()
    assert (error**2 <= film.variance()).all() and np.abs(error).max() > 0


@pytest.mark.parametrize("rounds,blocks", [(2, 4), (3, 16), (4, 64)])
def test_the_estimate_knows_that_points_are_stratified(rounds: int, blocks: int) -> None:
    """A ramp varies within a block of the pixel by 1/blocks of its variance over the whole pixel."""
    film = exposed(lambda x, y: 5 + 3 * x - 2 * y, (6, 5), rounds)
    plain = (3**2 + 2**2) / 12 / (4 * blocks)  # variance over the pixel, over the number of points
    ratio = film.variance() * blocks / plain
    print(f"variance within blocks over that of the ramp {ratio.min():.3f} … {ratio.max():.3f}")
    assert ((ratio > 0.5) & (ratio < 2.0)).all()


def test_numbers_of_points_that_are_no_power_of_four_still_have_an_estimate() -> None:
    film = Film((4, 4))
    expose(film, lambda x, y: x, 0, 9)
    assert film.variance().max() == pytest.approx(1 / 12 / 9, rel=0.5)
    single = Film((4, 4))
    expose(single, lambda x, y: x, 0, 1)
    assert not single.variance().any()  # one point says nothing of its own error


def test_a_constant_picture_needs_no_points() -> None:
    film = exposed(lambda x, y: np.full(x.shape, 2.5), (5, 4), 1)
    assert not film.variance().any() and film.worst(0.0).size == 0


def test_neighbours_of_an_edge_are_doubted_a_quarter_as_much() -> None:
    film = exposed(edge(1.0, 0.0, 4.5), (9, 3), 1)
    variance = film.variance().reshape(3, 9)
    assert (variance[:, 4] > 0).all()
    assert (variance[:, [3, 5]] == variance[:, [4]] / 4).all()
    assert not variance[:, :3].any() and not variance[:, 6:].any()


def test_coverage_edges_count_as_errors_too() -> None:
    film = exposed(lambda x, y: np.where(x < 4.5, 3.0, np.nan), (9, 3), 1)
    assert (film.variance().reshape(3, 9)[:, 4] > 0).all()


# --- what to refine ------------------------------------------------------------------------------------------


def test_the_largest_estimates_are_refined_first() -> None:
    """Edges of height 8, 2 and 0: as less error is allowed, the strong edge goes first, then the weak one."""

    def picture(x: Array, y: Array) -> Array:
        return 1 + 8.0 * (x > 3.4) + 2.0 * (x > 10.4)

    film = exposed(picture, (16, 1), 1)
    variance = film.variance()
    strong, weak = variance[3], variance[10]
    assert strong == 16 * weak > 0
    assert film.worst(2 * strong).size == 0
    first = film.worst(0.4 * strong + 2 * weak)
    assert 3 in first and 10 not in first
    both = film.worst(0.5 * weak)
    assert {2, 3, 4, 10} <= set(both.tolist()) and not {0, 6, 7, 13, 15} & set(both.tolist())


@given(
    values=st.lists(st.floats(0, 10) | st.sampled_from([0.0, 1.0]), min_size=1, max_size=12),
    allowed=st.floats(0, 30),
)
def test_worst_is_the_fewest_pixels_that_suffice(values: list[float], allowed: float) -> None:
    film = Film((len(values), 1))
    variance = np.array(values)
    film.variance = lambda: variance  # type: ignore[method-assign]
    chosen = film.worst(allowed)
    rest = np.setdiff1d(np.arange(len(values)), chosen)
    slack = 1e-12 * (variance.sum() + 1)
    assert variance[rest].sum() <= allowed + slack
    if chosen.size:
        # No set that is smaller by one leaves less than the largest ones do.
        descending = np.sort(variance)[::-1]
        assert descending[chosen.size - 1 :].sum() > allowed - slack
        assert rest.size == 0 or variance[chosen].min() >= variance[rest].max()
    assert (np.diff(chosen) > 0).all()


def test_refining_the_worst_meets_what_was_allowed() -> None:
    size = (24, 18)
    film = exposed(edge(0.8, 0.6, 14.0), size, 1)
    allowed = film.variance().sum() / 20
    have = 4
    while (pixels := film.worst(allowed)).size and have < 4096:
        ready = pixels[film.points[pixels] == have]
        expose(film, edge(0.8, 0.6, 14.0), have, 4 * have, ready)
        have *= 4
    error = film.mean()[:, 0] - exact_edge(0.8, 0.6, 14.0, size)
    assert (error**2).sum() <= allowed
    assert (film.points == 4).mean() > 0.5 and film.points.max() >= 64

"""Where samples, squares and coefficients lie: bijections, and agreement with the plain definition."""

from __future__ import annotations

import numpy as np
import pytest

from prtcl import quadtree
from prtcl.compute.device import Device

LEVELS = range(0, 8)


@pytest.mark.parametrize("levels", LEVELS)
def test_counts(levels: int) -> None:
    assert quadtree.n_samples(levels) == 4**levels
    assert quadtree.n_squares(levels) == sum(4**r for r in range(levels))
    assert quadtree.levels_of(4**levels) == levels


@pytest.mark.parametrize("count", [0, -4, 2, 3, 8, 32, 63, 65, 2**13])
def test_levels_of_refuses_other_counts(count: int) -> None:
    with pytest.raises(ValueError, match="power of four"):
        quadtree.levels_of(count)


@pytest.mark.parametrize("levels", LEVELS)
def test_morton_order_is_a_bijection_of_the_grid(levels: int) -> None:
    side = 2**levels
    rows, columns = quadtree.morton_to_grid(levels)
    assert set(zip(rows.tolist(), columns.tolist(), strict=True)) == {
        (r, c) for r in range(side) for c in range(side)
    }
    index = quadtree.grid_to_morton(levels)
    assert index.shape == (side, side)
    assert (index[rows, columns] == np.arange(4**levels)).all()


def test_morton_order_by_hand() -> None:
    assert quadtree.grid_to_morton(2).tolist() == [
        [0, 1, 4, 5],
        [2, 3, 6, 7],
        [8, 9, 12, 13],
        [10, 11, 14, 15],
    ]


@pytest.mark.parametrize("levels", [3, 5])
def test_every_square_is_one_contiguous_run(levels: int) -> None:
    index = quadtree.grid_to_morton(levels)
    for level in range(levels + 1):
        side = 2 ** (levels - level)
        run = 4 ** (levels - level)
        rows, columns = quadtree.morton_to_grid(level)
        for s, (row, column) in enumerate(zip(rows, columns, strict=True)):
            block = index[row * side : (row + 1) * side, column * side : (column + 1) * side]
            assert sorted(block.ravel().tolist()) == list(range(s * run, (s + 1) * run))


@pytest.mark.parametrize("levels", [1, 2, 4])
def test_coefficients_fill_every_place_once(levels: int) -> None:
    places = [0] + [
        quadtree.coefficient(r, s, m) for r in range(levels) for s in range(4**r) for m in (1, 2, 3)
    ]
    assert places == list(range(4**levels))
    squares = [quadtree.square(r, s) for r in range(levels) for s in range(4**r)]
    assert squares == list(range(quadtree.n_squares(levels)))


def test_signs_by_hand() -> None:
    # columns (01), rows (10), both (11); children in the order 00, 01, 10, 11 of row and column bit
    assert quadtree.SIGNS.tolist() == [[1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]]


@pytest.mark.parametrize(("levels", "words"), [(0, 1), (1, 1), (2, 1), (3, 2), (4, 8), (5, 32), (7, 512)])
def test_visibility_words(levels: int, words: int) -> None:
    assert quadtree.visibility_words(levels) == words


def test_device_twin(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """square_at, coefficient_at and butterfly of kernels/quadtree.clh against prtcl/quadtree.py."""
    import prtcl.compute.device as module
    from prtcl.compute.source import expand

    levels = 6
    source = (
        expand("common.clh")
        + expand("quadtree.clh")
        + """
    kernel void twin(global int *at, global REAL *signs, const int n)
    {
        const int i = get_global_id(0);
        if (i >= n)
            return;
        int level = 0;
        while (i >= N_SQUARES(level + 1))
            ++level;
        const int index = i - N_SQUARES(level);
        at[4 * i] = level;
        at[4 * i + 1] = index;
        at[4 * i + 2] = square_at(level, index);
        at[4 * i + 3] = coefficient_at(level, index);
        if (i < 4) {
            const ACC4 y = butterfly((ACC4)(i == 0, i == 1, i == 2, i == 3));
            signs[4 * i] = y.s0;
            signs[4 * i + 1] = y.s1;
            signs[4 * i + 2] = y.s2;
            signs[4 * i + 3] = y.s3;
        }
    }
    """
    )
    monkeypatch.setattr(module, "expand", lambda name: source)
    kernel = device.kernels("test_quadtree_twin.cl")["twin"]
    n = quadtree.n_squares(levels)
    at, signs = device.array(np.full((n, 4), -1), np.int32), device.array(np.full((4, 4), np.nan))
    device.launch(kernel, n, 64, at, signs, n)
    expected = [
        (r, s, quadtree.square(r, s), quadtree.coefficient(r, s, 1))
        for r in range(levels)
        for s in range(4**r)
    ]
    assert at.get().tolist() == [list(row) for row in expected]
    assert (np.vstack([np.ones(4), quadtree.SIGNS]) == signs.get().T).all()

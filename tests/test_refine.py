"""Fewer rays for visibility: what is found of known shapes, and against every ray on a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from prtcl import quadtree
from prtcl.apps.demo_scene import build
from prtcl.errors import InputError
from prtcl.factors import refine
from prtcl.factors.visibility import RayCount, Tracer
from prtcl.scene.points import vertex_points
from prtcl.transport.settings import Settings


def run(truth: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], int]:
    """Visibility (points, side, side) found, and the rays that took."""
    points, side, _ = truth.shape
    levels = side.bit_length() - 1
    rows, columns = quadtree.morton_to_grid(levels)
    asked = np.zeros(truth.shape, dtype=int)

    def visible(point: NDArray[np.intp], sample: NDArray[np.intp]) -> NDArray[np.bool_]:
        np.add.at(asked, (point, rows[sample], columns[sample]), 1)
        return truth[point, rows[sample], columns[sample]]

    found = np.empty_like(truth)
    found[:, rows, columns] = refine.visibility(points, levels, visible)
    assert asked.max() == 1, "no ray is traced twice"
    assert (found[asked > 0] == truth[asked > 0]).all(), "what is traced is kept"
    return found, int(asked.sum())


@pytest.mark.parametrize("levels", [0, 1, 3, 5, 6, 7])
@pytest.mark.parametrize("value", [False, True])
def test_all_open_and_all_hidden_take_a_ray_a_block(levels: int, value: bool) -> None:
    side = 1 << levels
    found, rays = run(np.full((2, side, side), value))
    assert (found == value).all()
    assert rays / 2 == (side // max(1, min(8, side // 8))) ** 2


@given(levels=st.integers(5, 6), angle=st.floats(0, 6.3), offset=st.floats(-1.2, 1.2))
def test_a_straight_edge_is_found_to_the_cell(levels: int, angle: float, offset: float) -> None:
    """But for a corner of the border smaller than a block."""
    side = 1 << levels
    x = (np.arange(side) + 0.5) * 2 / side - 1
    truth = (np.cos(angle) * x[:, None] + np.sin(angle) * x[None, :] > offset)[None]
    found, rays = run(truth)
    assert (found != truth).sum() <= (side // 8) ** 2 / 2
    assert rays < 0.5 * truth.size


@given(st.integers(0, 1000))
def test_what_is_larger_than_two_blocks_is_found(seed: int) -> None:
    """Hidden disks; where one leaves a gap or another a sliver some cells may be missed."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:64, :64]
    truth = np.ones((1, 64, 64), dtype=bool)
    cx, cy, radius = rng.uniform(0, 64), rng.uniform(0, 64), rng.uniform(12, 20)
    truth[0] &= (x - cx) ** 2 + (y - cy) ** 2 > radius**2
    assert (run(truth)[0] != truth).mean() < 0.001


@pytest.mark.parametrize("at", [(3, 5), (40, 61), (33, 31)])
def test_what_is_smaller_than_a_block_may_be_missed(at: tuple[int, int]) -> None:
    """One hidden cell that is no block's own: the price."""
    truth = np.ones((1, 64, 64), dtype=bool)
    truth[0, at[0], at[1]] = False
    found, rays = run(truth)
    assert found.all()
    assert rays == 64


@pytest.mark.parametrize("levels", [5, 6])
def test_against_every_ray_on_a_mesh(levels: int) -> None:
    mesh = build()
    tracer = Tracer(mesh.vertices, mesh.faces)
    points = vertex_points(mesh, tracer, only=np.arange(0, len(mesh.vertices), 101))
    all_rays, own = RayCount(), RayCount()
    every = tracer.visibility(points.origins, points.frames, levels, every=True, traced=all_rays)
    some = tracer.visibility(points.origins, points.frames, levels, traced=own)
    wrong = np.unpackbits((every ^ some).view(np.uint8)).mean()
    assert all_rays.rays == len(points) * 4**levels and tracer.rays == all_rays.rays + own.rays
    assert all_rays.rays / own.rays > (2.5 if levels == 5 else 4.0)
    assert wrong < 0.001


def test_few_cells_are_all_traced() -> None:
    mesh = build()
    tracer = Tracer(mesh.vertices, mesh.faces)
    points = vertex_points(mesh, tracer, only=np.arange(9))
    tracer.visibility(points.origins, points.frames, refine.FROM - 1)
    assert tracer.rays == 9 * 4 ** (refine.FROM - 1)


def test_the_setting_is_checked() -> None:
    with pytest.raises(InputError, match="visibility: expected one of adaptive, every, got 'some'"):
        Settings(visibility="some")

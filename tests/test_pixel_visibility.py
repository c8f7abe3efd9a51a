"""Visibility of pixels over the shared grid, and of hard light from the points in turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prtcl.errors import InputError
from prtcl.factors import sphere
from prtcl.factors.environment import Environment
from prtcl.factors.hard_groups import PROBES, HardGroups
from prtcl.factors.pixel_visibility import HardRays, Pixels, cell_turns, hard_visibility, soft_visibility
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.view_points import ViewPoints

CAMERA = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(24, 18))


def bits_of(words: np.ndarray) -> np.ndarray:
    return np.unpackbits(words.view(np.uint8), axis=1, bitorder="little").astype(bool)


def test_pixels_are_runs_of_points() -> None:
    pixels = Pixels.of([7, 7, 7, 2, 9, 9])
    assert pixels.first.tolist() == [0, 3, 4, 6]
    turns = pixels.point(np.zeros(6, dtype=int), np.arange(6))
    assert sorted(turns[:3].tolist()) == [0, 1, 2] and (turns[:3] == turns[3:]).all()
    alone = Pixels.of([9, 9])
    assert alone.phase[0] == pixels.phase[2], "a pixel's turns must not depend on the other pixels"


@pytest.mark.parametrize(("pixel", "words"), [([], "at least one"), ([1, 2, 1], "stand together")])
def test_scattered_points_are_refused(pixel: list[int], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Pixels.of(pixel)


def test_any_square_of_cells_takes_all_points() -> None:
    for size in (4, 16):
        turns = cell_turns(np.arange(sphere.n_cells(5))).reshape(-1, size) % size
        assert (np.sort(turns, axis=1) == np.arange(size)).all()
    # Where the rays of `refine` begin: one corner of every block of 4 x 4 cells.
    assert len(np.unique(cell_turns(np.arange(5, sphere.n_cells(5), 16)) % 16)) == 16


def test_soft_bits_are_rays(mesh: Mesh) -> None:
    """Every bit that `every` traces is one ray of the point whose turn it is; the adaptive ones hardly differ."""
    tracer = Tracer(mesh.vertices, mesh.faces)
    view = ViewPoints.of(mesh, tracer, CAMERA, 2)
    pixels, origins, normals = Pixels.of(view.pixel), view.points.origins, view.points.frames[:, 2]
    every = bits_of(soft_visibility(tracer, origins, normals, pixels, 5, every=True))
    cells = np.arange(sphere.n_cells(5))
    table = sphere.places(5, 16)
    for pixel in range(0, len(pixels), 29):
        point = pixels.point(np.full(len(cells), pixel), cell_turns(cells))
        towards = table[(pixels.phase[pixel] >> 4) % 16]
        above = (normals[point] * towards).sum(axis=1) > 0
        expected = above & ~tracer.occluded(origins[point], towards)
        assert (every[pixel] == expected).mean() > 0.999  # a horizon may round the other way
    rays = tracer.rays
    adaptive = bits_of(soft_visibility(tracer, origins, normals, pixels, 5))
    assert tracer.rays - rays < 0.7 * above.mean() * len(pixels) * len(cells)
    assert (adaptive == every).mean() > 0.99


def test_hard_light_is_seen_as_each_ray_sees_it(mesh: Mesh, sky: Environment) -> None:
    tracer = Tracer(mesh.vertices, mesh.faces)
    view = ViewPoints.of(mesh, tracer, CAMERA, 2)
    pixels, origins, normals = Pixels.of(view.pixel), view.points.origins, view.points.frames[:, 2]
    groups = HardGroups.of(sky.split(5))
    count = len(groups.samples)
    hard = HardRays(
        groups.samples[:, :3].astype(np.float32),
        np.arange(count, dtype=np.int32),
        groups.begin,
        groups.traced,
        PROBES,
    )
    assert groups.traced.any() and count > PROBES
    got = bits_of(hard_visibility(tracer, origins, normals, pixels, hard))[:, :count]
    group = np.repeat(np.arange(len(groups.traced)), np.diff(groups.begin))
    lit = []
    for light in np.flatnonzero(groups.traced[group]):
        point = pixels.point(np.arange(len(pixels)), np.full(len(pixels), light))
        towards = np.broadcast_to(hard.lights[light], (len(point), 3))
        above = (normals[point] * towards).sum(axis=1) > 1e-6
        seen = ~tracer.occluded(origins[point], np.ascontiguousarray(towards))
        lit.append(seen[above].mean())
        assert (got[above, light] == seen[above]).mean() > 0.99
        # A probe's answer is its own ray's, without exception.
        if light - groups.begin[group[light]] < PROBES:
            assert (got[above, light] == seen[above]).all()
    assert 0.05 < np.mean(lit) < 0.95, "MISTRUSTED: no shadow in sight"
    untraced = replace(hard, traced=np.zeros_like(hard.traced))
    assert not hard_visibility(tracer, origins, normals, pixels, untraced).any()


def test_groups_keep_the_energy_and_turn_with_the_light(sky: Environment) -> None:
    light = sky.split(5)
    groups = HardGroups.of(light)
    assert np.allclose(groups.samples[:, 3:].sum(axis=0), light.hard[:, 3:].sum(axis=0), rtol=1e-12)
    for start, end in zip(groups.begin[:-1], groups.begin[1:], strict=True):
        own = groups.samples[start:end, :3]
        assert np.ptp(own, axis=0).max() < 0.04
    turned = HardGroups.of(replace(sky, rotate=77.0).split(5))
    assert (turned.begin == groups.begin).all()
    assert np.allclose(turned.samples[:, 3:], groups.samples[:, 3:])


def test_no_hard_light_makes_no_groups() -> None:
    groups = HardGroups.of(Environment.constant().split(4))
    assert groups.samples.shape == (0, 6) and groups.begin.tolist() == [0] and not len(groups.traced)

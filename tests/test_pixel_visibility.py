"""Visibility of pixels over the shared grid, and of hard light from the points in turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prtcl.errors import InputError
from prtcl.factors import sphere
from prtcl.factors.environment import Environment, Light
from prtcl.factors.hard_groups import EXTENT, PROBES, HardGroups
from prtcl.factors.pixel_visibility import (
    AXES,
    HardRays,
    Pixels,
    cell_turns,
    hard_visibility,
    outermost,
    soft_visibility,
)
from prtcl.factors.sequence import stratified
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


def rays_of(groups: HardGroups) -> HardRays:
    """As `prtcl.transport.light_columns` makes them of one environment."""
    return HardRays(
        groups.samples[:, :3].astype(np.float32), np.arange(len(groups.samples), dtype=np.int32), groups.begin,
        groups.traced, groups.probes.astype(np.float32), groups.outwards.astype(np.float32),
    )  # fmt: skip


def test_hard_light_is_seen_as_each_ray_sees_it(mesh: Mesh, sky: Environment) -> None:
    tracer = Tracer(mesh.vertices, mesh.faces)
    view = ViewPoints.of(mesh, tracer, CAMERA, 2)
    pixels, origins, normals = Pixels.of(view.pixel), view.points.origins, view.points.frames[:, 2]
    hard = rays_of(HardGroups.of(sky.split(5)))
    count = len(hard.lights)
    assert hard.traced.any() and count > PROBES
    got = bits_of(hard_visibility(tracer, origins, normals, pixels, hard))[:, :count]
    group = np.repeat(np.arange(len(hard.traced)), np.diff(hard.begin))
    ours = np.flatnonzero(hard.traced[group])
    lit = []
    for light in ours:
        point = pixels.point(np.arange(len(pixels)), np.full(len(pixels), light))
        towards = np.broadcast_to(hard.lights[light], (len(point), 3))
        above = (normals[point] * towards).sum(axis=1) > 1e-6
        seen = ~tracer.occluded(origins[point], np.ascontiguousarray(towards))
        lit.append(seen[above].mean())
        assert (got[above, light] == seen[above]).mean() > 0.99
    assert 0.05 < np.mean(lit) < 0.95, "MISTRUSTED: no shadow in sight"
    untraced = replace(hard, traced=np.zeros_like(hard.traced))
    assert not hard_visibility(tracer, origins, normals, pixels, untraced).any()


def test_outermost_points_are_each_pixels_own(mesh: Mesh) -> None:
    view = ViewPoints.of(mesh, Tracer(mesh.vertices, mesh.faces), CAMERA, 3)
    pixels, origins = Pixels.of(view.pixel), view.points.origins
    corners = outermost(origins, pixels)
    for pixel in range(0, len(pixels), 17):
        own = slice(pixels.first[pixel], pixels.first[pixel + 1])
        along = origins[own] @ AXES.T
        assert (corners[pixel] == own.start + np.argmax(along, axis=0)).all()
    whole = np.flatnonzero(np.diff(pixels.first) == 9)
    assert max(len(np.unique(corners[pixel])) for pixel in whole) >= 6


SUN = 0.5
"""Degrees from the middle of the light to its rim."""
SAMPLES = 120


def disc(rng: np.random.Generator, count: int) -> np.ndarray:
    """Directions (count, 3) of a sun at an elevation of 64 degrees, spread evenly."""
    middle = np.array([0.3, 0.9, -0.2]) / np.linalg.norm([0.3, 0.9, -0.2])
    radius, turn = np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    across = np.linalg.svd(middle[None])[2][1:]
    offset = np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
    out = middle + np.radians(SUN) * radius[:, None] * offset
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


def sun_rays(directions: np.ndarray, to_map: np.ndarray) -> HardRays:
    """One group of equal samples, two pairs of each."""
    hard = np.concatenate([directions @ to_map, np.full((len(directions), 3), 1 / len(directions))], axis=1)
    groups = HardGroups.of(Light(np.zeros((6, 3, 3, 4), np.float32), hard, to_map, 5, 1.0))
    assert groups.begin.tolist() == [0, 2 * len(directions)] and groups.traced.all()
    return rays_of(groups)


class Edge:
    """One square pixel on a floor, and above it a half-plane whose edge has a direction and a place.

    Parameters
    ----------
    size : of the pixel; height : of the half-plane above it
    angle : of the edge's normal; at : how far it is shifted along it from the line between pixel and sun
    """

    def __init__(self, size: float, height: float, angle: float, at: float) -> None:
        self.size, self.height = size, height
        self.n = np.array([np.cos(angle), 0, np.sin(angle)])
        along = np.array([-np.sin(angle), 0, np.cos(angle)])
        edge = np.array([0.3, 0.9, -0.2]) / 0.9 * height + at * self.n
        self.offset = float(edge @ self.n)
        corners = [edge + a * along + b * self.n for a, b in ((-50, 0), (50, 0), (50, 50), (-50, 50))]
        self.tracer = Tracer(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]], np.int32))
        x, y = stratified(np.arange(64))
        places = size * np.stack([x - 0.5, np.zeros(64), y - 0.5], axis=1)
        self.normals, self.pixels = np.tile(np.array([0, 1, 0], np.float32), (64, 1)), Pixels.of(np.zeros(64))
        self.origins = self.tracer.origins(places, self.normals)

    def seen(self, rays: HardRays) -> float:
        """The share of a light's pairs that `hard_visibility` sees."""
        bits = bits_of(hard_visibility(self.tracer, self.origins, self.normals, self.pixels, rays))
        return float(bits[0, : len(rays.lights)].mean())

    def each(self, rays: HardRays) -> float:
        """The same by a ray for every pair."""
        point = self.pixels.point(np.zeros(len(rays.lights), int), rays.turns)
        return float(1 - self.tracer.occluded(self.origins[point], rays.lights).mean())

    def exact(self, directions: np.ndarray, places: np.ndarray) -> float:
        """The share of pairs of a direction and a place in the unit square that pass the edge, all with all."""
        reach = directions @ self.n / directions[:, 1] * self.height
        start = self.size * (places - 0.5) @ self.n[[0, 2]]
        return float(np.searchsorted(np.sort(start), self.offset - reach).mean() / len(start))


@pytest.mark.parametrize(("size", "height"), [(0.02, 3.0), (0.02, 30.0), (1e-3, 1.0)])
def test_an_edge_between_light_and_pixel_is_found(size: float, height: float) -> None:
    """At any angle and place: of the light at most a sliver goes unseen.

    Beyond a side of the octagon in a disc lies 1/8 − sin(45°)/2π = 1.2 % of it. Allowed is twice as much, for probes
    leave from the outermost points along the nearest of `AXES`, and two samples.
    """
    rng = np.random.default_rng(5)
    rays = sun_rays(disc(rng, SAMPLES), np.eye(3))
    reach = size / 2 + height * np.radians(SUN) * 1.2
    off, cut, traced = [], 0, []
    for _ in range(300):
        edge = Edge(size, height, 2 * np.pi * rng.random(), reach * (2 * rng.random() - 1))
        got = edge.seen(rays)
        traced.append(edge.tracer.rays)
        wanted = edge.each(rays)
        off.append(abs(got - wanted))
        cut += 0 < wanted < 1
    print(f"cut {cut}, worst {max(off):.4f}, mean {np.mean(off):.5f}, rays {np.mean(traced):.1f}")
    assert cut > 100, "MISTRUSTED: few edges were in sight"
    assert max(off) <= 2 * (1 / 8 - np.sin(np.pi / 4) / (2 * np.pi)) + 2 / len(rays.lights)
    assert min(traced) == PROBES < max(traced)


@pytest.mark.parametrize(("size", "height"), [(0.02, 3.0), (0.02, 0.5), (1e-3, 1.0)])
def test_a_turning_light_crosses_an_edge_without_jumps(size: float, height: float) -> None:
    """The error of N pairs changes as that of N random ones does: of a share δ that a step moves, by √(δ / N).

    Five of these and two samples are allowed. A light whose rim goes unseen would jump when its probes meet the edge:
    tracing eight of its samples from end to end alone jumps by 0.1 to 0.3 here.
    """
    rng = np.random.default_rng(6)
    directions, many, places = disc(rng, SAMPLES), disc(rng, 2000), rng.random((2000, 2))
    worst, moved = 0.0, []
    for angle in np.linspace(0, np.pi, 7, endpoint=False):
        edge, errors, shares = Edge(size, height, angle, 0.0), [], []
        for degrees in np.arange(-4.0, 4.0, 0.05):
            turn = Environment(np.ones((2, 4, 3), np.float32), rotate=float(degrees)).to_map
            shares.append(edge.exact(many @ turn, places))
            errors.append(edge.seen(sun_rays(directions, turn)) - shares[-1])
        swept, step = np.abs(np.diff(shares)), np.abs(np.diff(errors))
        bound = 5 * np.sqrt(swept / (2 * SAMPLES)) + 2 / (2 * SAMPLES)
        worst = max(worst, float((step / bound).max()))
        moved.append(swept.sum())
    print(f"worst {worst:.3f} of the bound, moved {np.round(moved, 2)}")
    assert max(moved) > 0.9, "MISTRUSTED: the light did not cross the edge"
    assert worst <= 1.0


@pytest.mark.parametrize("degrees", [0.0, 33.0])
def test_probes_lie_around_their_group_and_turn_with_it(sky: Environment, degrees: float) -> None:
    light = replace(sky, rotate=degrees).split(5)
    groups, still = HardGroups.of(light), HardGroups.of(sky.split(5))
    assert np.allclose(groups.probes @ light.to_map.T, still.probes, atol=1e-12)
    assert np.allclose(groups.outwards @ light.to_map.T, still.outwards, atol=1e-12)
    assert np.allclose(np.linalg.norm(groups.outwards, axis=2), 1.0)
    for number, (start, end) in enumerate(zip(groups.begin[:-1], groups.begin[1:], strict=True)):
        own, middle = groups.samples[start:end, :3], groups.samples[start:end, :3].mean(axis=0)
        assert np.abs(groups.outwards[number] @ middle).max() < EXTENT  # of copies the mean is another
        assert np.abs(groups.outwards[number].sum(axis=0)).max() < 1e-12
        farthest = (groups.outwards[number] @ own.T).max(axis=1)
        assert np.allclose(np.einsum("px,px->p", groups.outwards[number], groups.probes[number]), farthest)


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

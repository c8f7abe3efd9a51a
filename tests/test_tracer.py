"""prtcl/factors/visibility.py: rays against a plane and a sphere, order of bits, independence of scale."""

from __future__ import annotations

import time

import cases
import numpy as np
import pytest
import tolerances
import trimesh
from numpy.typing import NDArray

from prtcl import quadtree, reference
from prtcl.factors import hemisphere
from prtcl.factors import visibility as module
from prtcl.factors.visibility import OFFSET, REACH, Tracer

QUAD = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], dtype=np.float64)
QUAD_FACES = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)


def sphere_mesh(subdivisions: int = 3) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32)


def unpack(bits: NDArray[np.uint32], levels: int) -> NDArray[np.bool_]:
    """From the definition: sample s is bit s % 32 of word s // 32."""
    s = np.arange(4**levels)
    return ((bits[:, s // 32] >> (s % 32).astype(np.uint32)) & 1).astype(bool)


def frame_over(normal: NDArray[np.float64]) -> NDArray[np.float32]:
    return hemisphere.frames_from(np.atleast_2d(normal) / np.linalg.norm(normal))


@pytest.mark.parametrize("levels", [1, 2, 3, 5])
@pytest.mark.parametrize("normal", [(0, 1, 0), (0, -1, 0), (1, 0, 0), (0.3, -0.5, 0.8)])
def test_plane_against_the_analytic_answer(levels: int, normal: tuple[float, float, float]) -> None:
    tracer = Tracer(QUAD, QUAD_FACES)
    frames = frame_over(np.array(normal, dtype=np.float64))
    origins = tracer.origins(np.array([[0.2, 0.4, -0.1]]), frames[:, 2])
    bits = tracer.visibility(origins, frames, levels)
    world = reference.directions(levels) @ frames[0].astype(np.float64)
    start = origins[0] * tracer.radius + tracer.centre
    with np.errstate(divide="ignore"):
        distance = np.where(world[:, 1] < 0, start[1] / -world[:, 1], np.inf)
    hit = start + np.where(np.isfinite(distance), distance, 0.0)[:, None] * world
    outside = np.maximum(np.abs(hit[:, 0]), np.abs(hit[:, 2])) - 1.0
    hidden = np.isfinite(distance) & (outside < 0)
    sure = ~np.isfinite(distance) | (np.abs(outside) > 1e-5)
    assert sure.mean() > 0.95
    assert (unpack(bits, levels)[0] == ~hidden)[sure].all()
    if normal == (0, 1, 0):
        assert not hidden.any()
    elif levels >= 3:
        assert 0 < hidden[sure].mean() < 1


def test_sphere_against_the_analytic_answer() -> None:
    levels = 5
    vertices, faces = sphere_mesh(4)
    tracer = Tracer(vertices, faces)
    rng = np.random.default_rng(3)
    positions = rng.normal(size=(20, 3))
    positions *= (rng.uniform(1.1, 4, 20) / np.linalg.norm(positions, axis=1))[:, None]
    frames = cases.frames(20)
    origins = tracer.origins(positions, frames[:, 2])
    seen = unpack(tracer.visibility(origins, frames, levels), levels)
    starts = origins * tracer.radius + tracer.centre
    # The mesh lies between the unit sphere and the one its faces touch from within.
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inner = np.abs(np.einsum("ij,ij->i", normals, corners[:, 0]) / np.linalg.norm(normals, axis=1)).min()
    assert inner > 0.99
    sure_hidden, sure_seen = 0, 0
    for p in range(20):
        world = reference.directions(levels) @ frames[p].astype(np.float64)
        along = -world @ starts[p]
        missed = np.sqrt(np.maximum(starts[p] @ starts[p] - along**2, 0))
        hidden, free = (along > 0) & (missed < inner - 1e-5), (along < 0) | (missed > 1 + 1e-5)
        assert not seen[p][hidden].any()
        assert seen[p][free].all()
        sure_hidden, sure_seen = sure_hidden + hidden.sum(), sure_seen + free.sum()
    assert sure_hidden > 1000
    assert sure_hidden + sure_seen > 0.98 * 20 * 4**levels


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_a_convex_body_does_not_shadow_itself(scale: float) -> None:
    """Rays from a sphere's own triangles, at their centres and corners, see the whole sky."""
    vertices, faces = sphere_mesh()
    vertices = vertices * scale + 7 * scale
    tracer = Tracer(vertices, faces)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = np.concatenate([corners.mean(axis=1), corners[:, 0]])
    frames = hemisphere.frames_from(np.concatenate([normals, normals]))
    bits = tracer.visibility(tracer.origins(positions, frames[:, 2]), frames, 3)
    assert unpack(bits, 3).mean() == 1.0


def tilt(x: float, z: float) -> NDArray[np.float64]:
    """Rotation about x, then about z, by angles that leave no axis aligned."""
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return np.asarray(about_z @ about_x)


@pytest.mark.parametrize("turn", [(0.0, 0.0), (0.3, 0.4)])
@pytest.mark.parametrize("size", [1.0, 1e4, 1e6])
def test_a_plane_by_itself_sees_the_whole_sky(size: float, turn: tuple[float, float]) -> None:
    """At its very middle as well, where float32 resolves the positions far more finely than the plane."""
    rotation = tilt(*turn)
    tracer = Tracer(size * QUAD @ rotation.T, QUAD_FACES)
    rng = np.random.default_rng(8)
    flat = np.array([1.0, 0.0, 1.0]) * rng.uniform(-1, 1, (200, 3)) * size ** rng.uniform(-1, 0.9, (200, 1))
    normals = np.where(np.arange(200)[:, None] % 2, 1.0, -1.0) * rotation[:, 1]
    frames = hemisphere.frames_from(normals)
    for reach in (None, np.full(200, tracer.face_reach[0])):
        origins = tracer.origins(flat @ rotation.T, normals, reach)
        assert unpack(tracer.visibility(origins, frames, 5), 5).all()


@pytest.mark.parametrize("turn", [(0.0, 0.0), (0.3, 0.4)])
def test_a_huge_ground_leaves_the_shadows_of_an_object_alone(turn: tuple[float, float]) -> None:
    """Against the object alone and a ground that hides all below it, 10^4 times as large."""
    ball, ball_faces = sphere_mesh(4)
    rotation, levels = tilt(*turn), 5
    ball = (ball + [0.0, 1.0, 0.0]) @ rotation.T
    tracer = Tracer(
        np.concatenate([ball, 1e4 * QUAD @ rotation.T]),
        np.concatenate([ball_faces, QUAD_FACES + len(ball)]),
    )
    alone = Tracer(ball, ball_faces)
    rng = np.random.default_rng(9)
    ground = np.stack([rng.uniform(-2, 2, 200), np.zeros(200), rng.uniform(-2, 2, 200)], axis=1) @ rotation.T
    chosen = rng.integers(0, len(ball_faces), 200)
    corners = ball[ball_faces[chosen]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.concatenate(
        [np.tile(rotation[:, 1], (200, 1)), normals / np.linalg.norm(normals, axis=1, keepdims=True)]
    )
    positions = np.concatenate([ground, corners.mean(axis=1)])
    faces = np.concatenate([np.full(200, len(ball_faces)), chosen])
    frames = hemisphere.frames_from(normals)
    bits = tracer.visibility(tracer.origins(positions, normals, tracer.face_reach[faces]), frames, levels)
    seen = unpack(bits, levels)
    up = np.einsum("sk,pkj,j->ps", reference.directions(levels), frames.astype(np.float64), rotation[:, 1])
    expected = unpack(alone.visibility(alone.origins(positions, normals), frames, levels), levels) & (up > 0)
    assert 0.3 < expected.mean() < 0.9
    sure = np.abs(up) > 1e-3  # below that, rays from the ball pass the ground's end
    # float32 itself knows a tilted ground of that size to a few thousandths of the ball only.
    assert (seen != expected)[sure].mean() < (3e-3 if any(turn) else 1e-5)


def test_origins_leave_by_what_float32_moves_the_surface() -> None:
    tracer = Tracer(np.concatenate([QUAD, [[9.0, 9.0, 9.0]]]), QUAD_FACES)
    assert (tracer.face_reach == REACH[0]).all()  # an axis-aligned plane through the centre is exact
    assert (tracer.vertex_reach == [REACH[0]] * 4 + [0.0]).all()
    vertices, faces = sphere_mesh()
    tracer = Tracer(vertices, faces)
    assert tracer.face_reach.min() > 1.0 and tracer.face_reach.max() < 2.0
    assert (tracer.face_reach >= tracer.vertex_reach[faces].max(axis=1)).all()
    away = tracer.origins(vertices, vertices, tracer.vertex_reach) - vertices
    lifted = np.sum(away * vertices, axis=1)
    assert np.abs(lifted - OFFSET * tracer.vertex_reach).max() < 4 * 2.0**-24
    # A sliver of hardly any area is bounded, so that its neighbours' rays still start near them.
    sliver = Tracer(
        np.array([[0, 0, 0], [1, 0.3, 0.2], [0.5, 0.15 + 1e-7, 0.1], [0, 1, 0]]),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    assert (sliver.face_reach == REACH[1]).all()


def scene() -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Two spheres on a square; points on the square and on the spheres, with normals."""
    ball, faces = sphere_mesh()
    rng = np.random.default_rng(4)
    vertices = np.concatenate(
        [4 * QUAD, ball + np.array([0, 1.2, 0]), 0.5 * ball + np.array([1.8, 0.6, 0.4])]
    )
    all_faces = np.concatenate([QUAD_FACES, faces + 4, faces + 4 + len(ball)])
    ground = np.stack([rng.uniform(-3, 3, 40), np.zeros(40), rng.uniform(-3, 3, 40)], axis=1)
    chosen = all_faces[rng.integers(2, len(all_faces), 40)]
    corners = vertices[chosen]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    up = np.broadcast_to([0.0, 1.0, 0.0], (40, 3))
    positions = np.concatenate([ground, corners.mean(axis=1)])
    return vertices, all_faces, positions, np.concatenate([up, normals])


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e4, 0.0), (1.0, 1e5), (1e4, 1e5), (1e-3, 1e2)])
def test_bits_do_not_depend_on_scale_and_place(scale: float, shift: float) -> None:
    vertices, faces, positions, normals = scene()
    frames = hemisphere.frames_from(normals)

    def bits(factor: float, offset: float) -> NDArray[np.uint32]:
        moved = np.array([offset, -offset, 0.5 * offset])
        tracer = Tracer(vertices * factor + moved, faces)
        return tracer.visibility(tracer.origins(positions * factor + moved, frames[:, 2]), frames, 4)

    expected = bits(1.0, 0.0)
    hidden = 1 - unpack(expected, 4).mean()
    assert 0.05 < hidden < 0.95
    assert (bits(scale, shift) == expected).all()


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_order_of_bits_and_padding(levels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hidden where a known function of the direction says so: bit s % 32 of word s // 32, zeros beyond."""
    tracer = Tracer(QUAD, QUAD_FACES)
    asked: list[NDArray[np.float32]] = []

    def occluded(
        origins: NDArray[np.float32], directions: NDArray[np.float32], _: object
    ) -> NDArray[np.bool_]:
        asked.append(directions)
        return np.asarray(directions[:, 0] + 0.3 * directions[:, 2] > 0)

    monkeypatch.setattr(tracer, "occluded", occluded)
    frames = cases.frames(3)
    bits = tracer.visibility(np.zeros((3, 3), np.float32), frames, levels)
    assert bits.dtype == np.uint32
    assert bits.shape == (3, quadtree.visibility_words(levels))
    world = np.einsum("sk,pkj->psj", reference.directions(levels), frames.astype(np.float64))
    expected = cases.pack_bits(~(world[..., 0] + 0.3 * world[..., 2] > 0))
    assert (bits == expected).all()
    if levels < 3:
        assert (bits >> np.uint32(4**levels) == 0).all() or levels == 3
    assert sum(len(d) for d in asked) == 3 * 4**levels


def test_each_point_takes_its_own_place_in_the_cells() -> None:
    vertices, faces, positions, normals = scene()
    frames, tracer = hemisphere.frames_from(normals), Tracer(vertices, faces)
    origins = tracer.origins(positions, frames[:, 2])
    grid = (np.arange(len(origins)) % 3).astype(np.int32)
    mixed = tracer.visibility(origins, frames, 3, grid)
    for place in range(3):
        alone = tracer.visibility(origins, frames, 3, np.full(len(origins), place, np.int32))
        assert (mixed[grid == place] == alone[grid == place]).all()
        assert (alone != mixed).any()
    centred = tracer.visibility(origins, frames, 3, np.full_like(grid, hemisphere.ALONE))
    assert (tracer.visibility(origins, frames, 3) == centred).all()


def test_batches_agree_and_progress_adds_up(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces, positions, normals = scene()
    frames, tracer = hemisphere.frames_from(normals), Tracer(vertices, faces)
    origins = tracer.origins(positions, frames[:, 2])
    whole = tracer.visibility(origins, frames, 3)
    done: list[int] = []
    monkeypatch.setattr(module, "RAYS_PER_TASK", 7 * 64)
    assert (tracer.visibility(origins, frames, 3, progress=done.append) == whole).all()
    assert sum(done) == len(origins)
    assert max(done) == 7


@pytest.mark.parametrize("count", [1, 31, 32, 33, 70])
def test_light_visibility(count: int) -> None:
    vertices, faces, positions, normals = scene()
    frames, tracer = hemisphere.frames_from(normals), Tracer(vertices, faces)
    origins = tracer.origins(positions, frames[:, 2])
    rng = np.random.default_rng(count)
    lights = rng.normal(size=(count, 3))
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    bits = tracer.light_visibility(origins, frames[:, 2], lights)
    assert bits.shape == (len(origins), (count + 31) // 32)
    assert bits.dtype == np.uint32
    n = np.arange(count)
    seen = ((bits[:, n // 32] >> (n % 32).astype(np.uint32)) & 1).astype(bool)
    cosine = frames[:, 2] @ lights.T
    assert not seen[cosine < -1e-6].any()
    # One by one: the same rays.
    for l in range(min(count, 5)):
        towards = np.broadcast_to(lights[l].astype(np.float32), origins.shape)
        free = ~tracer.occluded(origins, np.ascontiguousarray(towards))
        up = cosine[:, l] > 1e-6
        assert (seen[up, l] == free[up]).all()
    if count % 32:
        assert (bits[:, -1] >> np.uint32(count % 32) == 0).all()
    if count > 1:
        assert 0 < seen.mean() < 1


def test_runs_of_lights_are_traced_where_their_probes_differ() -> None:
    """Suns of 40 directions within a degree, and lone ones between: few rays, and few bits that differ."""
    vertices, faces, positions, normals = scene()
    frames, tracer = hemisphere.frames_from(normals), Tracer(vertices, faces)
    origins = tracer.origins(positions, frames[:, 2])
    rng = np.random.default_rng(3)
    middles = rng.normal(size=(6, 3))
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    lights, runs = [], []
    for k, middle in enumerate(middles):
        for part in [40, 1, 2] if k % 2 else [40, 3]:
            runs.append(sum(map(len, lights)))
            close = middle + (0.01 if part == 40 else 0.5) * rng.normal(size=(part, 3))
            lights.append(close / np.linalg.norm(close, axis=1, keepdims=True))
    towards = np.concatenate(lights)
    arguments = (origins, frames[:, 2], towards)
    before = tracer.rays
    exact = tracer.light_visibility(*arguments)
    whole = tracer.rays - before
    assert (tracer.light_visibility(*arguments, runs=np.arange(len(towards))) == exact).all()
    before = tracer.rays
    got = tracer.light_visibility(*arguments, runs=np.array(runs))
    assert tracer.rays - before < whole / 3
    wrong = np.unpackbits((got ^ exact).view(np.uint8)).sum() / (len(origins) * len(towards))
    assert wrong < 0.01
    # Runs of three or fewer are all probes.
    n = np.concatenate(
        [np.arange(a, b) for a, b in zip(runs, [*runs[1:], len(towards)], strict=True) if b - a <= 3]
    )
    differs = (got ^ exact)[:, n // 32] >> (n % 32).astype(np.uint32) & 1
    assert not differs.any()


def test_rays_are_counted_where_they_are_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    """From all threads; directions below the horizon are no rays, nor are those of the camera counted."""
    monkeypatch.setattr(module, "RAYS_PER_TASK", 64)
    tracer = Tracer(*sphere_mesh(1))
    normals = np.tile([[0.0, 0.0, 1.0]], (200, 1))
    origins = tracer.origins(2 * normals, normals)
    assert tracer.rays == 0
    tracer.visibility(origins, frame_over(normals[0]).repeat(200, axis=0), 2)
    assert tracer.rays == 200 * 16
    up, down = [0.0, 0.0, 1.0], [0.6, 0.0, -0.8]
    tracer.light_visibility(origins, normals, np.array([up, down, up]))
    assert tracer.rays == 200 * 18
    tracer.intersect(3 * normals, -normals)
    assert tracer.rays == 200 * 18


def test_no_lights_and_no_points() -> None:
    tracer = Tracer(QUAD, QUAD_FACES)
    nobody, someone = np.zeros((0, 3), np.float32), np.zeros((2, 3), np.float32)
    assert tracer.light_visibility(someone, someone, np.zeros((0, 3))).shape == (2, 0)
    assert tracer.light_visibility(nobody, nobody, np.zeros((5, 3))).shape == (0, 1)
    assert tracer.visibility(nobody, np.zeros((0, 3, 3), np.float32), 3).shape == (0, 2)
    face, where = tracer.intersect(np.zeros((0, 3)), np.zeros((0, 3)))
    assert face.shape == (0,)
    assert where.shape == (0, 2)


@pytest.mark.parametrize("distance", [0.5, 10.0, 1e6])
@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_intersect_from_near_and_far(distance: float, shift: float) -> None:
    """Rays at the centres of a sphere's triangles, from `distance` radii outside."""
    vertices, faces = sphere_mesh()
    vertices = vertices + shift
    tracer = Tracer(vertices, faces)
    centres = vertices[faces].mean(axis=1)
    outwards = (centres - shift) / np.linalg.norm(centres - shift, axis=1, keepdims=True)
    face, where = tracer.intersect(centres + distance * outwards, -outwards)
    assert (face == np.arange(len(faces))).all()
    # A hit is good to a few float32 units of the unit sphere, over an edge of about 0.15.
    tolerances.assert_close(where, np.full(where.shape, 1 / 3), 16 * 2.0**-24 / 0.1)
    missed, _ = tracer.intersect(centres + distance * outwards, outwards)
    assert (missed == -1).all()


def test_intersect_takes_the_first_hit_and_states_its_corners() -> None:
    tracer = Tracer(
        np.concatenate([QUAD, QUAD - np.array([0, 1, 0])]), np.concatenate([QUAD_FACES, QUAD_FACES + 4])
    )
    eyes = np.array([[0.5, 3.0, -0.25], [0.5, -3.0, -0.25], [5.0, 3.0, 0.0]])
    face, where = tracer.intersect(eyes, np.array([[0, -1.0, 0], [0, 1.0, 0], [0, -1.0, 0]]))
    assert face[0] in (0, 1)
    assert face[1] in (2, 3)
    assert face[2] == -1
    corners = QUAD[QUAD_FACES[face[0]]]
    u, v = where[0]
    point = (1 - u - v) * corners[0] + u * corners[1] + v * corners[2]
    tolerances.assert_close(point, [0.5, 0.0, -0.25], 16 * 2.0**-24 * tracer.radius)


def test_vertices_that_no_face_uses_do_not_count() -> None:
    tracer = Tracer(np.concatenate([QUAD, [[1e9, 0, 0]]]), QUAD_FACES)
    assert tracer.radius == np.sqrt(2)
    assert (tracer.centre == 0).all()


def test_an_interrupt_drops_the_tasks_that_wait() -> None:
    """Ctrl-C comes up in the main thread; the tasks under way end, the others never begin."""
    ran: list[int] = []

    def run(part: slice) -> None:
        ran.append(part.start)
        time.sleep(0.05)
        if part.start == 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        module.in_parallel(run, 200, 1)
    assert len(ran) <= 4 * module.threads()


def test_threads_is_a_positive_number() -> None:
    assert module.threads() >= 1

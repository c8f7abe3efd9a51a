"""Points at pixels and vertices: frames, sides, normals, and cameras that cannot give a picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.factors.sequence import stratified
from prtcl.factors.visibility import OFFSET, Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import Hits, check_eye, face_normals, pixel_points, shoot, vertex_points, with_eye
from prtcl.transport.pipeline import Points

U = 2.0**-24
Array = NDArray[np.float64]


def sphere(subdivisions: int = 3, normals: bool = True, inwards: bool = False, scale: float = 1.0) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=subdivisions)
    vertices, faces = np.asarray(made.vertices), np.asarray(made.faces)
    faces = faces[:, ::-1] if inwards else faces
    return Mesh.from_arrays(vertices * scale, faces, vertices if normals else None, "sphere")


def box(inwards: bool = False, without: tuple[int, ...] = ()) -> Mesh:
    """[−1, 1]³ with flat sides; `without` leaves out triangles."""
    made = trimesh.creation.box(extents=(2, 2, 2))
    faces = np.delete(np.asarray(made.faces), list(without), axis=0)
    return Mesh.from_arrays(np.asarray(made.vertices), faces[:, ::-1] if inwards else faces, None, "box")


def seen(mesh: Mesh, camera: Camera, two_sided: bool = True) -> tuple[Points, Hits, Tracer]:
    tracer = Tracer(mesh.vertices, mesh.faces)
    pixels = np.arange(camera.size[0] * camera.size[1])
    hits = shoot(tracer, camera, pixels, np.zeros_like(pixels))
    assert len(hits.ray) > 20
    return pixel_points(mesh, tracer, hits, np.zeros(len(hits.ray), np.int64), two_sided), hits, tracer


def camera_at(eye: tuple[float, float, float], size: tuple[int, int] = (24, 18)) -> Camera:
    return Camera(eye, (0.0, 0.0, 0.0), size=size)


def places(mesh: Mesh, hits: Hits) -> Array:
    return np.asarray(np.einsum("nc,ncx->nx", hits.barycentric, mesh.vertices[mesh.faces[hits.face]]))


OUTSIDE = camera_at((1.5, 2.0, 3.0))


# --- primary rays --------------------------------------------------------------------------------------------


def test_hits_lie_on_the_rays_and_on_the_sphere() -> None:
    mesh = sphere(4)
    _, hits, _ = seen(mesh, OUTSIDE)
    position = places(mesh, hits)
    away = position - OUTSIDE.eye
    along = np.linalg.norm(away, axis=1)
    # Barycentric coordinates are float32: positions are good to a few u of the distance from the tracer's centre.
    assert np.abs(away / along[:, None] + hits.towards).max() < 64 * U
    assert (np.abs(np.linalg.norm(position, axis=1) - 1) < 2e-3).all()  # flat faces of an icosphere of 5120
    assert np.abs(hits.barycentric.sum(axis=1) - 1).max() < 1e-15
    assert hits.barycentric.min() > -64 * U


def test_pixels_are_numbered_row_by_row_from_the_top_left() -> None:
    """A small patch up and to the right in world space is seen up and to the right in the image."""
    mesh = Mesh.from_arrays(
        [[0.4, 0.4, 0], [0.9, 0.4, 0], [0.9, 0.9, 0], [0.4, 0.9, 0]], [[0, 1, 2], [0, 2, 3]]
    )
    camera = Camera((0, 0, 1 / np.tan(np.radians(20))), (0, 0, 0), fov=40.0, size=(20, 20))  # sees [−1, 1]²
    tracer = Tracer(mesh.vertices, mesh.faces)
    pixels = np.arange(400)
    hits = shoot(tracer, camera, pixels, np.zeros_like(pixels))
    rows, columns = np.divmod(hits.ray, 20)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (1, 5, 14, 18)
    assert len(hits.ray) == 25


# --- points of pixels ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("normals", [True, False])
@pytest.mark.parametrize("two_sided", [True, False])
@pytest.mark.parametrize("inwards", [True, False])
def test_frames_are_orthonormal_right_handed_and_turned_to_the_viewer(
    normals: bool, two_sided: bool, inwards: bool
) -> None:
    points, hits, _ = seen(sphere(2, normals, inwards), OUTSIDE, two_sided)
    frames = points.frames.astype(np.float64)
    assert points.polar
    assert np.abs(frames @ frames.transpose(0, 2, 1) - np.eye(3)).max() < 8 * U
    assert np.abs(np.linalg.det(frames) - 1).max() < 16 * U
    # The view lies in the plane of tangent and normal, on the tangent's side, and is a unit vector.
    assert np.abs(points.views[:, 1]).max() < 8 * U
    assert (points.views[:, 0] >= -8 * U).all()
    assert np.abs(np.linalg.norm(points.views.astype(np.float64), axis=1) - 1).max() < 8 * U
    world = np.einsum("nij,ni->nj", frames, points.views)
    assert np.abs(world - hits.towards).max() < 16 * U
    if two_sided:
        assert (points.views[:, 2] >= 0).all()


def test_a_view_straight_along_the_normal_still_has_a_frame() -> None:
    mesh = Mesh.from_arrays([[-1, 0, -1], [1, 0, -1], [0, 0, 2]], [[0, 2, 1]])
    tracer = Tracer(mesh.vertices, mesh.faces)
    hits = Hits(
        np.array([0]), np.array([0], np.int32), np.array([[0.4, 0.3, 0.3]]), np.array([[0.0, 1.0, 0.0]])
    )
    frame = pixel_points(mesh, tracer, hits, np.array([0])).frames[0].astype(np.float64)
    assert np.abs(frame @ frame.T - np.eye(3)).max() < 8 * U
    assert np.abs(frame[2] - [0, 1, 0]).max() < U


def test_without_vertex_normals_frames_are_flat() -> None:
    mesh = box()
    points, hits, _ = seen(mesh, OUTSIDE)
    normal = points.frames[:, 2]
    assert np.abs(np.abs(normal).max(axis=1) - 1).max() < U
    assert np.abs(normal - face_normals(mesh, mesh.faces[hits.face])).max() < U
    assert {tuple(n) for n in np.round(normal).astype(int)} == {(1, 0, 0), (0, 1, 0), (0, 0, 1)}


def test_vertex_normals_are_interpolated_and_made_unit() -> None:
    mesh = sphere(1)
    points, hits, _ = seen(mesh, OUTSIDE)
    assert mesh.normals is not None
    mixed = np.einsum("nc,ncx->nx", hits.barycentric, mesh.normals[mesh.faces[hits.face]].astype(np.float64))
    mixed /= np.linalg.norm(mixed, axis=1, keepdims=True)
    front = np.sum(mixed * hits.towards, axis=1) > 1e-6
    assert front.mean() > 0.8
    assert np.abs(points.frames[front, 2] - mixed[front]).max() < 4 * U
    flat = face_normals(mesh, mesh.faces[hits.face])
    assert np.abs(mixed - flat).max() > 0.05  # the two do differ here


def test_normals_that_cancel_fall_back_to_the_face() -> None:
    mesh = Mesh.from_arrays(
        [[-1, 0, -1], [1, 0, -1], [0, 0, 2]], [[0, 2, 1]], [[1, 0, 0], [-1, 0, 0], [0, 1, 0]]
    )
    hits = Hits(
        np.array([0]), np.array([0], np.int32), np.array([[0.5, 0.0, 0.5]]), np.array([[0.0, 0.6, 0.8]])
    )
    points = pixel_points(mesh, Tracer(mesh.vertices, mesh.faces), hits, np.array([0]))
    assert np.abs(points.frames[0, 2] - [0, 1, 0]).max() < U


@pytest.mark.parametrize("normals", [True, False])
def test_two_sided_a_surface_seen_from_behind_turns_to_the_viewer(normals: bool) -> None:
    """The same sphere wound inwards and with inward normals gives the same points."""
    mesh = sphere(2, normals)
    turned = Mesh.from_arrays(
        mesh.vertices, mesh.faces[:, ::-1], None if mesh.normals is None else -mesh.normals, "turned"
    )
    ours, _, _ = seen(mesh, OUTSIDE)
    theirs, _, _ = seen(turned, OUTSIDE)
    assert np.abs(ours.frames - theirs.frames).max() < 64 * U
    assert np.abs(ours.origins - theirs.origins).max() < 64 * U
    assert np.abs(ours.views - theirs.views).max() < 64 * U


def test_one_sided_a_surface_seen_from_behind_has_its_view_below_the_horizon() -> None:
    """Every BRDF is zero there: the point is black."""
    points, _, _ = seen(sphere(2, normals=False, inwards=True), OUTSIDE, two_sided=False)
    assert (points.views[:, 2] < 0).all()
    front, _, _ = seen(sphere(2, normals=False), OUTSIDE, two_sided=False)
    assert (front.views[:, 2] > 0).all()


@pytest.mark.parametrize("two_sided", [True, False])
@pytest.mark.parametrize("inwards", [True, False])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_rays_start_on_the_side_that_is_seen(two_sided: bool, inwards: bool, scale: float) -> None:
    """Whichever way triangles are wound: OFFSET times the reach off the surface, towards the viewer."""
    mesh = sphere(2, normals=False, inwards=inwards, scale=scale)
    camera = camera_at((1.5 * scale, 2.0 * scale, 3.0 * scale))
    points, hits, tracer = seen(mesh, camera, two_sided)
    local = (places(mesh, hits) - tracer.centre) / tracer.radius
    outside = face_normals(mesh, mesh.faces[hits.face]) * (-1 if inwards else 1)
    away = np.sum((points.origins - local) * outside, axis=1)
    reach = tracer.face_reach[hits.face]
    # Origins are float32 numbers up to 1, and OFFSET is 4 of their units.
    assert (np.abs(away / OFFSET - reach) < 0.5 * reach).all()


def test_materials_and_grids_follow_the_faces_and_points() -> None:
    mesh = replace(box(), parts=np.arange(12, dtype=np.int32), materials=(None,) * 12)
    tracer = Tracer(mesh.vertices, mesh.faces)
    pixel, sub = np.repeat(np.arange(24 * 18), 4), np.tile(np.arange(4), 24 * 18)
    hits = shoot(tracer, OUTSIDE, pixel, sub)
    points = pixel_points(mesh, tracer, hits, sub[hits.ray])
    assert (points.material == mesh.parts[hits.face]).all() and len(set(points.material)) == 6
    assert (points.grid == sub[hits.ray]).all() and set(points.grid) == {0, 1, 2, 3}
    assert len(points) == len(hits.ray) and len(points[3:7]) == 4


@pytest.mark.parametrize("scale", [1e-3, 1e5])
def test_points_do_not_depend_on_the_unit_of_length(scale: float) -> None:
    ours, _, _ = seen(sphere(2), OUTSIDE)
    theirs, _, _ = seen(sphere(2, scale=scale), camera_at((1.5 * scale, 2.0 * scale, 3.0 * scale)))
    assert len(ours) == len(theirs)
    # Rounding of scaled vertices moves a hit by a few float32 units, which the frames follow.
    assert np.abs(ours.origins - theirs.origins).max() < 64 * U
    assert np.abs(ours.frames - theirs.frames).max() < 256 * U
    assert np.abs(ours.views - theirs.views).max() < 256 * U


# --- points of vertices --------------------------------------------------------------------------------------


def test_vertices_keep_the_files_normals() -> None:
    rng = np.random.default_rng(2)
    mesh = sphere(2)
    normals = rng.normal(size=mesh.vertices.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh = replace(mesh, normals=normals.astype(np.float32))
    for eye in (None, (1.0, 2.0, 3.0)):
        points = vertex_points(mesh, Tracer(mesh.vertices, mesh.faces), eye)
        assert np.abs(points.frames[:, 2] - normals).max() < 2 * U  # seen from behind or not
        assert len(points) == len(mesh.vertices)


def test_vertices_without_normals_take_those_of_the_geometry() -> None:
    mesh = sphere(3, normals=False)
    points = vertex_points(mesh, Tracer(mesh.vertices, mesh.faces))
    away = np.degrees(np.arccos(np.clip(np.sum(points.frames[:, 2] * mesh.vertices, axis=1), -1, 1)))
    assert away.max() < 1.0
    assert (points.frames[:, 2] == mesh.smooth().normals).mean() > 0.9


def test_a_vertex_looks_at_the_eye_in_frames_of_either_kind() -> None:
    mesh, eye = sphere(2), np.array([0.5, 3.0, 2.0])
    tracer = Tracer(mesh.vertices, mesh.faces)
    towards = eye - mesh.vertices
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    turned = vertex_points(mesh, tracer, eye)
    fixed = with_eye(vertex_points(mesh, tracer), mesh.vertices, eye)
    assert turned.polar and not fixed.polar
    for points in (turned, fixed):
        world = np.einsum("nij,ni->nj", points.frames.astype(np.float64), points.views)
        assert np.abs(world - towards).max() < 16 * U
    assert np.abs(turned.views[:, 1]).max() < 8 * U and np.abs(fixed.views[:, 1]).max() > 0.5
    assert np.abs(turned.views[:, 2] - fixed.views[:, 2]).max() < 16 * U
    assert (turned.origins == fixed.origins).all()


def test_frames_without_an_eye_depend_on_the_normal_alone() -> None:
    mesh = sphere(2)
    tracer = Tracer(mesh.vertices, mesh.faces)
    whole = vertex_points(mesh, tracer)
    moved = replace(mesh, vertices=mesh.vertices * 3 + 5)
    assert (vertex_points(moved, Tracer(moved.vertices, moved.faces)).frames == whole.frames).all()
    assert (whole.views == [0, 0, 1]).all() and not whole.polar


def test_some_vertices_are_those_of_all() -> None:
    mesh = sphere(2)
    tracer = Tracer(mesh.vertices, mesh.faces)
    only = np.array([40, 3, 17])
    for eye in (None, (0.5, 3.0, 2.0)):
        some, whole = vertex_points(mesh, tracer, eye, only), vertex_points(mesh, tracer, eye)[only]
        for name in ("origins", "frames", "views", "material", "grid"):
            assert (getattr(some, name) == getattr(whole, name)).all()


def test_a_vertex_has_the_material_of_a_face_it_belongs_to() -> None:
    mesh = replace(sphere(1), parts=(np.arange(80) % 3).astype(np.int32), materials=(None,) * 3)
    material = vertex_points(mesh, Tracer(mesh.vertices, mesh.faces)).material
    for vertex, part in enumerate(material):
        assert part in mesh.parts[(mesh.faces == vertex).any(axis=1)]


# --- cameras that cannot give a picture ----------------------------------------------------------------------


def check(mesh: Mesh, eye: Any, target: Any, size: tuple[int, int] = (24, 18)) -> None:
    check_eye(Tracer(mesh.vertices, mesh.faces), mesh, Camera(eye, target, size=size))


def test_a_camera_that_sees_nothing_is_refused_with_where_the_mesh_is() -> None:
    where = r"\(0 0 5\) towards \(9 0 5\) sees nothing .*\(-1 -1 -1\) to \(1 1 1\)\n.*--eye"
    with pytest.raises(InputError, match=where):
        check(box(), (0, 0, 5), (9.0, 0.0, 5.0))
    with pytest.raises(InputError, match="sees nothing"):
        check(box(), (0, 0, 5), (0, 0, 9))


def test_one_pixel_that_sees_the_mesh_is_enough() -> None:
    """Whichever it is: the last one, then the first."""
    mesh = box()
    tracer = Tracer(mesh.vertices, mesh.faces)
    for x, y, pixel in ((-36.3, 26.4, 299), (39.1, -29.2, 0)):
        camera = Camera((x, y, 110.0), (x, y, 0.0), size=(20, 15))
        assert shoot(tracer, camera, np.arange(300), np.zeros(300, np.int64)).ray.tolist() == [pixel]
        check_eye(tracer, mesh, camera)


def test_a_mesh_thinner_than_a_pixel_is_seen() -> None:
    """Its one pixel's first point misses it, a later one does not."""
    camera = Camera((0.0, 0.0, 110.0), (0.0, 0.0, 0.0), size=(5, 5))
    pixel = 2 * 110 * np.tan(np.radians(20)) / 5
    for x, y in zip(*stratified(np.arange(4)), strict=True):
        mesh = Mesh.from_arrays(box().vertices + [pixel * (x - 0.5), pixel * (0.5 - y), 0], box().faces)
        check_eye(Tracer(mesh.vertices, mesh.faces), mesh, camera)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
@pytest.mark.parametrize("eye", [(0.0, 0.0, 0.0), (0.9, 0.1, 0.0), (-0.2, 0.3, 0.92)])
def test_inside_a_closed_body_is_refused(scale: float, eye: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match="is inside the mesh: no light gets there\nmove --eye"):
        check(sphere(3, scale=scale), tuple(scale * x for x in eye), (0.0, 0.0, -scale))


def test_inside_a_room_is_fine() -> None:
    """Walls that face inwards; and one window, be the walls wound outwards."""
    check(sphere(3, inwards=True), (0.1, 0, 0), (0, 0, -1))
    check(box(inwards=True), (0.1, 0, 0), (0, 0, -1))
    check(box(without=(0,)), (0.1, 0, 0), (0, 0, -1))


def test_outside_is_fine_however_close() -> None:
    for eye in ((0.0, 0.0, 1.001), (0.0, 0.0, 1.5), (0, 0, 50.0)):
        check(sphere(3), eye, (0.0, 0.0, 0.0))

"""Points from a mesh: its vertices, or what a camera's pixels see."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors import hemisphere
from prtcl.factors.sequence import stratified
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.transport.pipeline import Points

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hits:
    """First hits of some of a camera's sub-pixel rays.

    Attributes
    ----------
    ray : (n,) int64 which of the rays asked for hit something
    face : (n,) int32
    barycentric : (n, 3) weights of the face's corners
    towards : (n, 3) unit world directions to the eye
    """

    ray: npt.NDArray[np.int64]
    face: npt.NDArray[np.int32]
    barycentric: Array
    towards: Array


def shoot(tracer: Tracer, camera: Camera, pixel: npt.NDArray[np.int64], sub: npt.NDArray[np.int64]) -> Hits:
    """Primary rays through sub-pixel points: pixel (flat index, row by row) and number within the pixel."""
    width = camera.size[0]
    dx, dy = stratified(sub)
    directions = camera.rays(pixel % width + dx, pixel // width + dy)
    eyes = np.broadcast_to(np.asarray(camera.eye, dtype=np.float64), directions.shape)
    face, uv = tracer.intersect(eyes, directions)
    ray = np.nonzero(face >= 0)[0]
    uv = uv[ray]
    barycentric = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
    return Hits(ray, face[ray], barycentric, -directions[ray])


def check_eye(tracer: Tracer, mesh: Mesh, camera: Camera) -> None:
    """Refuse a camera that cannot give a picture, before any hemisphere is traced.

    Raises
    ------
    InputError
        If no pixel sees the mesh, or the eye is inside it: every ray in all directions meets a surface from
        behind. (A room whose walls face inwards, or any opening, is a fine place for an eye.)
    """
    if not any(map(len, _seeing(tracer, camera))):
        raise InputError(
            f"the camera at {_text(camera.eye)} towards {_text(camera.target)} sees nothing of the mesh, which lies "
            f"in {_text(mesh.bounds[0])} to {_text(mesh.bounds[1])}\nmove --eye or --target"
        )
    upper = hemisphere.directions(4)[:, :3].astype(np.float64)
    around = np.concatenate([upper, -upper])
    face, _ = tracer.intersect(
        np.broadcast_to(np.asarray(camera.eye, dtype=np.float64), around.shape), around
    )
    if (face >= 0).all():
        normals = face_normals(mesh, mesh.faces[face])
        if (np.sum(normals * around, axis=1) > 0.0).mean() > 0.99:
            raise InputError(
                f"the camera at {_text(camera.eye)} is inside the mesh: no light gets there\nmove --eye"
            )


def seeing_pixels(tracer: Tracer, camera: Camera) -> npt.NDArray[np.int64]:
    """Flat indices of the pixels whose first sub-pixel point sees the mesh; where none does, whose second, and so on.

    Empty where `check_eye` refuses the camera for seeing nothing.
    """
    parts: list[npt.NDArray[np.int64]] = []
    for number, part in enumerate(_seeing(tracer, camera), start=1):
        parts.append(part)
        if number % PARTS == 0 and any(map(len, parts)):
            break
    return np.concatenate(parts)


PARTS = 16
"""Parts of an image whose rays are shot together."""


def _seeing(tracer: Tracer, camera: Camera) -> Iterator[npt.NDArray[np.int64]]:
    """Pixels that see the mesh, part by part of the image, through one after another of their first points."""
    pixels = np.arange(camera.size[0] * camera.size[1])
    for sub in range(4):
        for part in np.array_split(pixels, PARTS):
            yield part[shoot(tracer, camera, part, np.full_like(part, sub)).ray]


def _text(position: npt.ArrayLike) -> str:
    return "(" + " ".join(f"{float(x):g}" for x in np.asarray(position)) + ")"


def face_normals(mesh: Mesh, faces: npt.NDArray[np.int32]) -> Array:
    """Unit normals of (n, 3) faces by their winding."""
    corners = mesh.vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


def _dot(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> Array:
    return np.asarray(np.sum(a * b, axis=1, keepdims=True), dtype=np.float64)


def pixel_points(
    mesh: Mesh, tracer: Tracer, hits: Hits, grid: npt.NDArray[np.int64], two_sided: bool = True
) -> Points:
    """Points at a camera's hits, their frames turned so that the viewer lies in the plane of tangent and normal.

    Parameters
    ----------
    grid : (n,) visibility grid of each hit
    two_sided : seen from behind, the normal is turned to the viewer; otherwise the view stays below the
        horizon and nothing is reflected
    """
    corners = mesh.faces[hits.face]
    positions = np.einsum("nc,ncx->nx", hits.barycentric, mesh.vertices[corners])
    geometric = face_normals(mesh, corners)
    shading = geometric
    if mesh.normals is not None:
        mixed = np.einsum("nc,ncx->nx", hits.barycentric, mesh.normals[corners].astype(np.float64))
        length = np.linalg.norm(mixed, axis=1, keepdims=True)
        shading = np.where(length > 1e-6, mixed / np.maximum(length, 1e-6), geometric)
    # Rays leave on the side that is seen, whichever way the triangle is wound.
    outside = geometric * np.where(_dot(geometric, hits.towards) < 0.0, -1.0, 1.0)
    if two_sided:
        shading = shading * np.where(_dot(shading, hits.towards) < 0.0, -1.0, 1.0)
    frames = hemisphere.frames_from(shading, hits.towards)
    return Points(
        origins=tracer.origins(positions, outside, tracer.face_reach[hits.face]),
        frames=frames,
        views=np.einsum("nij,nj->ni", frames, hits.towards).astype(np.float32),
        material=mesh.parts[hits.face].astype(np.int32),
        grid=grid.astype(np.int32),
        polar=True,
    )


def vertex_points(
    mesh: Mesh, tracer: Tracer, eye: npt.ArrayLike | None = None, only: npt.NDArray[np.integer] | None = None
) -> Points:
    """Points at mesh vertices, which keep the file's normals (or the angle-weighted ones where it has none).

    Parameters
    ----------
    eye : (3,) turns the frames to a fixed viewer; None leaves frames that depend on the normal alone, and
        views straight up until `with_eye` sets them
    only : indices of the vertices wanted; None is all
    """
    normals = mesh.normals if mesh.normals is not None else mesh.smooth().normals
    assert normals is not None
    chosen = np.arange(len(mesh.vertices)) if only is None else only
    positions, normal = mesh.vertices[chosen], normals[chosen].astype(np.float64)
    towards = None
    if eye is not None:
        towards = np.asarray(eye, dtype=np.float64) - positions
        towards = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-300)
    frames = hemisphere.frames_from(normal, towards)
    views = np.tile(np.array([0.0, 0.0, 1.0], dtype=np.float32), (len(chosen), 1))
    if towards is not None:
        views = np.einsum("nij,nj->ni", frames, towards).astype(np.float32)
    alone = np.full(len(chosen), hemisphere.ALONE, dtype=np.int32)
    origins = tracer.origins(positions, normal, tracer.vertex_reach[chosen])
    return Points(origins, frames, views, mesh.vertex_part[chosen], alone, eye is not None)


def back_origins(mesh: Mesh, tracer: Tracer) -> npt.NDArray[np.float32]:
    """Ray origins of all vertices on the side away from their normals: (n, 3), as `Tracer.origins` gives them."""
    assert mesh.normals is not None
    return tracer.origins(mesh.vertices, -mesh.normals.astype(np.float64), tracer.vertex_reach)


def with_eye(points: Points, positions: Array, eye: npt.ArrayLike) -> Points:
    """The same points, frames kept, seen from `eye`."""
    towards = np.asarray(eye, dtype=np.float64) - positions
    towards = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-300)
    views = np.einsum("nij,nj->ni", points.frames, towards).astype(np.float32)
    return Points(points.origins, points.frames, views, points.material, points.grid, polar=False)

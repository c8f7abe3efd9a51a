"""The demo's own scene: shapes that show shadows, highlights and occlusion, one part a material."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl.scene.mesh import Mesh

Array = npt.NDArray[np.float64]
Patch = tuple[Array, npt.NDArray[np.int32], Array]

PARTS = ("ground", "knot", "sphere", "vase", "steps")


def build() -> Mesh:
    """A torus knot, a sphere, a vase and steps on a round ground: about 75,000 triangles, y up."""
    patches = [
        _grid(lambda u, v: _disk(u, v, 4.0), 8, 96),
        _grid(_knot, 480, 48),
        _grid(lambda u, v: _revolve(u, v, _ball) + [1.35, 0.62, 0.95], 64, 96),
        _grid(lambda u, v: _revolve(u, v, _vase) + [-1.75, 0.0, 0.55], 96, 96),
        _steps(),
    ]
    vertices, faces, normals, parts = [], [], [], []
    offset = 0
    for part, (position, face, normal) in enumerate(patches):
        vertices.append(position)
        faces.append(face + offset)
        normals.append(normal)
        parts.append(np.full(len(face), part, dtype=np.int32))
        offset += len(position)
    mesh = Mesh.from_arrays(np.concatenate(vertices), np.concatenate(faces), np.concatenate(normals), "demo")
    # from_arrays drops the poles' degenerate triangles, so parts follow the faces that are left.
    part_of_vertex = np.concatenate([np.full(len(p[0]), i, dtype=np.int32) for i, p in enumerate(patches)])
    return Mesh(
        "demo",
        mesh.vertices,
        mesh.faces,
        mesh.normals,
        part_of_vertex[mesh.faces[:, 0]],
        (None,) * len(PARTS),
        (),
    )


def _grid(surface, rows: int, columns: int) -> Patch:  # type: ignore[no-untyped-def]
    """A parametric surface sampled on a grid; normals by central differences, outwards for u × v."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    step = 1e-5
    du = surface(u + step, v) - surface(u - step, v)
    dv = surface(u, v + step) - surface(u, v - step)
    normals = np.cross(dv, du).reshape(-1, 3)
    positions = surface(u, v).reshape(-1, 3)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 1e-16, normals / np.maximum(length, 1e-300), [0.0, 1.0, 0.0])
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = (i * (columns + 1) + j).ravel()
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]).astype(np.int32)
    return positions, faces, normals


def _disk(u: Array, v: Array, radius: float) -> Array:
    angle = 2 * np.pi * u
    return np.stack([radius * v * np.cos(angle), np.zeros_like(u), -radius * v * np.sin(angle)], axis=-1)


def _revolve(u: Array, v: Array, profile) -> Array:  # type: ignore[no-untyped-def]
    radius, height = profile(v)
    angle = 2 * np.pi * u
    return np.stack([radius * np.cos(angle), height, -radius * np.sin(angle)], axis=-1)


def _ball(v: Array) -> tuple[Array, Array]:
    return 0.62 * np.sin(np.pi * v), 0.62 * np.cos(np.pi * v)


def _vase(v: Array) -> tuple[Array, Array]:
    h = 1.0 - v
    return 0.30 + 0.17 * np.sin(2 * np.pi * (0.05 + 0.95 * h)) * (1 - 0.45 * h), 1.7 * h


def _knot(u: Array, v: Array) -> Array:
    """A (2, 3) torus knot standing on the ground; u runs around the tube, v along it."""

    def centre(t: Array) -> Array:
        r = 2.0 + np.cos(3 * t)
        return 0.33 * np.stack([r * np.cos(2 * t), r * np.sin(2 * t), 1.2 * np.sin(3 * t)], axis=-1)

    t = 2 * np.pi * v
    tangent = centre(t + 1e-4) - centre(t - 1e-4)
    tangent = tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)
    middle = centre(t)
    outward = np.cross(tangent, np.cross(middle, tangent))
    outward = outward / np.linalg.norm(outward, axis=-1, keepdims=True)
    side = np.cross(tangent, outward)
    angle = (2 * np.pi * u)[..., None]
    return middle + 0.17 * (np.cos(angle) * outward + np.sin(angle) * side) + [-0.1, 1.2, -0.6]


def _steps() -> Patch:
    """Four blocks, each a corner of hard shadow; flat faces with vertices of their own."""
    corners: list[Array] = []
    faces: list[tuple[int, int, int]] = []
    normals: list[tuple[int, int, int]] = []
    unit = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    outward = [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]
    for step in range(4):
        block = unit * [0.42, 0.22 * (step + 1), 0.9] + [0.15 + 0.42 * step, 0.0, -2.5]
        for side, normal in zip(sides, outward, strict=True):
            base = len(corners)
            corners += list(block[list(side)])
            normals += [normal] * 4
            faces += [(base, base + 1, base + 2), (base, base + 2, base + 3)]
    return np.array(corners), np.array(faces, dtype=np.int32), np.array(normals, dtype=np.float64)

"""Visibility: which directions of each point's hemisphere see the environment, by embree on every core."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.factors import hemisphere

OFFSET = 2e-5
"""Length by which ray origins leave the surface, in bounding-sphere radii. embree's hit points are good to a few
float32 units of the unit sphere (about 5e-7); 40 times that does not hit the same triangle again. It is invisible on an
object by itself, but not where a plane thousands of times its size sets the radius."""

RAYS_PER_TASK = 1 << 16

Progress = Callable[[int], object]


def threads() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Tracer:
    """An embree scene of one mesh.

    Geometry is moved to the origin and scaled to the unit sphere, so that float32 rays are as exact for a
    building in survey coordinates as for a coin.

    Parameters
    ----------
    vertices : (n, 3) float64, world
    faces : (m, 3) int32
    """

    def __init__(self, vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int32]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        used = vertices[np.unique(faces)]
        self.centre = (used.min(axis=0) + used.max(axis=0)) / 2.0
        self.radius = float(np.linalg.norm(used - self.centre, axis=1).max()) or 1.0
        self._scene = EmbreeScene(robust=True)
        local = ((vertices - self.centre) / self.radius).astype(np.float32)
        self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(local), np.ascontiguousarray(faces))

    def _local(self, positions: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return (np.asarray(positions, dtype=np.float64) - self.centre) / self.radius

    def origins(
        self, positions: npt.NDArray[np.float64], normals: npt.NDArray[np.floating]
    ) -> npt.NDArray[np.float32]:
        """Ray origins just off the surface, in the tracer's own coordinates: (n, 3) float32.

        Parameters
        ----------
        positions : (n, 3) world
        normals : (n, 3) unit, of the surface itself (not the interpolated one), on the side of the viewer
        """
        return (self._local(positions) + OFFSET * normals).astype(np.float32)

    def occluded(
        self, origins: npt.NDArray[np.float32], directions: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.bool_]:
        """Whether each ray hits anything. `origins` as `origins()` gives them; both (n, 3) float32."""
        hit = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), query="OCCLUDED"
        )
        return np.asarray(hit >= 0)

    def intersect(
        self, eyes: npt.NDArray[np.float64], directions: npt.NDArray[np.float64]
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
        """First hits of world rays.

        Parameters
        ----------
        eyes, directions : (n, 3) world; directions are unit vectors

        Returns
        -------
        face : (n,) int32, -1 where the ray misses
        barycentric : (n, 2) float64: weights u, v of the face's second and third corner
        """
        # From far away float32 loses the hit: start where the ray enters the unit sphere.
        start = self._local(eyes)
        along = -np.sum(start * directions, axis=1)
        advance = np.maximum(along - 1.01, 0.0)
        start = start + advance[:, None] * directions

        def run(part: slice) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
            hit = self._scene.run(
                np.ascontiguousarray(start[part], dtype=np.float32),
                np.ascontiguousarray(directions[part], dtype=np.float32),
                output=1,
            )
            return hit["primID"], np.stack([hit["u"], hit["v"]], axis=1).astype(np.float64)

        results = _in_parallel(run, len(start), RAYS_PER_TASK)
        if not results:
            return np.empty(0, dtype=np.int32), np.empty((0, 2))
        return np.concatenate([r[0] for r in results]), np.concatenate([r[1] for r in results])

    def visibility(
        self,
        origins: npt.NDArray[np.float32],
        frames: npt.NDArray[np.float32],
        levels: int,
        grid: npt.NDArray[np.int32] | None = None,
        progress: Progress | None = None,
    ) -> npt.NDArray[np.uint32]:
        """Visibility bits of points, one ray a cell of their hemisphere.

        Parameters
        ----------
        origins : (n, 3) float32, as `origins()` gives them
        frames : (n, 3, 3) float32: tangent, bitangent, normal as rows
        levels : of the hemisphere grid: 4**levels rays a point
        grid : (n,) int32, which `hemisphere.cell_offset` each point's rays take; None is the cell's centre
        progress : called with the number of points done, from worker threads

        Returns
        -------
        bits : (n, words) uint32: sample s (Morton order) is bit s % 32 of word s // 32; 1 is visible
        """
        count = quadtree.n_samples(levels)
        words = quadtree.visibility_words(levels)
        bits = np.zeros((len(origins), words), dtype=np.uint32)
        tables: dict[int, npt.NDArray[np.float32]] = {}
        for index in (hemisphere.ALONE,) if grid is None else np.unique(grid):
            tables[int(index)] = hemisphere.directions(levels, hemisphere.cell_offset(int(index)))[:, :3]

        def run(part: slice) -> None:
            local = (
                tables[hemisphere.ALONE]
                if grid is None
                else np.stack([tables[int(index)] for index in grid[part]])
            )
            world = np.matmul(local, frames[part]).reshape(-1, 3)
            hidden = self.occluded(np.repeat(origins[part], count, axis=0), world)
            bits[part] = _pack(~hidden.reshape(-1, count), words)
            if progress is not None:
                progress(part.stop - part.start)

        _in_parallel(run, len(origins), max(1, RAYS_PER_TASK // count))
        return bits

    def light_visibility(
        self,
        origins: npt.NDArray[np.float32],
        normals: npt.NDArray[np.floating],
        lights: npt.NDArray[np.floating],
        progress: Progress | None = None,
    ) -> npt.NDArray[np.uint32]:
        """Which of some world directions each point sees; those below its horizon are not traced.

        Parameters
        ----------
        origins, normals : (n, 3)
        lights : (k, 3) unit, world

        Returns
        -------
        bits : (n, (k + 31) // 32) uint32
        """
        count = len(lights)
        words = (count + 31) // 32
        bits = np.zeros((len(origins), words), dtype=np.uint32)
        towards = np.ascontiguousarray(lights, dtype=np.float32)

        def run(part: slice) -> None:
            visible = np.asarray(normals[part] @ towards.T > 0.0)
            point, light = np.nonzero(visible)
            visible[point, light] = ~self.occluded(origins[part][point], towards[light])
            bits[part] = _pack(visible, words)
            if progress is not None:
                progress(part.stop - part.start)

        _in_parallel(run, len(origins), max(1, RAYS_PER_TASK // max(1, count)))
        return bits


def _pack(visible: npt.NDArray[np.bool_], words: int) -> npt.NDArray[np.uint32]:
    packed = np.packbits(visible, axis=1, bitorder="little")
    padded = np.zeros((len(visible), 4 * words), dtype=np.uint8)
    padded[:, : packed.shape[1]] = packed
    return padded.view("<u4").astype(np.uint32, copy=False)


def _in_parallel(run: Callable[[slice], object], count: int, size: int) -> list:  # type: ignore[type-arg]
    """`run` over slices of at most `size`, on every core; embree and NumPy let go of the GIL."""
    parts = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    if len(parts) <= 1:
        return [run(part) for part in parts]
    with ThreadPoolExecutor(threads()) as pool:
        return list(pool.map(run, parts))

"""Visibility: which directions of each point's hemisphere see the environment, by embree on every core."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.factors import hemisphere, refine

OFFSET = 4 * 2.0**-24
"""Length by which ray origins leave the surface, in units of the surface's `reach`; about 1.2e-7 of the unit sphere on
a mesh by itself. Measured with 640,000 rays, most of them grazing, on spheres, scans, an apartment full of slivers, and
a flat and a tilted ground of up to 10^4 times the object: at a quarter of it up to a quarter of the rays hit the
triangle they leave, at half of it none does. One length of 2e-5 for all was safe as well, but on a ground of 10^4 times
its size the bunny got its light under an open sky wrong by 67 % and the ground by 8 %; now all bits are right."""

REACH = (1e-6, 8.0)
"""Bounds of `reach`. An axis-aligned plane through the centre is exact in float32, and yet its origins must leave it;
slivers without area must not push those of their neighbours away."""

RAYS_PER_TASK = 1 << 16

Progress = Callable[[int], object]


def threads() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class RayCount:
    """How many rays were traced, from all threads."""

    def __init__(self) -> None:
        self.rays = 0
        self._adding = threading.Lock()

    def add(self, rays: int) -> None:
        with self._adding:
            self.rays += rays


class Tracer:
    """An embree scene of one mesh.

    Geometry is moved to the origin and scaled to the unit sphere, so that float32 rays are as exact for a
    building in survey coordinates as for a coin.

    Parameters
    ----------
    vertices : (n, 3) float64, world
    faces : (m, 3) int32

    Attributes
    ----------
    vertex_reach, face_reach : (n,), (m,) float64: how far float32 moves the surface there along its normal, in
        units of 2**-24 of the unit sphere, see `origins`
    count : of the rays that `occluded` has traced so far; camera rays are not among them
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
        # Positions interpolated in world coordinates carry float64's rounding, which survey coordinates magnify.
        least = REACH[0] + 2.0**-27 * float(np.abs(self.centre).max()) / self.radius
        self.vertex_reach, self.face_reach = _reach(local, faces, least)
        self.count = RayCount()

    @property
    def rays(self) -> int:
        """Rays that `occluded` has traced so far, whoever asked for them."""
        return self.count.rays

    def _local(self, positions: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return (np.asarray(positions, dtype=np.float64) - self.centre) / self.radius

    def origins(
        self,
        positions: npt.NDArray[np.float64],
        normals: npt.NDArray[np.floating],
        reach: npt.NDArray[np.float64] | None = None,
    ) -> npt.NDArray[np.float32]:
        """Ray origins just off the surface, in the tracer's own coordinates: (n, 3) float32.

        Parameters
        ----------
        positions : (n, 3) world
        normals : (n, 3) unit, of the surface itself (not the interpolated one), on the side of the viewer
        reach : (n,) the tracer's `face_reach` or `vertex_reach` where the positions lie; None takes the largest of
            all, which serves for positions anywhere, but lifts them more than need be where a large tilted plane
            is part of the mesh
        """
        away = OFFSET * (self.face_reach.max() if reach is None else np.asarray(reach)[:, None])
        return (self._local(positions) + away * normals).astype(np.float32)

    def occluded(
        self,
        origins: npt.NDArray[np.float32],
        directions: npt.NDArray[np.float32],
        own: RayCount | None = None,
    ) -> npt.NDArray[np.bool_]:
        """Whether each ray hits anything. `origins` as `origins()` gives them; both (n, 3) float32.

        They are added to `count`, and to `own` if the caller counts its own beside those of others.
        """
        hit = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), query="OCCLUDED"
        )
        for count in (self.count, own):
            if count is not None:
                count.add(len(origins))
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

        results = in_parallel(run, len(start), RAYS_PER_TASK)
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
        *,
        every: bool = False,
        traced: RayCount | None = None,
    ) -> npt.NDArray[np.uint32]:
        """Visibility bits of points, at one place in each cell of their hemisphere.

        Parameters
        ----------
        origins : (n, 3) float32, as `origins()` gives them
        frames : (n, 3, 3) float32: tangent, bitangent, normal as rows
        levels : of the hemisphere grid: 4**levels cells
        grid : (n,) int32, which `hemisphere.cell_offset` each point's rays take; None is the cell's centre
        progress : called with the number of points done, from worker threads
        every : trace all cells; otherwise, from 4**5 cells on, those alone that `refine` needs
        traced : counts the rays of this call alone

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
            world, own = np.matmul(local, frames[part]), origins[part]
            if every or levels < refine.FROM:
                hidden = self.occluded(np.repeat(own, count, axis=0), world.reshape(-1, 3), traced)
                seen = ~hidden.reshape(-1, count)
            else:
                rays = world.reshape(-1, 3)
                seen = refine.visibility(
                    len(own), levels,
                    lambda point, sample: ~self.occluded(
                        np.take(own, point, axis=0), np.take(rays, point * count + sample, axis=0), traced
                    ),
                )  # fmt: skip
            bits[part] = pack(seen, words)
            if progress is not None:
                progress(part.stop - part.start)

        in_parallel(run, len(origins), max(1, RAYS_PER_TASK // count))
        return bits

    def light_visibility(
        self,
        origins: npt.NDArray[np.float32],
        normals: npt.NDArray[np.floating],
        lights: npt.NDArray[np.floating],
        progress: Progress | None = None,
        runs: npt.NDArray[np.integer] | None = None,
        *,
        horizon: bool = True,
        traced: RayCount | None = None,
    ) -> npt.NDArray[np.uint32]:
        """Which of some world directions each point sees; those below its horizon it does not.

        Parameters
        ----------
        origins, normals : (n, 3)
        lights : (k, 3) unit, world
        runs : (m,) ascending from 0, where runs of neighbouring directions begin. Of a run the first, the middle and
            the last are traced, the others only where those three differ. None traces all.
        horizon : leave out the rays of those below it
        traced : counts the rays of this call alone

        Returns
        -------
        bits : (n, (k + 31) // 32) uint32
        """
        count = len(lights)
        words = (count + 31) // 32
        bits = np.zeros((len(origins), words), dtype=np.uint32)
        towards = np.ascontiguousarray(lights, dtype=np.float32)

        starts = np.arange(count) if runs is None else np.asarray(runs)
        sizes = np.diff(np.append(starts, count))
        probe = np.zeros(count, dtype=np.bool_)
        for place in (starts, starts + sizes // 2, starts + sizes - 1):
            probe[place] = True

        def run(part: slice) -> None:
            above = np.asarray(normals[part] @ towards.T > 0.0)
            visible = above.copy()

            def trace(which: npt.NDArray[np.bool_]) -> None:
                point, light = np.nonzero(which)
                visible[point, light] = ~self.occluded(origins[part][point], towards[light], traced)

            trace((above if horizon else np.ones_like(above)) & probe)
            visible &= above
            if not probe.all():
                # A run that crosses the horizon is traced: there its probes are too few.
                whole = np.logical_and.reduceat(above | ~probe, starts, axis=1)
                every = whole & np.logical_and.reduceat(visible | ~probe, starts, axis=1)
                none = whole & ~np.logical_or.reduceat(visible & probe, starts, axis=1)
                left = above & ~probe
                visible[left] = np.repeat(every, sizes, axis=1)[left]
                trace(left & ~np.repeat(every | none, sizes, axis=1))
            bits[part] = pack(visible, words)
            if progress is not None:
                progress(part.stop - part.start)

        in_parallel(run, len(origins), max(1, RAYS_PER_TASK // max(1, count)))
        return bits


def sees_all(bits: npt.NDArray[np.uint32], levels: int) -> npt.NDArray[np.bool_]:
    """(n,) whether every one of a point's 4**levels rays reaches the light: bits (n, words)."""
    return np.asarray((bits == np.uint32(0xFFFFFFFF >> max(0, 32 - quadtree.n_samples(levels)))).all(axis=1))


def _reach(
    local: npt.NDArray[np.float32], faces: npt.NDArray[np.int32], least: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """How far float32 moves each triangle along its normal n, in units of 2**-24; vertices take the most of theirs.

    Rounding moves corner v by at most Σ_k |n_k| |v_k|. embree's distance is (v − o) · (a × b) / |a × b| with edges
    a, b, whose product is rounded as well: Σ_k e_k (|a_i| |b_j| + |a_j| |b_i|) / |a × b| for the triangle's extent e.
    Both are small for a triangle that is small and near the centre, and along the normal of an axis-aligned plane of
    any size; both are about 1 for a large tilted plane, however near the point on it is.

    Parameters
    ----------
    local : (n, 3), in the unit sphere
    faces : (m, 3)
    least : bound from below

    Returns
    -------
    vertices : (n,), 0 where no face uses them; faces : (m,), the most of their corners', since a ray may as well hit
        the neighbour
    """
    corners = local[faces].astype(np.float64)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = np.cross(a, b)
    area = np.maximum(np.linalg.norm(cross, axis=1), 1e-300)
    a, b = np.abs(a), np.abs(b)
    products = np.stack([a[:, i] * b[:, j] + a[:, j] * b[:, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    moved = np.abs(cross) * np.abs(corners).max(axis=1) + np.ptp(corners, axis=1) * products
    bounded = np.clip(moved.sum(axis=1) / area, least, max(least, REACH[1]))
    vertices = np.zeros(len(local))
    for corner in faces.T:
        np.maximum.at(vertices, corner, bounded)
    return vertices, vertices[faces].max(axis=1)


def pack(visible: npt.NDArray[np.bool_], words: int) -> npt.NDArray[np.uint32]:
    """Bits (n, words) of what (n, samples) is visible, filled up with zeros."""
    packed = np.packbits(visible, axis=1, bitorder="little")
    padded = np.zeros((len(visible), 4 * words), dtype=np.uint8)
    padded[:, : packed.shape[1]] = packed
    return padded.view("<u4").astype(np.uint32, copy=False)


def in_parallel(run: Callable[[slice], object], count: int, size: int) -> list:  # type: ignore[type-arg]
    """`run` over slices of at most `size`, on every core; embree and NumPy let go of the GIL."""
    parts = [slice(start, min(start + size, count)) for start in range(0, count, size)]
    if len(parts) <= 1:
        return [run(part) for part in parts]
    pool = ThreadPoolExecutor(threads())
    try:
        return list(pool.map(run, parts))
    finally:
        # Leaving a `with` would finish all that waits, so that Ctrl-C could go unanswered for the whole job.
        pool.shutdown(cancel_futures=True)

"""Visibility of pixels over one shared grid of directions: a ray a cell, the sub-pixel points taking turns.

A pixel's visibility is an integral over its area and over a cell's directions. One ray for each cell samples it: rays
of neighbouring cells leave from different sub-pixel points, at random places in their cells, so more points a pixel
cost no more rays. As in `prtcl.factors.refine` only the cells are traced whose neighbours disagree.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.errors import InputError
from prtcl.factors import refine, sphere
from prtcl.factors import visibility as rays
from prtcl.factors.visibility import Progress, Tracer

PLACES = 16
"""Sets of places in the cells; neighbouring pixels take different ones."""
BLOCKS = 16
"""Blocks along a hemisphere's side in which rays go first (bench/relight_choices.py)."""

AXES = np.array([a for a in product((-1, 0, 1), repeat=3) if any(a)], dtype=np.float32)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
"""World directions along which a pixel's outermost points are known: any other is within 28 degrees of one."""
UNEVEN = 0.15
"""Length by which normals within a pixel differ from their mean, from which its probes may all lie on one of two
surfaces: it traces every sample of hard light."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """Which points make up each pixel: those of pixel p are first[p] … first[p + 1] − 1.

    Attributes
    ----------
    first : (pixels + 1,) int32, strictly ascending from 0
    phase : (pixels,) int32: which point a pixel's first cell takes, and which set of places, so that both change from
        pixel to pixel
    """

    first: npt.NDArray[np.int32]
    phase: npt.NDArray[np.int32]

    @classmethod
    def of(cls, pixel: npt.ArrayLike) -> Pixels:
        """Of the pixel that each point belongs to, (n,) integers whose equals stand together.

        Raises
        ------
        InputError
            If a pixel's points are scattered, or there are none.
        """
        own = np.asarray(pixel)
        if own.ndim != 1 or not own.size:
            raise InputError(
                f"pixel: expected one integer for each of at least one point, got shape {own.shape}"
            )
        starts = np.flatnonzero(np.append(True, own[1:] != own[:-1]))
        if len(np.unique(own)) != len(starts):
            raise InputError(
                "pixel: expected the points of each pixel to stand together; sort the points by pixel"
            )
        first = np.append(starts, own.size).astype(np.int32)
        # A hash of the pixel's own number: the same wherever it stands among others.
        return cls(first, ((own[starts].astype(np.uint64) * 2654435761 >> 12) & 0xFFFF).astype(np.int32))

    def __len__(self) -> int:
        return len(self.phase)

    def point(self, pixel: npt.NDArray[np.integer], turn: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
        """The point that takes a pixel's turn number `turn`."""
        start = self.first[pixel]
        return np.asarray(
            start + (turn + self.phase[pixel]) % (self.first[pixel + 1] - start), dtype=np.int64
        )


def soft_visibility(
    tracer: Tracer,
    origins: npt.NDArray[np.float32],
    normals: npt.NDArray[np.float32],
    pixels: Pixels,
    levels: int,
    progress: Progress | None = None,
    *,
    every: bool = False,
) -> npt.NDArray[np.uint32]:
    """Which cells of the sphere each pixel sees: (pixels, words) uint32, cell c is bit c % 32 of word c // 32.

    Parameters
    ----------
    origins, normals : (points, 3) float32; what lies below a point's horizon is hidden from it
    levels : of the grid, at least 3: `sphere.n_cells` cells
    progress : called with the number of pixels done, from worker threads
    every : trace all cells above the horizon
    """
    count = quadtree.n_samples(levels)
    table = sphere.places(levels, PLACES)
    bits = np.zeros((len(pixels), sphere.n_cells(levels) // 32), dtype=np.uint32)

    def run(part: slice) -> None:
        def visible(row: npt.NDArray[np.intp], sample: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
            pixel, half = part.start + row // 2, row % 2
            point = pixels.point(pixel, cell_turns(half * count + sample))
            direction = table[(pixels.phase[pixel] >> 4) % PLACES, half * count + sample]
            seen = np.einsum("nx,nx->n", normals[point], direction) > 0.0
            up = np.flatnonzero(seen)
            seen[up] = ~tracer.occluded(origins[point[up]], direction[up])
            return seen

        rows = 2 * (part.stop - part.start)
        if every or levels < refine.FROM:
            row, sample = np.divmod(np.arange(rows * count), count)
            seen = visible(row, sample).reshape(rows, count)
        else:
            seen = refine.visibility(rows, levels, visible, BLOCKS)
        bits[part] = rays.pack(seen.reshape(rows // 2, 2 * count), bits.shape[1])
        if progress is not None:
            progress(rows // 2)

    rays.in_parallel(run, len(pixels), max(1, 8 * rays.RAYS_PER_TASK // sphere.n_cells(levels)))
    return bits


def cell_turns(cell: npt.NDArray[np.integer]) -> npt.NDArray[np.integer]:
    """Whose turn each cell is: any sixteen cells of a square take sixteen points, in an order of their own.

    Without the order the rays that `refine` begins with, at the same corner of every block, would all leave from one
    point. kernels/pixel_transport.cl has the same.
    """
    return np.asarray(cell ^ (cell >> 4) ^ (cell >> 8) ^ (cell >> 12))


@dataclass(frozen=True, eq=False)
class HardRays:
    """Hard samples as pixels see them.

    Attributes
    ----------
    lights : (k, 3) float32 unit, world
    turns : (k,) int32: each sample leaves from the pixel's point whose turn this is
    begin : (g + 1,) int32: groups of samples
    traced : (g,) bool: of these groups all samples are traced where their probes differ or the pixel is `UNEVEN`. The
        rest are left to the soft light's bits (`sphere.around`).
    probes, outwards : (g, p, 3) float32: rays of each group that are traced in any case. Each leaves from the pixel's
        point that lies farthest outwards
    """

    lights: npt.NDArray[np.float32]
    turns: npt.NDArray[np.int32]
    begin: npt.NDArray[np.int32]
    traced: npt.NDArray[np.bool_]
    probes: npt.NDArray[np.float32]
    outwards: npt.NDArray[np.float32]


def hard_visibility(
    tracer: Tracer,
    origins: npt.NDArray[np.float32],
    normals: npt.NDArray[np.float32],
    pixels: Pixels,
    hard: HardRays,
) -> npt.NDArray[np.uint32]:
    """Which hard samples each pixel sees: (pixels, (k + 31) // 32) uint32, none of those that are not traced.

    A pixel that sees all probes of a group sees it all, also the samples below some point's horizon, which the cosine
    leaves out. An edge at distance D from the pixel lets a ray from x in direction d pass if n · (x + D d) exceeds a
    number of its own: what it may cut off first are the rays that lie farthest along n in both. So probes are the
    outermost of a group from the outermost points of the pixel, once around; of any straight edge that parts pixel and
    light between them hardly any stays unseen, or it would show as a jump when the light turns (bench/flicker.py).
    """
    lights, turns, begin = hard.lights, hard.turns, hard.begin
    count = len(lights)
    bits = np.zeros((len(pixels), (count + 31) // 32), dtype=np.uint32)
    groups = np.flatnonzero(hard.traced)
    if not len(groups):
        return bits
    sizes = np.diff(begin)[groups]
    columns = np.repeat(begin[groups] - np.cumsum(sizes) + sizes, sizes) + np.arange(sizes.sum())
    probes, each = hard.probes[groups].reshape(-1, 3), hard.probes.shape[1]
    axis = np.argmax(hard.outwards[groups].reshape(-1, 3) @ AXES.T, axis=1)
    corners = outermost(origins, pixels)
    mean = np.add.reduceat(normals, pixels.first[:-1], axis=0) / np.diff(pixels.first)[:, None]
    # No point of a pixel faces a direction that lies further below the mean horizon than its normals spread.
    away = normals - np.repeat(mean, np.diff(pixels.first), axis=0)
    margin = np.maximum.reduceat(np.sqrt(np.einsum("nx,nx->n", away, away)), pixels.first[:-1]) + 1e-6

    def trace(point: npt.NDArray[np.int64], towards: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
        """Which rays reach the light: those above their point's horizon that meet nothing."""
        seen = np.einsum("nx,nx->n", normals[point], towards) > 0.0
        up = np.flatnonzero(seen)
        seen[up] = ~tracer.occluded(origins[point[up]], towards[up])
        return np.asarray(seen)

    def run(part: slice) -> None:
        pixel = np.arange(part.start, part.stop)
        probed = np.zeros((len(pixel), len(probes)), dtype=np.bool_)
        row, column = np.nonzero(mean[part] @ probes.T > -margin[part, None])
        probed[row, column] = trace(corners[pixel[row], axis[column]], probes[column])
        found = probed.reshape(len(pixel), -1, each).sum(axis=2)
        mixed = ((found > 0) & (found < each)) | (margin[part] > UNEVEN)[:, None]
        seen = np.repeat((found == each) & ~mixed, sizes, axis=1)
        row, column = np.nonzero(np.repeat(mixed, sizes, axis=1))
        light = columns[column]
        seen[row, column] = trace(pixels.point(pixel[row], turns[light]), lights[light])
        visible = np.zeros((len(pixel), count), dtype=np.bool_)
        visible[:, columns] = seen
        bits[part] = rays.pack(visible, bits.shape[1])

    rays.in_parallel(run, len(pixels), max(1, 8 * rays.RAYS_PER_TASK // count))
    return bits


def outermost(origins: npt.NDArray[np.float32], pixels: Pixels) -> npt.NDArray[np.int64]:
    """The point of each pixel that lies farthest along each of `AXES`: (pixels, 26)."""
    counts, starts = np.diff(pixels.first), pixels.first[:-1]
    owner = np.repeat(np.arange(len(pixels)), counts)
    out = np.empty((len(pixels), len(AXES)), dtype=np.int64)
    for number, axis in enumerate(AXES):
        along = origins @ axis
        at = np.flatnonzero(along == np.repeat(np.maximum.reduceat(along, starts), counts))[::-1]
        out[owner[at], number] = at  # of several the first
    return out

"""BRDF slices f_v: reflectance times cosine for given view directions, as Haar coefficients on the device."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import hemisphere
from prtcl.factors.material import COLOURED_CONDUCTOR, KINDS, Material, pack
from prtcl.wavelet import haar

GROUP = 64
GRAZING = 1e-4
"""Cosine of the most grazing view a slice is made for; f_v has a limit there, but 0/0 at 0 itself."""
SHARP = 0.0015
"""Roughness below which four levels of subsamples miss the lobe: at levels = 7 the albedo of GGX α = 0.001 came out
5 % high at normal incidence and 12 % low at 75 degrees (tests/test_brdf.py holds it to 1 %, as it is now)."""
SHARP_LEVELS, SHARP_FROM = 13, 7
"""Levels of the grid that the few cells about such a lobe are averaged over, in slices of at least `SHARP_FROM`."""
BLOCK = 2
"""Levels of the blocks in which that is done: 4 × 4 cells, one run of the slice."""


class Materials:
    """Packed materials on a device.

    Parameters
    ----------
    materials : one or more
    every_term : build kernels for all kinds of materials, not only for those that are there
    """

    def __init__(self, device: Device, materials: list[Material], every_term: bool = False) -> None:
        if not materials:
            raise InputError("materials: expected at least one")
        self.device, self.list = device, materials
        ints, reals, tables = pack(materials)
        self.ints = device.array(ints, np.int32)
        self.reals, self.tables = device.array(reals), device.array(tables)
        self.mask = int(np.bitwise_or.reduce([1 << KINDS.index(m.kind) for m in materials]))
        if any(m.kind == "ggx-conductor" and not m.grey for m in materials):
            self.mask |= 1 << COLOURED_CONDUCTOR
        if every_term:
            self.mask = (1 << (COLOURED_CONDUCTOR + 1)) - 1
        self.channels = 1 if all(m.grey for m in materials) else 3

    @property
    def arguments(self) -> tuple[Any, Any, Any]:
        """What every kernel that evaluates a BRDF takes first."""
        return self.ints, self.reals, self.tables

    def slices(self, views: npt.ArrayLike, levels: int, sub: int | None = None) -> Any:
        """f_v of every material for every view: device array (materials, views, channels, 4**levels).

        Parameters
        ----------
        views : (n, 3) local outgoing directions, z > 0
        levels : of the coefficients; each cell is averaged over 4**sub directions
        sub : None takes what the material's sharpness needs (`subsamples`)
        """
        count = len(np.atleast_2d(views))
        samples = self.device.empty((len(self.list), count, self.channels, 4**levels))
        for index in range(len(self.list)):
            self._average(index, views, levels, sub, samples, index * count)
        return haar.forward(self.device, samples)

    def slices_of(self, index: int, views: npt.ArrayLike, levels: int) -> Any:
        """f_v of one material: what `slices` gives for it, (views, channels, 4**levels), bit for bit."""
        samples = self.device.empty((len(np.atleast_2d(views)), self.channels, 4**levels))
        self._average(index, views, levels, None, samples, 0)
        return haar.forward(self.device, samples)

    def _average(
        self, index: int, views: npt.ArrayLike, levels: int, sub: int | None, samples: Any, first: int
    ) -> None:
        """f_v of a material, averaged over the cells, into slices `first`, `first` + 1, … of `samples`."""
        directions = np.zeros((len(np.atleast_2d(views)), 4))
        directions[:, :3] = views
        directions[:, 2] = np.maximum(directions[:, 2], GRAZING)
        material, device = self.list[index], self.device
        depth = subsamples(material, levels) if sub is None else sub
        cells = device.constant(
            ("directions", levels + depth), partial(hemisphere.directions, levels + depth)
        )
        self._launch(index, levels, depth, cells, directions, samples, first)
        if sub is None and material.roughness < SHARP and levels >= SHARP_FROM:
            self._refine(index, directions, levels, samples, first)

    def _launch(
        self, index: int, levels: int, depth: int, cells: Any, directions: npt.NDArray[np.float64],
        samples: Any, first: int,
    ) -> None:  # fmt: skip
        device = self.device
        kernel = device.kernels(
            "brdf.cl", LEVELS=levels, SUB=depth, CHANNELS=self.channels, KINDS=self.mask, GROUP=GROUP
        )["brdf_slices"]
        device.launch(
            kernel, 4**levels, GROUP, *self.arguments, index, cells, device.array(directions), samples, first,
            y=len(directions),
        )  # fmt: skip

    def _refine(
        self, index: int, directions: npt.NDArray[np.float64], levels: int, samples: Any, first: int
    ) -> None:
        """Average the cells about each view's mirror direction once more, on a grid of `SHARP_LEVELS`.

        Everywhere a grid so fine would take 4,096 evaluations a cell. A cell away from the peak the lobe varies over
        ten times the width of the usual subsamples and more.
        """
        side = 1 << levels
        row, column = (x * side for x in reversed(hemisphere.to_square(directions[:, :3] * [-1, -1, 1])))
        morton = quadtree.grid_to_morton(levels - BLOCK)
        pairs: set[tuple[int, int]] = set()
        for r, c in ((r, c) for r in (-1, 1) for c in (-1, 1)):  # the blocks within a cell of the peak
            at = [np.clip(x, 0, side - 1).astype(np.int64) >> BLOCK for x in (row + r, column + c)]
            pairs.update(zip(morton[at[0], at[1]].tolist(), range(len(directions)), strict=True))
        blocks, views = np.array(sorted(pairs)).T
        rows = samples.reshape(-1, 4**levels)
        for block in np.unique(blocks):
            chosen = views[blocks == block]
            cells = self.device.array(block_directions(levels, SHARP_LEVELS, int(block)))
            averages = self.device.empty((len(chosen) * self.channels, 4**BLOCK))
            self._launch(index, BLOCK, SHARP_LEVELS - levels, cells, directions[chosen], averages, 0)
            ends = [*(np.flatnonzero(np.diff(chosen) > 1) + 1).tolist(), len(chosen)]
            for start, end in zip([0, *ends[:-1]], ends, strict=True):  # runs of views that follow each other
                run = averages[start * self.channels : end * self.channels]
                at_row = (first + int(chosen[start])) * self.channels
                self.device.paste(run, rows, at_row, int(block) << (2 * BLOCK), stage="brdf_slices")

    def evaluate(
        self, index: int, incident: npt.ArrayLike, outgoing: npt.ArrayLike
    ) -> npt.NDArray[np.float64]:
        """f of material `index` for pairs of local directions, without the cosine: (n, 3), 1/sr."""
        first, second = np.broadcast_arrays(np.atleast_2d(incident), np.atleast_2d(outgoing))
        pairs = np.zeros((2, len(first), 4))
        pairs[0, :, :3], pairs[1, :, :3] = first, second
        device = self.device
        kernel = device.kernels(
            "brdf.cl", LEVELS=1, SUB=0, CHANNELS=self.channels, KINDS=self.mask, GROUP=GROUP
        )["brdf_evaluate"]
        out = device.empty((len(first), 4))
        device.launch(
            kernel, len(first), GROUP, *self.arguments, index,
            device.array(pairs[0]), device.array(pairs[1]), out, len(first),
        )  # fmt: skip
        return np.asarray(out.get()[:, :3])


def subsamples(material: Material, levels: int) -> int:
    """Levels of subsamples in a cell: two at least, and as many as put four samples across a lobe.

    The reflected lobe of GGX is about 2 · 0.64 α wide at half its peak each way (α = 0.1: 7 degrees); a cell is
    √(2π/4**levels) wide. Four levels (256 evaluations a cell) are the most.
    """
    cell = math.sqrt(2 * math.pi) / 2**levels
    return int(np.clip(math.ceil(math.log2(max(1.0, 4 * cell / (2.6 * material.roughness)))), 1, 4))


def block_directions(levels: int, finest: int, block: int) -> npt.NDArray[np.float32]:
    """`hemisphere.directions(finest)` of the `block`-th square of 4**BLOCK cells of 4**levels, without the others.

    Returns
    -------
    directions : (4**(finest − levels + BLOCK), 4) float32
    """
    inside = finest - levels + BLOCK
    row, column = (int(x[block]) << inside for x in quadtree.morton_to_grid(levels - BLOCK))
    rows, columns = (
        x + first for x, first in zip(quadtree.morton_to_grid(inside), (row, column), strict=True)
    )
    side = 1 << finest
    out = np.empty((rows.size, 4), dtype=np.float32)
    out[:, :3] = hemisphere.from_square((columns + 0.5) / side, (rows + 0.5) / side)
    out[:, 3] = hemisphere.mean_cosines(rows, columns, side)
    return out


@dataclass(frozen=True, eq=False)
class ViewTable:
    """Which views slices are stored for, and how a point's view is interpolated between them.

    Attributes
    ----------
    views : (n, 3) local directions of the stored slices
    polar : True where all views lie in the plane of tangent and normal (frames turned to the viewer), at
        equal steps of the angle; False for the nodes of a square grid over the concentric map
    nodes : along each axis
    """

    views: npt.NDArray[np.float64]
    polar: bool
    nodes: int

    @classmethod
    def make(cls, polar: bool, nodes: int) -> ViewTable:
        """A table of `nodes` view angles, or of `nodes` × `nodes` directions."""
        if nodes < 2:
            raise InputError(f"views: expected at least 2, got {nodes}")
        if polar:
            theta = np.linspace(0.0, np.pi / 2, nodes)
            views = np.stack([np.sin(theta), np.zeros(nodes), np.cos(theta)], axis=1)
            return cls(views, True, nodes)
        edge = np.linspace(0.0, 1.0, nodes)
        v, u = np.meshgrid(edge, edge, indexing="ij")
        return cls(hemisphere.from_square(u.ravel(), v.ravel()), False, nodes)

    def locate(self, views: npt.ArrayLike) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]:
        """Stored slices and weights for local view directions (n, 3): (n, 2) polar, (n, 4) square.

        A view below the horizon gets zero weights: nothing is reflected there.
        """
        local = np.atleast_2d(np.asarray(views, dtype=np.float64))
        above = local[:, 2] > 0.0
        if self.polar:
            sine = np.hypot(local[:, 0], local[:, 1])
            low, weight = self._interval(np.arctan2(sine, local[:, 2]) / (np.pi / 2))
            index = np.stack([low, low + 1], axis=1)
            weights = np.stack([1 - weight, weight], axis=1)
        else:
            u, v = hemisphere.to_square(local)
            (i, wi), (j, wj) = self._interval(u), self._interval(v)
            index = np.stack([(j + dj) * self.nodes + i + di for dj in (0, 1) for di in (0, 1)], axis=1)
            weights = np.stack(
                [np.abs(1 - dj - wj) * np.abs(1 - di - wi) for dj in (0, 1) for di in (0, 1)], axis=1
            )
        return index.astype(np.int32), np.where(above[:, None], weights, 0.0).astype(np.float32)

    def _interval(self, t: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        at = np.clip(t, 0.0, 1.0) * (self.nodes - 1)
        low = np.minimum(at.astype(np.int64), self.nodes - 2)
        return low, at - low

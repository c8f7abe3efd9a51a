"""BRDF slices f_v: reflectance times cosine for given view directions, as Haar coefficients on the device."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import hemisphere
from prtcl.factors.material import KINDS, Material, pack
from prtcl.wavelet import haar

GROUP = 64
GRAZING = 1e-4
"""Cosine of the most grazing view a slice is made for; f_v has a limit there, but 0/0 at 0 itself."""


class Materials:
    """Packed materials on a device.

    Parameters
    ----------
    materials : one or more
    """

    def __init__(self, device: Device, materials: list[Material]) -> None:
        if not materials:
            raise InputError("materials: expected at least one")
        self.device, self.list = device, materials
        ints, reals, tables = pack(materials)
        self.ints = device.array(ints, np.int32)
        self.reals, self.tables = device.array(reals), device.array(tables)
        self.mask = int(np.bitwise_or.reduce([1 << KINDS.index(m.kind) for m in materials]))
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
        directions = np.zeros((len(np.atleast_2d(views)), 4))
        directions[:, :3] = views
        directions[:, 2] = np.maximum(directions[:, 2], GRAZING)
        count, device = len(directions), self.device
        samples = device.empty((len(self.list), count, self.channels, 4**levels))
        towards = device.array(directions)
        for index, material in enumerate(self.list):
            depth = subsamples(material, levels) if sub is None else sub
            kernel = device.kernels(
                "brdf.cl", LEVELS=levels, SUB=depth, CHANNELS=self.channels, KINDS=self.mask, GROUP=GROUP
            )["brdf_slices"]
            cells = device.constant(
                ("directions", levels + depth), partial(hemisphere.directions, levels + depth)
            )
            device.launch(
                kernel,
                4**levels,
                GROUP,
                *self.arguments,
                index,
                cells,
                towards,
                samples,
                index * count,
                y=count,
            )
        return haar.forward(device, samples)

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

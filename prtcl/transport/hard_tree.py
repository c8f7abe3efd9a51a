"""Hard light for editing: a tree over the light's samples, its visible energy at every point, and cuts of it.

A sun of two hundred samples is one direction for a matt surface. So what is kept of a point's hard light is the visible
energy of every node of a binary tree over the samples, and a material takes the coarsest cut whose nodes are narrow
against its lobe: f is evaluated once a node. `prtcl.transport.cut` does the same for the soft light; the idea is that
of Walter et al. 2005, "Lightcuts".
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import DeviceError
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.wavelet import pyramid

GROUP = 64
RUN, NEAR = 8, 0.1
"""Samples of a run at most, and its extent in rad: three of them are traced, and all where these differ.

By bench/hard_runs.py that takes two thirds of the rays and moves the irradiance of an environment's peaks by 0.03 to
0.27 % (relative RMSE), 7 % of the mean at the worst of 48,000 vertices; runs of 32 take a half of the rays, and err by
0.13 to 0.48 % and 12 %.
"""
Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Tree:
    """Nodes over hard samples, the root first; a parent stands before its children.

    Attributes
    ----------
    order : (k,) the samples in the tree's order, in which every node is a range
    ranges : (n, 2) first and last + 1 of each node's samples
    children : (n, 2) nodes, -1 at a leaf
    centres : (n, 3) world, the mean direction by energy
    extents : (n,) rad, the root mean square distance of the node's samples from its centre, by energy
    shares : (n,) of the whole energy
    """

    order: Indices
    ranges: Indices
    children: Indices
    centres: Array
    extents: Array
    shares: Array

    @classmethod
    def over(cls, hard: Array) -> Tree:
        """The tree over samples (k, 6), direction and energy: halved at the energy median of the longest axis."""
        directions, weight = hard[:, :3], hard[:, 3:].mean(axis=1)
        total = max(float(weight.sum()), 1e-300)
        order, centres, extents, shares = np.arange(len(hard)), [], [], []
        ranges: list[tuple[int, int]] = []
        children: list[list[int]] = []
        waiting = [(0, len(hard), -1, 0)] if len(hard) else []
        while waiting:
            first, last, parent, side = waiting.pop()
            if parent >= 0:
                children[parent][side] = len(ranges)
            members = order[first:last]
            w = weight[members]
            w = w / w.sum() if w.sum() > 0 else np.full(len(w), 1 / len(w))
            mean = w @ directions[members]
            spread = directions[members] - mean
            variance = w @ spread**2
            ranges.append((first, last))
            children.append([-1, -1])
            centres.append(mean / max(float(np.linalg.norm(mean)), 1e-300))
            extents.append(float(np.sqrt(variance.sum())))
            shares.append(float(weight[members].sum()) / total)
            if last - first > 1:
                members = members[np.argsort(directions[members, int(np.argmax(variance))], kind="stable")]
                order[first:last] = members
                running = np.cumsum(weight[members])
                middle = int(np.clip(np.searchsorted(running, running[-1] / 2) + 1, 1, last - first - 1))
                node = len(ranges) - 1
                waiting += [(first + middle, last, node, 1), (first, first + middle, node, 0)]
        return cls(
            order.astype(np.int32),
            np.array(ranges, dtype=np.int32).reshape(-1, 2),
            np.array(children, dtype=np.int32).reshape(-1, 2),
            np.array(centres).reshape(-1, 3),
            np.array(extents),
            np.array(shares),
        )

    def runs(self, size: int = RUN) -> Indices:
        """Where runs of at most `size` neighbouring samples begin, in the tree's order: its largest such nodes."""
        starts, waiting = [], [0] if len(self.ranges) else []
        while waiting:
            node = waiting.pop()
            first, last = self.ranges[node]
            if last - first == 1 or (last - first <= size and self.extents[node] <= NEAR):
                starts.append(first)
            else:
                waiting += self.children[node].tolist()
        return np.array(sorted(starts), dtype=np.int32)

    def cut(self, width: float, error: float) -> Indices:
        """A coarse cut for a lobe.

        Parameters
        ----------
        width : GGX α of the lobe, `Material.roughness`
        error : relative to the mean radiance that these samples give; 0 takes every sample

        Notes
        -----
        No node is wider than the lobe: light would turn up where there is none. Over a node of extent d half-vectors
        turn by d/2, of which a lobe of width α sees d/2α, and the cosine changes by d: at most so much of the node's
        share of the energy is misplaced. A lobe is met by one light in 1/2α² of the hemisphere's, and is as much
        brighter there. So the error's square, relative to the mean, is about Σ (share · max(d, d/2α))² / 2α².
        """
        if not len(self.ranges):
            return np.zeros(0, dtype=np.int32)
        inner = self.children[:, 0] >= 0
        terms = np.where(inner, self.shares * self.extents / min(1.0, 2 * width), 0.0) ** 2
        allowed = error**2 * min(1.0, 2 * width**2)
        wide = self.extents > width
        # What must be split comes first.
        heap = [(not wide[0], -terms[0], 0)]
        left, done = terms[0], []
        while heap and (error == 0 or not heap[0][0] or left > allowed):
            _, term, node = heapq.heappop(heap)
            if not inner[node]:
                done.append(node)
                continue
            left += term
            for child in self.children[node].tolist():
                heapq.heappush(heap, (not wide[child], -terms[child], child))
                left += terms[child]
        return np.array(sorted([*done, *(node for *_, node in heap)]), dtype=np.int32)


class HardSums:
    """The visible energy of a tree's nodes at a mesh's points, on a device.

    Parameters
    ----------
    hard : (k, 6) the light's samples: world direction, irradiance at normal incidence
    share : of the light's energy that they hold
    count : points of the mesh

    Raises
    ------
    DeviceError
        If one buffer cannot hold them.
    """

    def __init__(self, device: Device, hard: Array, share: float, count: int) -> None:
        self.device, self.count, self.share, self.tree = device, count, share, Tree.over(hard)
        self.samples = hard[self.tree.order]
        """(k, 6) in the tree's order, which visibility bits must have."""
        self.runs = self.tree.runs()
        """Where runs of samples begin whose visibility is traced together."""
        self.scale = pyramid.scale_for(float(hard[:, 3:].sum(axis=0).max(initial=0.0)))
        padded = np.zeros((len(hard), 4))
        padded[:, :3] = self.samples[:, 3:]
        nodes = len(self.tree.ranges)
        if 4 * nodes * count > device.max_allocation:
            raise DeviceError(
                f"{device.name}: {len(hard)} samples of hard light at {count} points keep "
                f"{4 * nodes * count / 2**30:.1f} GiB in one buffer, its largest is "
                f"{device.max_allocation / 2**30:.1f} GiB\nuse a coarser mesh"
            )
        centres = np.zeros((nodes, 4))
        centres[:, :3] = self.tree.centres
        self._energies, self._centres = device.array(padded), device.array(centres)
        self._ranges = device.array(self.tree.ranges, np.int32)
        self._sums = device.empty((nodes, count), np.uint32)

    def collapse(self, bits: npt.NDArray[np.uint32], rows: Indices) -> None:
        """Sum the energy that some points see; `bits` (n, words) of the samples in the tree's order."""
        device = self.device
        # KINDS is for the other kernel of the file.
        kernel = device.kernels("hard_tree.cl", KINDS=1, GROUP=GROUP)["hard_sums"]
        device.launch(
            kernel, len(rows), GROUP, self._energies, len(self.samples), device.array(bits, np.uint32), self._ranges,
            device.array(rows, np.int32), self._sums, self.count, float(self.scale), len(rows), y=len(self.tree.ranges),
        )  # fmt: skip

    def lists(self, materials: list[Material], error: float) -> tuple[Any, Any]:
        """Device arrays of the materials' cuts: nodes one after another, and where each material's start.

        Parameters
        ----------
        error : relative to the mean radiance under the whole light
        """
        own, widths = error / max(self.share, 1e-6), [material.roughness for material in materials]
        found = {width: self.tree.cut(width, own) for width in set(widths)}
        cuts = [found[width] for width in widths]
        starts = np.concatenate([[0], np.cumsum([len(own) for own in cuts])])
        return self.device.array(np.concatenate(cuts), np.int32), self.device.array(starts, np.int32)

    def add_radiance(
        self,
        materials: Materials,
        lists: tuple[Any, Any],
        chosen: Any,
        material: Any,
        frames: Any,
        views: Any,
        out: Any,
    ) -> None:
        """Add the hard light's radiance to `out`.

        Parameters
        ----------
        chosen : device array (k,) int32, the points wanted; views and out : (k, 4) of those
        material, frames : of all points
        """
        device, count = self.device, len(chosen)
        kernel = device.kernels("hard_tree.cl", KINDS=materials.mask, GROUP=GROUP)["shade_hard_cut"]
        device.launch(
            kernel, count, GROUP, *materials.arguments, material, self._centres, *lists, self._sums, self.count,
            chosen, frames, views, out, float(1.0 / self.scale), count,
        )  # fmt: skip

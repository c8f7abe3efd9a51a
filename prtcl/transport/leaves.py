"""The leaves of cuts on a device, and radiance over them from packed parent sums."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.factors.slices import Materials
from prtcl.transport import cut

LANES_CPU, LANES_GPU = 16, 64
"""Work-items a point for the leaves of its cut."""
GROUP = 64


class Squares:
    """What leaves are looked up in: every square's direction, and where the turns of the square take it."""

    def __init__(self, levels: int) -> None:
        self.levels = levels
        self.directions, self.turns = cut.leaf_directions(levels), quadtree.turned_squares(levels)


class Leaves:
    """The leaves of some materials' cuts, as kernels/cut.cl takes them.

    Parameters
    ----------
    cuts : one a material; one may serve several
    places : where between the ends of its cut's lobes each material is, 0 to 1; None is 0 for all
    """

    def __init__(
        self, device: Device, squares: Squares, cuts: list[cut.Cut], places: list[float] | None = None
    ) -> None:
        self.device, self.levels = device, squares.levels
        keys = list(zip(map(id, cuts), places or [0.0] * len(cuts), strict=True))
        different = dict(zip(keys, cuts, strict=True))
        listed = np.concatenate([own.leaves for own in different.values()])
        ends = np.cumsum([0, *(len(own.leaves) for own in different.values())])
        offsets = dict(zip(different, ends, strict=False))
        starts = np.concatenate([own.starts + offsets[key] for key, own in zip(keys, cuts, strict=True)])
        directions = squares.directions[listed]
        directions[:, 3] *= np.concatenate(
            [(1 - place) * own.weights[0] + place * own.weights[1] for (_, place), own in different.items()]
        )
        self.arguments = (
            device.array(directions), device.array(squares.turns[:, listed], np.int32), len(listed),
            device.array(starts, np.int32),
        )  # fmt: skip

    def shade(
        self, materials: Materials, material: Any, sums: Any, chosen: Any, views: Any, out: Any, scale: float
    ) -> None:
        """Write the radiance of some points: equation (5) over their cuts.

        Parameters
        ----------
        material : device array (n,) int32, of all points; sums : (n, squares) uint32, `prtcl.wavelet.pyramid.pack`
        chosen : device array (k,) int32, the points wanted
        views, out : device arrays (k, 4), local outgoing directions, and what is written
        scale : multiplies
        """
        lanes = LANES_CPU if self.device.is_cpu else LANES_GPU
        self.device.launch(
            kernels(self.device, materials, self.levels, lanes)["shade_cut"], lanes, lanes, *materials.arguments,
            material, *self.arguments, sums, chosen, views, out, scale, 0, y=len(chosen),
        )  # fmt: skip


def kernels(device: Device, materials: Materials, levels: int, group: int) -> Any:
    """The kernels of cut.cl for the kinds of some materials."""
    return device.kernels("cut.cl", LEVELS=levels, SIDE=cut.SIDE, KINDS=materials.mask, GROUP=group)


def local_views(
    device: Device,
    materials: Materials,
    levels: int,
    positions: Any,
    frames: Any,
    chosen: Any,
    eye: npt.ArrayLike,
) -> Any:
    """Directions (k, 4) from some points to an eye, in their frames: a device array.

    Parameters
    ----------
    positions, frames : device arrays (n, 3) and (n, 3, 3), of all points; eye : (3,), in the positions' coordinates
    """
    count, at = len(chosen), [float(x) for x in np.asarray(eye, dtype=np.float64)]
    views = device.empty((count, 4))
    kernel = kernels(device, materials, levels, GROUP)["local_views"]
    device.launch(kernel, count, GROUP, positions, frames, chosen, *at, views, count)
    return views

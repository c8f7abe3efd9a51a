"""Many environments as columns of one matrix, and their hard light beside it, for `prtcl.transport.fixed_view`."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.factors import sphere
from prtcl.factors.environment import Environment
from prtcl.factors.hard_groups import HardGroups
from prtcl.factors.pixel_visibility import HardRays
from prtcl.factors.slices import Materials
from prtcl.transport.pipeline import in_unit
from prtcl.transport.pixel_transport import GROUP, Tile

SHARE, SPREAD = 0.02, 0.02
"""Of the mean irradiance, what a cell of 4**6 a hemisphere may hold before its light is hard, and the bound of
`hardlight.cluster`: coarser than for one environment at a time, since all a view's environments have their own
(bench/relight_choices.py)."""


@dataclass(frozen=True, eq=False)
class Lights:
    """Environments as columns, and their hard light.

    Attributes
    ----------
    means : by levels, (environments, n_cells, 3) soft radiance over the cells
    hard : (k, 6) world directions and irradiances of all environments' hard samples
    begin : (environments + 1,) int32, the samples of each environment
    rays : how they are traced
    units : (environments,) powers of two by which the light was divided
    """

    means: dict[int, npt.NDArray[np.float32]]
    hard: npt.NDArray[np.float64]
    begin: npt.NDArray[np.int32]
    rays: HardRays
    units: npt.NDArray[np.float64]

    @classmethod
    def of(
        cls, device: Device, environments: Sequence[Environment], levels: Collection[int], hard: str = "auto",
        share: float = SHARE,
    ) -> Lights:  # fmt: skip
        """Split every environment, with the soft part averaged over the cells of each of `levels`."""
        means: dict[int, list[npt.NDArray[np.float32]]] = {level: [] for level in levels}
        units, sets = [], []
        for environment in environments:
            scaled, unit = in_unit(environment)
            for level in levels:
                fine = max(sphere.FINEST, level + 1)
                soft = scaled.split(fine, hard, share=share, spread=SPREAD)
                means[level].append(sphere.light_means(device, soft, level))
            # Always of one split, so that a look has the same samples whatever looks are asked for beside it.
            sets.append(HardGroups.of(scaled.split(sphere.FINEST, hard, share=share, spread=SPREAD)))
            units.append(unit)
        counts = np.array([len(own.samples) for own in sets])
        begin = np.append(0, np.cumsum(counts))
        samples = np.concatenate([own.samples for own in sets])
        # A sample's turn is its number within its environment: no other environment changes the answer.
        turns = np.arange(len(samples)) - np.repeat(begin[:-1], counts)
        groups = [first + own.begin[:-1] for first, own in zip(begin, sets, strict=False)]
        rays = HardRays(
            samples[:, :3].astype(np.float32), turns.astype(np.int32),
            np.append(np.concatenate(groups), len(samples)).astype(np.int32),
            np.concatenate([own.traced for own in sets]),
            np.concatenate([own.probes for own in sets]).astype(np.float32),
            np.concatenate([own.outwards for own in sets]).astype(np.float32),
        )  # fmt: skip
        stacked = {level: np.stack(own) for level, own in means.items()}
        return cls(stacked, samples, begin.astype(np.int32), rays, np.array(units))


class Lamps:
    """The hard light of all environments on the device."""

    def __init__(self, device: Device, lights: Lights, rays: int) -> None:
        self.device, self.count = device, len(lights.begin) - 1
        self.any = len(lights.hard) > 0
        samples = np.zeros((max(1, len(lights.hard)), 2, 4))
        samples[: len(lights.hard), 0, :3] = lights.hard[:, :3]
        samples[: len(lights.hard), 1, :3] = lights.hard[:, 3:]
        corners, weights = sphere.around(lights.hard[:, :3], rays)
        corners[np.repeat(lights.rays.traced, np.diff(lights.rays.begin))] = -1
        self._arrays = [
            device.array(samples), device.array(lights.rays.turns, np.int32),
            device.array(lights.begin, np.int32),
        ]  # fmt: skip
        self._around = [device.array(corners, np.int32), device.array(weights)]

    def add(self, materials: Materials, material: Any, tile: Tile, seen: Any, out: Any) -> None:
        """Add what they give a tile's pixels to `out` (pixels, 3, environments)."""
        if not self.any:
            return
        kernel = self.device.kernels("pixel_lights.cl", KINDS=materials.mask, GROUP=GROUP)["pixel_lights"]
        self.device.launch(
            kernel, len(tile), GROUP, *materials.arguments, material, *self._arrays, seen, seen.shape[1],
            tile.device_bits, tile.bits.shape[1], *self._around, tile.frames, tile.views, tile.first, tile.phase,
            len(tile), out.shape[2], out, y=self.count,
        )  # fmt: skip

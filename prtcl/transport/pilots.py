"""Cuts fitted to a light and a mesh: made from what a sample of the mesh's points tells, and tried there.

The sample keeps its own visibility and parent sums, whatever is known of the mesh's other points: a cut depends on
mesh, light, material and error, and not on what was looked at before.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.factors.environment import Light
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.factors.visibility import Tracer
from prtcl.transport import collapse, cut
from prtcl.transport.leaves import Leaves, Squares
from prtcl.transport.pipeline import Points
from prtcl.transport.settings import Settings
from prtcl.wavelet import haar, pyramid

COUNT, VIEWS = 128, 4
"""Points of the sample, and views of each at which cuts are tried."""
GUESS, AIM = 2.0, 0.8
"""A cut's error over the root of its sum, to begin with; and the error aimed at, of that asked for, once measured."""


def sample(count: int) -> npt.NDArray[np.int32]:
    """Which of `count` points are the sample."""
    return np.unique(np.linspace(0, count - 1, min(COUNT, count)).astype(np.int32))


class Pilots:
    """The sample under one light.

    Parameters
    ----------
    points : the sample
    bits : their visibility where it is traced already
    settings : levels and rays of light, product and visibility
    """

    def __init__(
        self, device: Device, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None,
        settings: Settings, squares: Squares, light: Light,
    ) -> None:  # fmt: skip
        self.device, self.levels, self.squares, self.light = device, settings.levels, squares, light
        if bits is None:
            bits = tracer.visibility(points.origins, points.frames, settings.rays, points.grid)
        self.bits = bits
        product = collapse.product_samples(
            device, light, bits, points.frames, settings, 1 if light.grey else 3
        )
        coefficients = haar.forward(device, product).get().astype(np.float64)
        mean = coefficients[..., 0].mean() / 2.0**self.levels
        self.spread = np.array(
            [
                (coefficients[..., 4**level : 4 ** (level + 1)] ** 2).mean() / max(mean**2, 1e-300)
                for level in range(self.levels)
            ]
        )
        """(levels,) w_r of `prtcl.transport.cut`."""
        self._scale = pyramid.scale_for(float(light.cube[..., :3].max()))
        self._sums = device.empty((len(points), quadtree.n_squares(self.levels + 1)), np.uint32)
        pyramid.pack(device, product, device.array(np.arange(len(points)), np.int32), self._sums, self._scale)
        chosen = np.repeat(np.arange(len(points)), VIEWS)
        u, v = np.random.default_rng(0).random((2, len(chosen)))
        views = np.zeros((len(chosen), 4))
        # Even over the disk below the hemisphere: by the area that a view sees.
        views[:, 0], views[:, 1] = np.sqrt(u) * np.cos(2 * np.pi * v), np.sqrt(u) * np.sin(2 * np.pi * v)
        views[:, 2] = np.sqrt(1 - u)
        self._chosen, self._views = device.array(chosen, np.int32), device.array(views)
        self._material = device.array(np.zeros(len(points)), np.int32)
        self.whole = cut.whole(self.levels)
        self._all = Leaves(device, squares, [self.whole])

    def fit(self, stand_ins: tuple[Material, ...], error: float) -> cut.Cut:
        """A cut that errs by about `error` for each of some materials, relative to the mean under the whole light.

        Returns
        -------
        cut : its `error` is what was measured here
        """
        below = cut.energies(self.device, stand_ins, self.levels, self.spread)
        exact = [self._radiance(material, self._all) for material in stand_ins]
        # Soft light is all that cuts err in.
        soft, asked = 1.0 - self.light.hard_share, error / GUESS
        for last in (False, True):
            own = cut.build(below, asked)
            leaves = Leaves(self.device, self.squares, [own])
            found = soft * max(
                _relative_rmse(self._radiance(material, leaves), want)
                for material, want in zip(stand_ins, exact, strict=True)
            )
            if last or found == 0.0:
                break
            # The error goes about as the sum's root does: one step of the secant's rule gets near.
            asked *= min(4.0, max(0.125, AIM * error / found))
        return replace(own, error=found)

    def _radiance(self, material: Material, leaves: Leaves) -> npt.NDArray[np.floating]:
        out = self.device.empty((len(self._chosen), 4))
        materials = Materials(self.device, [material])
        leaves.shade(materials, self._material, self._sums, self._chosen, self._views, out, 1.0 / self._scale)
        return np.asarray(out.get()[:, :3])


def _relative_rmse(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> float:
    """Of a, relative to the mean of b; 0 where all is dark."""
    mean = float(b.mean(dtype=np.float64))
    return float(np.sqrt(((a.astype(np.float64) - b) ** 2).mean())) / mean if mean > 0.0 else 0.0

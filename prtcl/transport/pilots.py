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
from prtcl.transport.hard_tree import HardSums
from prtcl.transport.leaves import Leaves, Squares
from prtcl.transport.pipeline import Points
from prtcl.transport.settings import Settings
from prtcl.wavelet import haar, pyramid

COUNT, VIEWS = 128, 4
"""Points of the sample, and views of each at which cuts are tried."""
GUESS, AIM, TRIES = 2.0, 0.8, 6
"""A cut's error over the root of its sum, to begin with; the error aimed at, of that asked for, once measured; and how
often a cut is made anew at most."""
FLAT = 0.05
"""Least w_r: a flat product has no detail, and yet f in a leaf's middle is not its mean there."""


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
    whole : the cut of all samples
    """

    def __init__(
        self, device: Device, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None,
        settings: Settings, squares: Squares, whole: cut.Cut, light: Light,
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
        details = np.array(
            [
                (coefficients[..., 4**level : 4 ** (level + 1)] ** 2).mean() / max(mean**2, 1e-300)
                for level in range(self.levels)
            ]
        )
        self.spread = np.maximum(details, FLAT)
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
        self._hard: HardSums | None = None
        if len(light.hard):
            self._hard = HardSums(device, light.hard, light.hard_share, len(points))
            samples = self._hard.samples[:, :3]
            seen = tracer.light_visibility(points.origins, points.frames[:, 2], samples)
            self._hard.collapse(seen, np.arange(len(points), dtype=np.int32))
            self._frames = device.array(points.frames)
        self._all = Leaves(device, squares, [whole])

    def fit(self, sharp: tuple[Material, ...], wide: tuple[Material, ...], error: float) -> cut.Cut:
        """A cut that errs by about `error` relative to the mean under the whole light.

        Parameters
        ----------
        sharp, wide : as `cut.ends` gives them; the cut is made for the sharp ones and tried for all

        Returns
        -------
        cut : its `error` is the largest that was measured
        """
        below = cut.energies(self.device, sharp, self.levels, self.spread)
        packed = [[Materials(self.device, [material]) for material in end] for end in (sharp, wide)]
        # Weights are those of the last, which stands nearest to the material.
        nearest = [(end[-1], cut.mean_reflectance(end[-1], self.levels)) for end in packed]
        trials = [(place, one, *self._truth(one)) for place, end in enumerate(packed) for one in end]
        asked, best = error / GUESS, None
        for _ in range(TRIES):
            own = cut.build(below, asked)
            weights = [cut.weights(one, self.levels, own, means) for one, means in nearest]
            own = replace(own, weights=np.stack(weights))
            leaves = [Leaves(self.device, self.squares, [own], [place]) for place in (0.0, 1.0)]
            found = max(
                _rmse(self._radiance(one, leaves[place]), want) / mean if mean > 0.0 else 0.0
                for place, one, want, mean in trials
            )
            own = replace(own, error=found)
            best = own if best is None else min(best, own, key=lambda c: _worth(c, error))
            if found == 0.0 or 0.6 * error <= found <= error:
                break
            # The error goes about as the sum's root does: a few steps of the secant's rule get near.
            asked *= min(4.0, max(0.125, AIM * error / found))
        assert best is not None
        return best

    def measure(self, material: Material, own: cut.Cut) -> float:
        """What a cut made for another material costs this one, relative to the mean under the whole light."""
        one = Materials(self.device, [material])
        want, mean = self._truth(one)
        found = _rmse(self._radiance(one, Leaves(self.device, self.squares, [own], [0.0])), want)
        return found / mean if mean > 0.0 else 0.0

    def _truth(self, one: Materials) -> tuple[npt.NDArray[np.floating], float]:
        """Soft radiance over all samples, and the mean under the whole light."""
        soft = self._radiance(one, self._all)
        return soft, self._whole_mean(one, float(soft.mean(dtype=np.float64)))

    def _whole_mean(self, one: Materials, soft: float) -> float:
        """Mean radiance of the pilots under the whole light.

        Few of their views meet a glint: what they see of the hard light is rather less than all views do, and where one
        meets it by chance, no more than its share of the energy counts.
        """
        if self._hard is None:
            return soft
        out = self.device.array(np.zeros((len(self._chosen), 4)))
        lists = self._hard.lists(one.list, 0.0)
        self._hard.add_radiance(one, lists, self._chosen, self._material, self._frames, self._views, out)
        share = min(self.light.hard_share, 1.0 - 1e-3)
        return soft + min(float(out.get()[:, :3].mean(dtype=np.float64)), soft * share / (1.0 - share))

    def _radiance(self, one: Materials, leaves: Leaves) -> npt.NDArray[np.floating]:
        out = self.device.empty((len(self._chosen), 4))
        leaves.shade(one, self._material, self._sums, self._chosen, self._views, out, 1.0 / self._scale)
        return np.asarray(out.get()[:, :3])


def _worth(own: cut.Cut, error: float) -> tuple[bool, float]:
    """Of cuts that are good enough the one with fewest leaves comes first, else the one that errs least."""
    return own.error > error, len(own.leaves) if own.error <= error else own.error


def _rmse(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> float:
    return float(np.sqrt(((a.astype(np.float64) - b) ** 2).mean()))

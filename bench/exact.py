"""Equation (1) in float64 NumPy at one point: soft light over a grid of directions, peaks by samples of their own."""

from __future__ import annotations

import numpy as np

from prtcl import reference
from prtcl.factors.environment import Environment
from prtcl.factors.visibility import Tracer

THRESHOLD = 30.0
"""Peaks start at this many times the mean radiance: well above the render's own threshold of ten."""


class Exact:
    """Radiance under one environment, rays by embree.

    Parameters
    ----------
    levels : of the grid of directions, 4**levels
    peak_side : samples of a peak along a texel's side
    """

    def __init__(self, environment: Environment, tracer: Tracer, levels: int, peak_side: int) -> None:
        self.image, self.tracer, self.levels = environment.image, tracer, levels
        solid = environment.texel_solid_angles()[:, None]
        self.threshold = THRESHOLD * float((self.image.mean(axis=2) * solid).sum() / (4 * np.pi))
        self.directions, self.irradiance = reference.peaks(self.image, self.threshold, peak_side)

    def radiance(self, origin, axes, view, materials, places=(0.5, 0.5)):  # type: ignore[no-untyped-def]
        """(materials, 3) outgoing radiance.

        Parameters
        ----------
        origin : (1, 3) float32, as `Tracer.origins` gives it
        axes : (3, 3) world tangent, bitangent, normal as rows; view : (3,) local
        materials : as `reference.brdf` takes them
        places : in their cells, of the directions (`reference.directions`)
        """
        local = reference.directions(self.levels, places)
        soft = reference.environment_below(self.image, local @ axes, self.threshold)
        above = self.directions @ axes[2] > 0
        local = np.concatenate([local, self.directions[above] @ axes.T])
        light = np.concatenate([soft * (2 * np.pi / 4**self.levels), self.irradiance[above]])
        origins = np.repeat(origin, len(local), axis=0)
        seen = ~self.tracer.occluded(origins, (local @ axes).astype(np.float32))
        incoming = light[seen] * local[seen, 2:3]
        return np.stack([(incoming * reference.brdf(m, local[seen], view)).sum(axis=0) for m in materials])

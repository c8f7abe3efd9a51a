"""An anisotropic table made isotropic: its mean over the turn about the normal, and what that loses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.files.utia import STEP_PHI, STEP_THETA

Array = npt.NDArray[np.float64]

LEAST_COSINE = float(np.cos(np.radians(75.001)))
"""Of directions that were measured: to 75° from the normal."""


class Turned:
    """f(θ_i, θ_o, φ_o − φ_i), trilinear between measured directions, periodic in the azimuth.

    Parameters
    ----------
    values : (t, p, t, p, 3), incident θ and φ, outgoing θ and φ; negative samples are left out
    name : for messages

    Attributes
    ----------
    table : (t, t, p, 3) the means
    negative : samples that were left out
    loss : √⟨(f − f̄)²⟩ / ⟨f⟩ over the samples, weighed by cos θ sin θ of both directions

    Raises
    ------
    InputError
        If a mean has no sample.
    """

    def __init__(self, values: Array, name: str) -> None:
        n_phi = values.shape[1]
        valid = (values >= 0).all(axis=-1)
        # Column k of a row becomes the pair whose outgoing azimuth is k steps further than the incident one.
        at = (np.arange(n_phi)[:, None] + np.arange(n_phi)) % n_phi
        f = np.take_along_axis(values, at[None, :, None, :, None], axis=3)
        kept = np.take_along_axis(valid, at[None, :, None, :], axis=3)
        count = kept.sum(axis=1)
        if not count.all():
            raise InputError(f"{name}: some pairs of directions have no sample of 0 or more; is it a BRDF?")
        self.table = np.where(kept[..., None], f, 0.0).sum(axis=1) / count[..., None]
        self.negative = int((~valid).sum())
        theta = np.arange(values.shape[0]) * STEP_THETA
        share = np.sin(theta) * np.cos(theta)
        weight = kept * share[:, None, None, None] * share[:, None]
        mean = float((weight[..., None] * f).sum())
        square = float((weight[..., None] * (f - self.table[:, None]) ** 2).sum())
        self.loss = float(np.sqrt(square * 3 * weight.sum())) / mean if mean > 0 else 0.0

    def __call__(self, incident: Array, outgoing: Array) -> Array:
        """f of pairs of unit directions (n, 3): (n, 3), 1/sr. Beyond the last θ, that of the last."""
        places = [np.arctan2(np.hypot(d[:, 0], d[:, 1]), d[:, 2]) / STEP_THETA for d in (incident, outgoing)]
        turns = [np.arctan2(d[:, 1], d[:, 0]) for d in (outgoing, incident)]
        n_theta, n_phi = self.table.shape[1:3]
        turn = (turns[0] - turns[1]) / STEP_PHI
        low = np.floor(turn)
        ends = []
        for place in places:
            at = np.clip(place, 0, n_theta - 1)
            first = np.minimum(at.astype(np.intp), n_theta - 2)
            ends.append(((first, 1 - (at - first)), (first + 1, at - first)))
        f = np.zeros_like(incident)
        for i, wi in ends[0]:
            for o, wo in ends[1]:
                for step, wp in ((0, 1 - (turn - low)), (1, turn - low)):
                    k = (low.astype(np.int64) + step) % n_phi
                    f += (wi * wo * wp)[:, None] * self.table[i, o, k]
        return f

"""What an image really errs for want of points, by giving some of its pixels four times as many.

A film's own estimate is on the safe side, by a factor that depends on the picture: points are stratified, and what
their variance within a stratum says is more than their mean errs. So pixels are drawn at random, those with large
estimates more often, and get the points that the next round of refinement would have given them. How far their colours
move tells what they erred before: of a mean m of n points that becomes (m + 3 m')/4 the error is all of the move where
the later points repair what the first got wrong, as stratified ones do, and 2/√3 of it where they know nothing of each
other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl.scene.adapt import Exposure, colours
from prtcl.scene.report import covered
from prtcl.scene.shaders import Layer

MOVED = 1.15
"""Square of a pixel's error over the square of its move, between the 1 and the 4/3 of the two cases above."""
SHARE, LEAST = 0.01, 200
"""Pixels drawn, of those that are covered or beside one, and at least."""


@dataclass(frozen=True)
class Audit:
    """What was found.

    Attributes
    ----------
    ratio : of the squared error found to that which the films estimate
    uncertain : one standard error of it
    error : root of the mean squared error of the covered pixels, in radiance, before the audit's points
    """

    ratio: float
    uncertain: float
    error: float


def audit(exposure: Exposure, layers: list[Layer], rng: np.random.Generator) -> Audit:
    """Draw pixels, give them more points, see how far they move."""
    seen = covered(layers)
    # Beside those that are covered are some whose first points missed the mesh.
    near = layers[0].film.around(seen.astype(np.float64)) > 0.0
    estimate = np.where(near, np.sum([layer.film.variance() for layer in layers], axis=0), 0.0)
    # Most is learned for its price where the error is large and the points are few.
    price = np.sum([layer.film.points for layer in layers], axis=0)
    chance = _chances(np.sqrt(estimate / price), near)
    room = np.all([4 * layer.film.points <= layer.most for layer in layers], axis=0)
    drawn = np.flatnonzero(near & (rng.random(len(seen)) < chance) & room)
    before = colours(layers)[drawn, :3]
    for layer in layers:
        exposure.advance(layer, drawn)
    moved = MOVED * ((colours(layers)[drawn, :3] - before) ** 2).mean(axis=1)
    total = (estimate[drawn] / chance[drawn]).sum()
    # Over the covered pixels, as a relative error is.
    count = max(int(seen.sum()), 1)
    if not len(drawn):  # none has room for more points: the films' own estimate, on the safe side
        return Audit(1.0, 1.0, float(np.sqrt(estimate.sum() / count)))
    if not total > 0.0:
        return Audit(1.0, 1.0, float(np.sqrt((moved / chance[drawn]).sum() / count)))
    ratio = float((moved / chance[drawn]).sum() / total)
    spread = float(np.sqrt((((moved - ratio * estimate[drawn]) / chance[drawn]) ** 2).sum()) / total)
    return Audit(ratio, spread, float(np.sqrt(ratio * estimate.sum() / count)))


def _chances(weight: npt.NDArray[np.float64], near: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """Each pixel's chance to be drawn: half in proportion to its weight, half alike for all that come into question."""
    count = int(near.sum())
    wanted = max(LEAST, SHARE * count)
    total = weight[near].sum()
    own = 0.5 / max(count, 1) + (0.5 * weight / total if total > 0 else 0.5 / max(count, 1))
    return np.asarray(np.where(near, np.minimum(1.0, wanted * own), 0.0))

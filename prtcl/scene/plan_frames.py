"""A plan for batches: rays and points of a pixel, the same for all its images.

Their points are fixed, so that they are traced once for all lights; the plan is made under the first light, from the
first view, for every material, and the finest of what these need is taken. Nothing in it is timed: the same batch has
the same plan, on which resuming it rests.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from prtcl.errors import InputError
from prtcl.scene.pilot import NOISY, Pilot, pipelines, told
from prtcl.scene.plan import check_error
from prtcl.scene.planner import AIM, LEAST_RAYS, RATE, STAYS, beside, root, shifted
from prtcl.scene.points import check_eye
from prtcl.scene.scene import Scene

COST = {2: 7.0, 3: 13.0, 4: 26.0, 5: 45.0, 6: 120.0, 7: 400.0}
"""Microseconds that a point takes by its levels of rays, about (two cores, a scan): only their ratios matter."""
MOST = 16
"""N × N points, at most."""


@dataclass(frozen=True)
class FramesPlan:
    """What a batch is made with.

    Attributes
    ----------
    rays : levels of every material's visibility
    samples : N × N points a pixel
    predicted : relative RMSE of the worst material, from the first view under the first light
    """

    asked: float
    rays: int
    samples: int
    predicted: float


def plan_frames(scenes: Sequence[Scene], error: float) -> FramesPlan:
    """Rays and points that meet an error in each of some scenes: one a material.

    Raises
    ------
    InputError
        If `error` is not between 0 and 1, nothing meets it, or a camera sees nothing.
    """
    check_error(error)
    found = [_one(scene, error) for scene in scenes]
    return FramesPlan(
        error,
        max(own.rays for own in found),
        max(own.samples for own in found),
        max(own.predicted for own in found),
    )


def _one(scene: Scene, error: float) -> FramesPlan:
    check_eye(scene.tracer, scene.mesh, scene.camera)
    pilot, allowed = Pilot(scene), (AIM * error) ** 2
    base = [own for own, _ in scene.choose_settings(False)]
    finest = max(one.rays for one in base)
    if not pilot.mean > 0.0:  # a black picture errs by nothing
        return FramesPlan(error, finest, 1, 0.0)
    made = pipelines(scene, base)
    known, usual = pilot.bias(pilot.shade(made)), pilot.noise(made.soft)
    hard = pilot.noise(made.hard).squared.value if len(made.light.hard) else 0.0
    best, chosen, least = math.inf, None, math.inf
    for shift in (-3, -2, -1, 0, 1):
        if finest + shift < LEAST_RAYS:
            continue
        own = [shifted(one, shift, False) for one in base]
        soft = pilot.noise(pipelines(scene, own).soft) if shift else usual
        off = pilot.bias_beside(soft, usual)
        left = beside(told(known), off)
        least = min(least, left)
        if left > (STAYS if shift < 0 else 1.0) * allowed:
            continue
        # Points are not given where they are needed, so all of a pixel's error is that of the mean of N × N.
        points = NOISY * ((soft.squared.value + hard) / max(allowed - left, 1e-300)) ** RATE
        side = max(1, math.ceil(math.sqrt(points)))
        cost = COST[max(one.rays for one in own)] * side**2
        if side <= MOST and cost < best:
            noise = (soft.squared.value + hard) * (NOISY / side**2) ** (1.0 / RATE)
            best, chosen = cost, FramesPlan(error, max(one.rays for one in own), side, root(left + noise))
    if chosen is None:
        raise InputError(
            f"error {error:g}: nothing that was tried meets it in {scene.materials[0].spec} with up to {MOST} x {MOST} "
            f"points a pixel (bias {root(least):.2g})\nask for more, or fix --rays and --samples by hand"
        )
    return chosen

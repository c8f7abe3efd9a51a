"""The fastest settings that meet an error, found by trying them on a pilot (`prtcl.scene.pilot`).

A pixel's points share what they see of light and shadow, so the number of rays of one point is a trade: fewer rays are
quicker and noisier, and no more biased, as long as the places of the rays differ from point to point. Which is best
depends on the picture; the pilot measures bias, noise and time of each number of rays and takes the one whose image is
expected first. How many points a pixel gets is not decided here: while the image is made, audits steer that
(`prtcl.scene.steer`).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from prtcl import quadtree
from prtcl.errors import InputError
from prtcl.scene.adapt import MOST, MOST_HARD
from prtcl.scene.film import FIRST
from prtcl.scene.pilot import NOISY, Noise, Pilot, Squared, likely, pipelines, told
from prtcl.scene.plan import Plan, Trial
from prtcl.transport.settings import Settings

if TYPE_CHECKING:
    from prtcl.scene.scene import Scene

AIM = 0.9
"""The error aimed at, of that asked for: neither pilot nor audit is exact."""
RATE = 0.8
"""Points go as noise squared to this power: of stratified points the squared error falls faster than their number."""
LEAST_RAYS = 2
SECONDS, SHARE = 2.0, 0.1
"""What a pilot may take: seconds, or a share of the job where that is more."""
STAYS = 0.4
"""Of the squared error, what the bias of fewer rays than usual may be: more, and it is points that the rest takes."""
GLINTS = 64
"""Points of hard light that every pixel would need, from which a picture begins with sixteen of them, not four."""
GUESS = 0.15
"""Squared error over what a film estimates, until an audit has measured it; most pictures have more."""


def plan_pixels(scene: Scene, error: float, base: list[Settings], fixed: set[str]) -> Plan:
    """A plan for the camera's pixels.

    Parameters
    ----------
    error : relative RMSE asked for
    base : settings of each material that no error was asked of
    fixed : names of those that a user fixed by hand

    Raises
    ------
    InputError
        If nothing that was tried meets the error.
    """
    start = time.perf_counter()
    pilot = Pilot(scene)
    if not pilot.mean > 0.0:  # a black picture has no relative error
        return finished(scene, error, base, "pixel", Squared(0.0, 0.0), 0.0, 0.0, start, ())
    made = pipelines(scene, base)
    radiance, soft_base = pilot.shade(made), pilot.noise(made.soft)
    hard = pilot.noise(made.hard) if len(made.light.hard) else None
    allowed = (AIM * error) ** 2
    tried: list[_Tried] = []
    known = pilot.bias(radiance)

    def price(one: _Tried) -> tuple[float, int, float]:
        """Share of hard light, its first points, and seconds of the job, with what is known of the bias so far."""
        left = beside(told(known), one.off)
        share, begin, seconds = _expected(pilot.covered, one.soft, hard, allowed - left)
        return share, begin, math.inf if one.shift < 0 and left > STAYS * allowed else seconds

    def fits(ahead: float, share: float = 1.0) -> bool:
        """Whether a step of so many seconds fits into a share of the pilot's time."""
        best = min(filter(math.isfinite, (price(one)[2] for one in tried)), default=0.0)
        return time.perf_counter() - start + ahead < share * max(SECONDS, SHARE * best)

    def sharpen(share: float) -> Squared:
        """The bias told better, until one standard error of it fits in beside `AIM`."""
        better = known
        while better.uncertain > (AIM**-2 - 1.0) * allowed and fits(pilot.sharpening, share):
            pilot.sharpen()
            better = pilot.bias(radiance)
        return better

    known = sharpen(0.5)
    for shift in _shifts(base, fixed, error):
        found = [seconds for _, _, seconds in map(price, tried) if math.isfinite(seconds)]
        # More rays than usual are for what these cannot meet: they take four times as long.
        if found and (shift > 0 or found[-1] > min(found) or not fits(soft_base.took)):
            break
        own = [shifted(one, shift, "levels" in fixed) for one in base]
        soft = pilot.noise(pipelines(scene, own).soft) if shift else soft_base
        tried.append(_Tried(shift, own, pilot.bias_beside(soft, soft_base), soft))
    known = sharpen(1.0)
    prices = [price(one) for one in tried]
    best, (share, begin, seconds) = min(zip(tried, prices, strict=True), key=lambda pair: pair[1][2])
    if not math.isfinite(seconds):
        raise _refused(error, min(beside(told(known), one.off) for one in tried), allowed)
    bias = Squared(beside(likely(known), best.off), math.hypot(known.uncertain, best.off.uncertain))
    noise = noise_left(error, bias.value)
    settings = [
        replace(one, pixel_error=math.sqrt(noise / GUESS), hard_error=share, hard_points=begin)
        for one in best.settings
    ]
    trials = tuple(one.told(seconds) for one, (_, _, seconds) in zip(tried, prices, strict=True))
    return finished(scene, error, settings, "pixel", bias, noise, seconds, start, trials)


@dataclass(frozen=True)
class _Tried:
    """A candidate.

    Attributes
    ----------
    shift : its levels of rays beyond the base's
    off : its bias beside the base settings'
    soft : noise of its soft light; hard light's is the same for all
    """

    shift: int
    settings: list[Settings]
    off: Squared
    soft: Noise

    def told(self, seconds: float) -> Trial:
        return Trial(
            f"4^{max(one.rays for one in self.settings)} rays", root(self.off.value), root(self.off.uncertain),
            root(self.soft.squared.value), seconds if math.isfinite(seconds) else None,
        )  # fmt: skip


def _shifts(base: list[Settings], fixed: set[str], error: float) -> list[int]:
    """By how many levels of rays the candidates differ from the base, the likeliest first."""
    if "rays" in fixed:
        return [0]
    finest = max(one.rays for one in base)
    order = (-2, -3, -1, 0, 1) if error > 0.015 else (-2, -1, -3, 0, 1)
    return [shift for shift in order if finest + shift >= LEAST_RAYS]


def noise_left(error: float, bias: float) -> float:
    """Squared error that want of points may have beside a squared bias: half of all or more, were that told badly."""
    allowed = (AIM * error) ** 2
    return max(allowed - bias, 0.5 * allowed)


def beside(bias: float, off: Squared) -> float:
    """Squared bias of settings that stand `off` from others of a squared `bias`.

    As if the two had nothing to do with each other; `off` on the safe side.
    """
    return bias + max(off.value, 0.0) + off.uncertain


def _refused(error: float, least: float, allowed: float) -> InputError:
    """Why nothing meets an error: the least squared bias is more than what is allowed, or points would be too many."""
    reason = (
        f"about {root(least):.2g} stays however many points a pixel gets"
        if least >= allowed
        else f"a pixel would need more than {MOST} points of soft light or {MOST_HARD} of hard light"
    )
    return InputError(
        f"error {error:g}: no setting that was tried meets it: {reason}\n"
        "ask for more, or fix --levels and --rays by hand"
    )


def shifted(one: Settings, shift: int, levels_fixed: bool) -> Settings:
    """The same with another number of rays, and levels enough for them unless these are fixed."""
    rays = min(max(one.rays + shift, LEAST_RAYS), quadtree.MAX_LEVELS)
    levels = one.levels if levels_fixed else max(one.levels, rays)
    return replace(one, rays=min(rays, levels), levels=levels)


def _expected(covered: float, soft: Noise, hard: Noise | None, allowed: float) -> tuple[float, int, float]:
    """Share of hard light in a squared error of which `allowed` is left for both, its first points, and the seconds.

    With points N = c (v / a)^RATE of each light, for its share a of the squared error, the sum of their costs t N is
    least where a ∝ (t c v^RATE)^(1 / (1 + RATE)). Here c is `Noise.gathered`: points go where the noise is.
    """
    if not allowed > 0.0:
        return 0.5, 16, math.inf
    lights = [soft] if hard is None else [soft, hard]
    wants = [
        (own.seconds * own.gathered(RATE) * own.squared.value**RATE) ** (1.0 / (1.0 + RATE)) for own in lights
    ]
    share = min(max(wants[-1] / sum(wants), 0.1), 0.9) if hard is not None and sum(wants) > 0.0 else 0.5
    parts = (1.0,) if hard is None else (1.0 - share, share)
    points = [
        NOISY * (own.squared.value / (part * allowed)) ** RATE
        for own, part in zip(lights, parts, strict=True)
    ]
    # Four points that all miss a glint say nothing of it; where alike pixels would need many there are glints.
    begin = 4 if hard is not None and points[1] < GLINTS else 16
    seconds = 0.0
    for own, number, first, most in zip(lights, points, (FIRST, begin), (MOST, MOST_HARD), strict=False):
        seconds += covered * own.seconds * max(number * own.gathered(RATE), first)
        if number > most:
            return share, begin, math.inf
    return share, begin, seconds


def confidence(asked: float, squared: float, uncertain: float) -> float:
    """Chance that an error is no more than `asked`, its square being known to a standard error."""
    if uncertain <= 0.0:
        return float(squared <= asked**2)
    return NormalDist(squared, uncertain).cdf(asked**2)


def finished(
    scene: Scene, error: float, settings: list[Settings], points: str, bias: Squared, noise: float, seconds: float,
    start: float, trials: tuple[Trial, ...],
) -> Plan:  # fmt: skip
    """The plan of what a pilot found.

    Parameters
    ----------
    noise : squared error that is left to want of points
    start : when the pilot began, by `time.perf_counter`
    """
    squared = max(bias.value, 0.0) + noise
    # An audit of two hundred pixels tells a squared error to about a quarter.
    uncertain = math.hypot(bias.uncertain, 0.25 * noise)
    return Plan(
        asked=error, settings=tuple(settings), points=points, bias=root(bias.value),
        bias_uncertain=root(bias.uncertain), predicted=math.sqrt(squared),
        confidence=confidence(error, squared, uncertain), seconds=seconds,
        pilot_seconds=time.perf_counter() - start, trials=trials, device=scene.device.name,
        scene=scene.names,
    )  # fmt: skip


def root(squared: float) -> float:
    """Square root of an estimate, whose noise may have made it negative."""
    return float(np.sqrt(max(squared, 0.0)))

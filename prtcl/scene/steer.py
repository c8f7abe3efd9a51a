"""Points for an image until it errs by what was asked, as audits of it find."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from prtcl.scene.adapt import Exposure, colours
from prtcl.scene.audit import Audit, audit
from prtcl.scene.plan import Plan
from prtcl.scene.planner import GUESS, confidence, noise_left
from prtcl.scene.report import covered
from prtcl.scene.shaders import Layer

AUDITS = 4
"""Audits of one image, at most."""
SHARP = 0.05
"""GGX alpha below which a highlight of hard light may fall between an audit's points too."""
NEAR = 1.1
"""Of the squared error that was aimed at, what is as good."""


@dataclass(frozen=True)
class Steered:
    """How it went.

    Attributes
    ----------
    error : relative RMSE that the image is expected to have, bias and noise
    ratio : squared noise over what the films estimate, as the audits found
    confidence : that the image errs by no more than was asked
    pixel_error, hard_error : `Settings` that refine an image as far without audits
    audits : rounds of points, each of which one ended
    """

    error: float
    ratio: float
    confidence: float
    pixel_error: float
    hard_error: float
    audits: int


def steer(
    exposure: Exposure, layers: list[Layer], asked: float, bias: float, bias_uncertain: float, share: float
) -> Steered:
    """Refine layers that have their first points.

    Parameters
    ----------
    asked : relative RMSE
    bias : of that, what no points take away; its square is known to the square of `bias_uncertain`
    share : of hard light in the squared noise
    """
    rng = np.random.default_rng(0)
    wanted = noise_left(asked, bias**2)
    ratio, found, audits = GUESS, Audit(GUESS, GUESS, 0.0), 0
    while audits < AUDITS:
        layers, error, share = _shared(layers, math.sqrt(wanted / ratio), share)
        exposure.refine(layers, error)
        exposure.complete(layers)
        mean = _mean(layers)
        found, audits = audit(exposure, layers, rng), audits + 1
        if not found.error**2 > NEAR * wanted * mean**2:
            # What ends the search is more often found too low than too high: another look, that nothing hangs on.
            found = _both(found, audit(exposure, layers, rng))
            if not found.error**2 > NEAR * wanted * mean**2:
                break
        # A pixel that was hardly expected to err counts for many: more than a round of points is not taken on its word.
        ratio = min(max(found.ratio, 0.5 * ratio), 4.0 * ratio)
    noise = (found.error / mean) ** 2 if mean > 0.0 else 0.0
    uncertain = math.hypot(noise * found.uncertain / max(found.ratio, 1e-300), bias_uncertain**2)
    squared = bias**2 + noise
    return Steered(
        error=math.sqrt(squared), ratio=found.ratio,
        confidence=confidence(asked, squared, uncertain), pixel_error=error, hard_error=share, audits=audits,
    )  # fmt: skip


def audited(plan: Plan, steered: Steered) -> Plan:
    """A plan with what its picture's audits found."""
    return replace(
        plan, predicted=steered.error, confidence=steered.confidence, noise_ratio=steered.ratio, steered=True,
        settings=tuple(
            replace(own, pixel_error=steered.pixel_error, hard_error=steered.hard_error) for own in plan.settings
        ),
    )  # fmt: skip


def expected_error(
    layers: list[Layer], picture: npt.NDArray[np.float64], plan: Plan | None
) -> npt.NDArray[np.float32]:
    """(pixels,) standard error of each pixel's grey mean, in its radiance.

    Without a plan it is what the films estimate, which is on the safe side and knows of no bias; with one it is scaled
    to what the audits found, and has the plan's bias in proportion to the pixel's radiance.
    """
    squared = np.sum([layer.film.variance() for layer in layers], axis=0)
    if plan is not None:
        grey = picture[:, :3].mean(axis=1)
        seen = picture[:, 3] > 0.0
        # In proportion to radiance, and yet the image's bias as a whole.
        spread = (grey[seen] ** 2).mean() if seen.any() else 0.0
        share = grey**2 * (grey[seen].mean() ** 2 / spread) if spread > 0.0 else 0.0
        squared = squared * plan.noise_ratio + plan.bias**2 * share
    return np.asarray(np.sqrt(squared), dtype=np.float32)


def _shared(layers: list[Layer], error: float, share: float) -> tuple[list[Layer], float, float]:
    """Layers with the shares of the squared error that they may have; what one does not need is the other's."""
    if len(layers) == 1:
        return [replace(layers[0], share=1.0)], error, 0.5
    seen, mean = covered(layers), _mean(layers)
    scale = (error * mean) ** 2 * seen.sum()
    left = [float(layer.film.variance()[seen].sum()) / scale if scale > 0.0 else 0.0 for layer in layers]
    if left[1] < share:
        share = max(left[1], 0.02)
    elif left[0] < 1.0 - share:
        share = min(1.0 - left[0], 0.98)
    return [replace(l, share=own) for l, own in zip(layers, (1.0 - share, share), strict=True)], error, share


def _both(one: Audit, other: Audit) -> Audit:
    """Two audits of one picture as one."""
    return Audit(
        0.5 * (one.ratio + other.ratio),
        0.5 * math.hypot(one.uncertain, other.uncertain),
        math.sqrt(0.5 * (one.error**2 + other.error**2)),
    )


def _mean(layers: list[Layer]) -> float:
    """Radiance of the covered pixels."""
    seen = covered(layers)
    return float(colours(layers)[seen, :3].mean()) if seen.any() else 0.0

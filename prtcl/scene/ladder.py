"""The coarsest of some settings that meets an error at points that stand alone, such as vertices.

Each has only its own rays: what one errs is what the picture errs there. The finest settings are held against float64,
the others against the finest, which has no noise: what noisy references cannot tell of light in a narrow lobe, the
difference of two renderings tells exactly.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.scene.pilot import Squared, likely, squared, told
from prtcl.scene.plan import Trial
from prtcl.scene.planner import root

Array = npt.NDArray[np.float64]
Candidate = TypeVar("Candidate")

SAMPLES = 1024
"""Directions of a noisy reference at each point, at a time."""
RUNS, SECONDS = 8, 1.5
"""Times that the reference is made, at most, in halves, until it tells enough; and seconds that this may take."""
UNTOLD = 3.0
"""An error that the reference cannot tell from nothing at so many times what was asked is not promised."""
ENOUGH = 0.3
"""Of the squared error allowed, what one standard error of the finest settings' may be."""


@dataclass(frozen=True)
class Found(Generic[Candidate]):
    """The candidate, its squared error over the square of the mean, and what else was tried."""

    candidate: Candidate
    squared: Squared
    seconds: float
    trials: tuple[Trial, ...]


def coarsest(
    candidates: Sequence[Candidate],
    name: Callable[[Candidate], str],
    shade: Callable[[Candidate], npt.NDArray[np.floating]],
    reference: Callable[[], npt.NDArray[np.floating]],
    error: float,
    points: int,
    advice: str,
) -> Found[Candidate]:
    """Try candidates from coarse to fine, the last one first.

    Parameters
    ----------
    name : of a candidate, in words
    shade : radiance (n, 3) of the sample with a candidate
    reference : (n, 3) radiance without bias, noisy, another at every call
    error : relative RMSE that is allowed
    points : of the whole job, for its time
    advice : what a user may do where nothing meets the error

    Raises
    ------
    InputError
        If not even the last candidate meets the error, or the reference is far too noisy to say so.
    """
    start = time.perf_counter()
    halves = np.stack([reference(), reference()])
    mean = float(halves.mean())
    if not mean > 0.0:  # black: there is no relative error
        return Found(candidates[0], Squared(0.0, 0.0), 0.0, ())
    spent = time.perf_counter() - start
    fine, seconds = _timed(shade, candidates[-1], points)
    known = _against(fine, halves, mean)
    for run in range(1, RUNS):
        if known.uncertain <= ENOUGH * error**2 or spent * (run + 1) / run > SECONDS:
            break
        start = time.perf_counter()
        halves += (np.stack([reference(), reference()]) - halves) / (run + 1)
        spent += time.perf_counter() - start
        known = _against(fine, halves, mean)
    if told(known) <= error**2 < (known.uncertain / UNTOLD**2):
        raise InputError(
            f"error {error:.2g}: what vertices err can be told to {root(known.uncertain):.2g} only\n{advice}"
        )
    trials: list[Trial] = []
    for candidate in candidates:
        last = candidate == candidates[-1]
        got, takes = (fine, seconds) if last else _timed(shade, candidate, points)
        off = squared(((got - fine) ** 2).mean(axis=1) / mean**2)
        whole = Squared(likely(known) + off.value, known.uncertain + off.uncertain)
        met = told(known) + off.value <= error**2
        trials.append(
            Trial(name(candidate), root(whole.value), root(whole.uncertain), 0.0, takes if met else None)
        )
        if met:
            return Found(candidate, whole, takes, tuple(trials))
    raise InputError(
        f"error {error:.2g}: no setting that was tried meets it: {trials[-1].name} err {trials[-1].bias:.2g}\n{advice}"
    )


def _against(radiance: npt.NDArray[np.floating], halves: Array, mean: float) -> Squared:
    return squared(np.prod([(radiance - half) / mean for half in halves], axis=0).mean(axis=1))


def _timed(
    shade: Callable[[Candidate], npt.NDArray[np.floating]], candidate: Candidate, points: int
) -> tuple[Array, float]:
    """Radiance with a candidate, and the seconds that all points would take."""
    start = time.perf_counter()
    got = np.asarray(shade(candidate), dtype=np.float64)
    return got, (time.perf_counter() - start) / max(1, len(got)) * points

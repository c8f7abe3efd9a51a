"""A row for every trial: run twice, compared byte for byte, and held against its bound."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.apps.stress.registry import Array, Case, Size, Trial
from prtcl.compute.device import Device

Row = dict[str, Any]
GOOD = ("ok", "explained")
RELIABLE = 1e-3
"""A larger relative error needs a word to the user, even where theory allows it."""


@dataclass(frozen=True)
class Judgement:
    """How far a result is off.

    Attributes
    ----------
    error : the largest relative to the trial's unit; infinite where the result is not finite or of another shape
    bound : what theory allows there, relative to the same
    ratio : the largest error over its own bound, which may be elsewhere
    """

    error: float
    bound: float
    ratio: float


def judge(trial: Trial, result: npt.ArrayLike) -> Judgement:
    """Hold a result against a trial's answer.

    Raises
    ------
    AssertionError
        If the trial itself is no good: an answer, a bound or a unit that is not finite, or a negative bound.
    """
    got = np.asarray(result, dtype=np.float64)
    wanted = np.asarray(trial.expected, dtype=np.float64)
    shape = (*wanted.shape[:-1], 1) if trial.rows else wanted.shape
    bound, unit = (np.broadcast_to(np.asarray(x, dtype=np.float64), shape) for x in (trial.bound, trial.unit))
    if not all(np.isfinite(x).all() for x in (wanted, bound, unit)) or (bound < 0).any() or not wanted.size:
        raise AssertionError(f"{trial.what}: the expected answer, its bound or its unit is no number")
    unit = np.where(unit > 0, unit, 1.0)
    if got.shape != wanted.shape or not np.isfinite(got).all():
        return Judgement(math.inf, float((bound / unit).max()), math.inf)
    error = np.abs(got - wanted)
    if trial.rows:
        error = np.linalg.norm(error, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(error == 0, 0.0, error / bound)
    relative = error / unit
    at = np.unravel_index(int(np.argmax(relative)), relative.shape)
    if relative[at] == 0:  # nothing is off: the widest bound says what was allowed
        return Judgement(0.0, float((bound / unit).max()), 0.0)
    return Judgement(float(relative[at]), float((bound / unit)[at]), float(ratios.max()))


def verdict(trial: Trial, found: Judgement, same: bool) -> str:
    """`ok`, `explained`, `exceeds`, `not finite`, or `not the same bytes` where two runs differ.

    An error within its bound is ok up to `RELIABLE`; beyond that, and beyond the bound up to the trial's limit, the
    trial has to explain it.
    """
    if not math.isfinite(found.error):
        return "not finite"
    if not same:
        return "not the same bytes"
    if found.ratio <= 1.0 and found.error <= RELIABLE:
        return "ok"
    allowed = found.ratio <= 1.0 or (trial.limit is not None and found.error <= trial.limit)
    return "explained" if allowed and trial.note else "exceeds"


def rows(device: Device, case: Case, size: Size) -> Iterator[Row]:
    """Rows of one case on one device."""
    for trial in case.trials(device, size):
        first = _bytes(trial)
        same = first.tobytes() == _bytes(trial).tobytes()
        found = judge(trial, first)
        before = None if trial.before is None else judge(trial, _bytes(trial, before=True))
        yield {
            "case": case.name, "title": case.title, "what": trial.what, "at": trial.at,
            "precision": device.precision, "error": _number(found.error), "bound": _number(found.bound),
            "ratio": _number(found.ratio), "relative_to": trial.relative_to, "theory": trial.theory,
            "finite": math.isfinite(found.error), "same_bytes": same,
            "before": None if before is None else _number(before.error),
            "before_finite": before is None or math.isfinite(before.error),
            "verdict": verdict(trial, found, same), "limit": trial.limit,
            "note": trial.note,
        }  # fmt: skip


def _bytes(trial: Trial, before: bool = False) -> Array:
    job = trial.before if before and trial.before is not None else trial.run
    # What overflows on the host is found in the result.
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        return np.ascontiguousarray(job())


def _number(value: float) -> float | None:
    """A number that JSON has: None where it is infinite."""
    return value if math.isfinite(value) else None

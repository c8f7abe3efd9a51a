"""A row for every stage and size: limits beside it, time, check, rivals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median
from typing import Any

from prtcl.apps.bench import limits
from prtcl.apps.bench.measure import RUNS, measure, summary
from prtcl.apps.bench.registry import Job, Stage
from prtcl.apps.bench.rivals import RIVALS, Missing, RivalJob
from prtcl.compute.device import Device

Row = dict[str, Any]


@dataclass(frozen=True)
class Limits:
    """The device's own, measured when the run began.

    Attributes
    ----------
    copy : the fastest copy, of buffers beyond the caches
    flops : multiply-adds' operations a second; form : how they were reached
    """

    copy: limits.Copy
    flops: float
    form: str

    @classmethod
    def of(cls, device: Device, runs: int = RUNS) -> Limits:
        """Measure both."""
        best = limits.copy(device, limits.LARGEST, runs)
        limits.give_back(device)
        return cls(best, *limits.multiply_adds(device, runs))

    def as_json(self) -> Row:
        return {
            "copy_bytes_per_second": self.copy.rate,
            "copy_form": self.copy.form,
            "copy_buffer_bytes": self.copy.bytes,
            "copy_seconds": self.copy.spread,
            "fma_flops_per_second": self.flops,
            "fma_form": self.form,
        }


def rows(
    device: Device,
    stage: Stage,
    points: int,
    levels: int,
    channels: int,
    top: Limits,
    memory: float,
    runs: int = RUNS,
    rivals: bool = False,
) -> Iterator[Row]:
    """The stage's row, then its rivals'.

    Parameters
    ----------
    points : asked for; more than fit `memory` bytes go in equal parts, one after another
    """
    channels = 1 if stage.grey else channels
    wanted = points if stage.most is None else min(points, stage.most)
    parts = math.ceil(wanted / stage.fits(device, memory, levels, channels))
    batch = math.ceil(wanted / parts)
    limits.give_back(device)
    # As large as what the stage moves: a guess from its rows, since the stage is made only after the copy.
    beside = limits.copy(device, batch * channels * 4**levels * 4, runs)
    limits.give_back(device)
    job = stage.prepare(device, batch, levels, channels)
    timing, result = measure(device, job.call, runs=runs, times=parts, reset=job.reset)
    error = job.check(result)
    clock = "device" if stage.clock == "device" and timing.by_events else "wall"
    seconds = timing.kernels if clock == "device" else timing.wall
    count, each = batch * parts, median(seconds)
    row: Row = {
        "stage": stage.name, "title": stage.title, "rival": None, "device": device.name, "unit": stage.unit,
        "points": points, "levels": levels, "channels": channels, "measured": count, "parts": parts,
        "points_in_a_part": batch, "clock": clock, "seconds": summary(seconds),
        "device_seconds": summary(timing.device), "wall_seconds": summary(timing.wall),
        "points_per_second": count / each, "wall_points_per_second": count / median(timing.wall),
        "coefficients_per_second": count * channels * 4**levels / each,
        **_roofline(stage, job, parts, each, beside, top),
        "error": error if math.isfinite(error) else None, "tolerance": job.tolerance,
        "correct": error <= job.tolerance, "note": _note(stage, job, points, count, parts, batch),
    }  # fmt: skip
    yield row
    if rivals:
        yield from _rivals(device, stage, job, row, runs)


def _roofline(stage: Stage, job: Job, parts: int, seconds: float, beside: limits.Copy, top: Limits) -> Row:
    """What had to be moved and done, and what share of the limits that is; none for the host's own work."""
    moved, done = job.bytes * parts, job.flops * parts
    memory, arithmetic = moved / beside.rate, done / top.flops
    out: Row = {
        "bytes": moved, "flops": done, "bytes_per_second": moved / seconds, "flops_per_second": done / seconds,
        "copy_bytes_per_second": beside.rate, "copy_form": beside.form, "bound": "host",
        "share_of_copy": None, "share_of_best_copy": None, "share_of_fma": None, "share_of_limit": None,
    }  # fmt: skip
    if not stage.host:
        out |= {
            "bound": "memory" if memory >= arithmetic else "arithmetic",
            "share_of_copy": memory / seconds,
            "share_of_best_copy": moved / top.copy.rate / seconds,
            "share_of_fma": arithmetic / seconds,
            "share_of_limit": max(memory, arithmetic) / seconds,
        }
    return out


def _note(stage: Stage, job: Job, points: int, count: int, parts: int, batch: int) -> str:
    notes = [job.note] if job.note else []
    if stage.most is not None and points > stage.most:
        notes.append(f"{count} {stage.unit} measured")
    if parts > 1:
        notes.append(f"{parts} parts of {batch} {stage.unit}")
    return "; ".join(notes)


def _rivals(device: Device, stage: Stage, job: Job, ours: Row, runs: int) -> Iterator[Row]:
    size = (ours["points_in_a_part"], ours["levels"], ours["channels"])
    same = ("stage", "title", "device", "unit", "points", "levels", "channels")
    for name, prepare in RIVALS.get(stage.name, []):
        row: Row = {key: ours[key] for key in same} | {"rival": name, "skipped": None}
        try:
            yield row | _fastest(device, prepare(stage.name, *size), job, ours, runs)
        except Missing as reason:
            yield row | {"skipped": str(reason)}
        except Exception as error:  # another's program must not end our run
            yield row | {"skipped": f"failed: {type(error).__name__}: {str(error).split(chr(10))[0]}"}


def _fastest(device: Device, made: RivalJob, job: Job, ours: Row, runs: int) -> Row:
    """What a rival reached in the fastest of its ways."""
    best: Row = {}
    for way, call in made.calls.items():
        timing, result = measure(device, call, runs=runs)
        error = job.check(made.answer(result))
        rate = made.points / median(timing.wall)
        if best and best["points_per_second"] >= rate:
            continue
        correct = error <= job.tolerance
        best = {
            "way": way, "measured": made.points, "clock": "wall", "seconds": summary(timing.wall),
            "points_per_second": rate,
            "coefficients_per_second": rate * ours["channels"] * 4 ** ours["levels"],
            "times_faster": ours["wall_points_per_second"] / rate if correct else None,
            "error": error if math.isfinite(error) else None, "tolerance": job.tolerance, "correct": correct,
            "note": made.note,
        }  # fmt: skip
    return best

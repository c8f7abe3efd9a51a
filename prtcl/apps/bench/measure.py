"""How long a call takes: OpenCL's own clock and the wall's, several runs after a warm-up."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

from prtcl.compute.device import Device

RUNS = 5
"""The least number of runs, of which the median counts."""


LEAST = 1e-7
"""Seconds below which no kernel can have run."""


@dataclass(frozen=True)
class Timing:
    """Seconds of every run.

    Attributes
    ----------
    device : by OpenCL events, 0 where nothing ran on the device
    wall : from the call until the queue is empty
    """

    device: tuple[float, ...]
    wall: tuple[float, ...]

    @property
    def by_events(self) -> bool:
        """Whether the device's events tell a time; rusticl's are nanoseconds apart or none, whatever was done."""
        return min(self.device) > LEAST

    @property
    def kernels(self) -> tuple[float, ...]:
        """The device's seconds; the wall's where its events tell none."""
        return self.device if self.by_events else self.wall


def summary(seconds: tuple[float, ...]) -> dict[str, float]:
    """Median, least and most."""
    return {"median": median(seconds), "min": min(seconds), "max": max(seconds)}


def measure(
    device: Device,
    call: Callable[[], Any],
    *,
    runs: int = RUNS,
    times: int = 1,
    reset: Callable[[], object] | None = None,
) -> tuple[Timing, Any]:
    """Time a call after one that warms up: programs are built then, and memory is touched.

    Parameters
    ----------
    device : whose queue the call uses; its profile is emptied
    call : what is timed
    runs : timed runs
    times : calls in a run, whose seconds are added
    reset : called before each of them, outside the clocks

    Returns
    -------
    timing : Timing
    result : of the warm-up's call; where the calls share a buffer it holds the last one's answer
    """
    if reset is not None:
        reset()
    result = call()
    device.queue.finish()
    on_device, on_wall = [], []
    for _ in range(runs):
        spent, waited = 0.0, 0.0
        for _ in range(times):
            if reset is not None:
                reset()
                device.queue.finish()
            device.profile.reset()
            start = time.perf_counter()
            call()
            device.queue.finish()
            waited += time.perf_counter() - start
            spent += sum(device.profile.device_seconds().values())
        on_device.append(spent)
        on_wall.append(waited)
    return Timing(tuple(on_device), tuple(on_wall)), result

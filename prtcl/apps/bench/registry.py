"""What a stage is to the bench, and the list of all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtcl.compute.device import Device


@dataclass(frozen=True, eq=False)
class Job:
    """A stage made ready at one size.

    Attributes
    ----------
    call : runs it once; what it returns goes to `check`
    bytes : that one call must move, inputs read once and outputs written once (`prtcl.apps.bench.costs`)
    flops : that one call must do
    check : worst relative error of a result, against float64; takes device and host arrays alike
    tolerance : the most that `check` may find
    reset : called before each timed call, for stages that overwrite their input
    note : for the row
    """

    call: Callable[[], Any]
    bytes: float
    flops: float
    check: Callable[[Any], float]
    tolerance: float = 2e-5
    reset: Callable[[], object] | None = None
    note: str = ""


Prepare = Callable[[Device, int, int, int], Job]
"""Of device, points, levels and channels."""


@dataclass(frozen=True)
class Stage:
    """One line of the table.

    Attributes
    ----------
    name, title : for the command line, for people
    prepare : makes the job
    unit : what is counted
    rows : rows of channels · 4**levels values that a point's buffers hold together; the largest buffer is one of them
    most : units measured at most, None for as many as asked for
    clock : "device" or "wall", which of the two the rates are by
    host : whether the work is the host's, which the device's limits say nothing about
    grey : whether channels make no difference
    """

    name: str
    title: str
    prepare: Prepare
    unit: str = "points"
    rows: float = 2.0
    most: int | None = None
    clock: str = "device"
    host: bool = False
    grey: bool = False

    def fits(self, device: Device, memory: float, levels: int, channels: int) -> int:
        """Units whose buffers fit `memory` bytes, and the largest of them one buffer; 1 at least.

        An eighth of the largest buffer is left free: the device's pool rounds sizes up, by a sixteenth at most.
        """
        row = channels * 4**levels * np.dtype(device.dtype).itemsize
        one = device.max_allocation * 7 // 8 // row
        return max(1, min(int(memory / (max(self.rows, 0.05) * row)), one))


STAGES: dict[str, Stage] = {}
"""All stages by name, in the order of the table."""


def stage(name: str, title: str | None = None, **facts: Any) -> Callable[[Prepare], Prepare]:
    """Enter a function into `STAGES`; `facts` are `Stage`'s."""

    def enter(prepare: Prepare) -> Prepare:
        STAGES[name] = Stage(name, title or name.replace("_", " "), prepare, **facts)
        return prepare

    return enter

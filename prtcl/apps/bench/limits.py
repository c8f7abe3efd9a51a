"""What the device can do at best, measured: bytes copied and multiply-adds done a second (kernels/limits.cl)."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

import numpy as np

from prtcl.apps.bench.measure import RUNS, measure, summary
from prtcl.compute.device import Device

ROW = 4096
"""Values a work-item of `copy_rows` copies; buffers are whole rows."""
LARGEST = 128 << 20
"""Bytes of a copy's source at most: beyond any cache, and more tells nothing new."""
SMALLEST = 1 << 20
COPIES = (("copy_items", 4, 64), ("copy_rows", ROW, 1), ("copy_rows_stream", ROW, 1))
"""Kernel, values a work-item, group."""
CHAINS = ((1, 6), (1, 8), (1, 12), (64, 2), (64, 4), (64, 8))
"""Group and accumulators a work-item; the fastest counts."""
ITERATIONS = 1024


@dataclass(frozen=True)
class Copy:
    """A copy's rate.

    Attributes
    ----------
    rate : bytes a second, read and written together
    form : the kernel that reached it
    bytes : of the source
    spread : seconds, as `measure.summary` gives them
    """

    rate: float
    form: str
    bytes: int
    spread: dict[str, float]


def give_back(device: Device) -> None:
    """Return memory that the pool holds for arrays of other sizes."""
    device.queue.finish()
    device.empty((1,)).allocator.free_held()


def copy(device: Device, wanted: float, runs: int = RUNS) -> Copy:
    """The fastest form of a copy of about so many bytes.

    Parameters
    ----------
    wanted : bytes of the source; what is taken lies between `SMALLEST` and `LARGEST` and within the largest buffer
    """
    import pyopencl as cl

    item = np.dtype(device.dtype).itemsize
    most = min(LARGEST, device.max_allocation // 2, device.memory // 8)
    rows = max(1, int(min(max(wanted, SMALLEST), most)) // (ROW * item))
    source, target = device.empty((rows * ROW,)), device.empty((rows * ROW,))
    for array in (source, target):
        cl.enqueue_fill_buffer(device.queue, array.data, np.ones(1, dtype=device.dtype), 0, array.nbytes)
    kernels = device.kernels("limits.cl", GROUP=64, ROW=ROW)
    found = []
    for name, width, group in COPIES:
        count = rows * ROW // width

        def run(name: str = name, count: int = count, group: int = group) -> object:
            return device.launch(kernels[name], count, group, source, target, count)

        timing, _ = measure(device, run, runs=runs)
        found.append((median(timing.kernels), name, summary(timing.kernels)))
    seconds, name, spread = min(found, key=lambda each: each[0])
    return Copy(2 * source.nbytes / seconds, name, source.nbytes, spread)


def multiply_adds(device: Device, runs: int = RUNS) -> tuple[float, str]:
    """Floating-point operations a second of independent multiply-adds, two each, and the form that reached them."""
    items = int(device.handle.max_compute_units) * (64 if device.is_cpu else 2048)
    out = device.empty((items,))
    best, form = 0.0, ""
    for group, chains in CHAINS:
        kernel = device.kernels("limits.cl", GROUP=group, ROW=ROW, ACCUMULATORS=chains)["multiply_adds"]

        def run(kernel: object = kernel, group: int = group) -> object:
            return device.launch(kernel, items, group, out, 0.999, 0.001, ITERATIONS)

        timing, _ = measure(device, run, runs=runs)
        rate = 2 * 16 * chains * ITERATIONS * items / median(timing.kernels)
        if rate > best:
            best, form = rate, f"{chains} chains of float16, groups of {group}"
    return best, form

"""Points go through a device in chunks that fit its memory and its largest allocation."""

from __future__ import annotations

from collections.abc import Iterator

from prtcl.compute.device import Device
from prtcl.errors import DeviceError

BUDGET = 256 << 20
"""Bytes of working memory that one chunk may take by default: a round number, not a tuned one."""


def chunk_size(device: Device, total_bytes: int, largest_bytes: int, budget: int | None = None) -> int:
    """Points that one chunk may hold.

    Parameters
    ----------
    total_bytes : bytes a point takes in all buffers together
    largest_bytes : bytes a point takes in the largest buffer
    budget : bytes for a chunk; None takes `BUDGET`, at most a quarter of the device's memory

    Raises
    ------
    DeviceError
        If not even one point fits.
    """
    limit = min(BUDGET, device.memory // 4) if budget is None else budget
    points = min(limit // total_bytes, device.max_allocation // largest_bytes)
    if points < 1:
        raise DeviceError(
            f"{device.name}: one point needs {total_bytes} bytes ({largest_bytes} in one buffer), more than the "
            f"{min(limit, device.max_allocation)} allowed\nuse fewer --levels or allow more memory"
        )
    return int(points)


def cache_bytes(device: Device, share: int = 1) -> int:
    """Bytes that each of `share` caches may keep on the device, in one buffer.

    An eighth of its memory for all: while a cache grows, old and new are there at once. An eighth of the largest
    buffer is left free, since the pool rounds sizes up, by a sixteenth at most.
    """
    return min(device.memory // 8, device.max_allocation - device.max_allocation // 8) // share


def largest_buffer(device: Device) -> int:
    """Bytes that one buffer may take which is kept as long as a session: a quarter of the memory is for the rest."""
    return min(device.max_allocation, device.memory * 3 // 4)


def chunks(count: int, size: int) -> Iterator[slice]:
    """Slices of at most `size` that cover ``range(count)``."""
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))

"""Device arrays with guard bands: every output, temporary and input of a test between two sentinels.

Inside ``with guard_bands(device):`` all of the device's new arrays lie between sentinels and are prefilled
with them. The sentinel is a NaN in float32 and float64 alike, so a value that a kernel forgot to write, or
read from beyond an array, is NaN in the answer; a value written beyond an array is found when the block ends.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from prtcl.compute.device import Device

SENTINEL = np.uint32(0x7FF8A5A5)
POCL = "Portable Computing Language"
BAND = 4096
"""Bytes on either side: a multiple of every device's alignment of sub-buffers (NVIDIA's is 512)."""


class Guarded:
    """One device array between two bands of sentinel, and prefilled with it."""

    def __init__(self, device: Device, shape: tuple[int, ...], dtype: Any) -> None:
        import pyopencl as cl
        import pyopencl.array as cla

        self.queue = device.queue
        self.size = math.prod(shape) * np.dtype(dtype).itemsize
        words = (2 * BAND + -(-self.size // 4) * 4) // 4
        self.whole = cl.Buffer(device.context, cl.mem_flags.READ_WRITE, 4 * words)
        cl.enqueue_copy(self.queue, self.whole, np.full(words, SENTINEL))
        inside = self.whole.get_sub_region(BAND, max(4, self.size))
        self.array = cla.Array(self.queue, shape, dtype, data=inside)

    def touched(self) -> int:
        """How many bytes of the bands have changed."""
        import pyopencl as cl

        words = np.empty(self.whole.size // 4, dtype=np.uint32)
        cl.enqueue_copy(self.queue, words, self.whole)
        content = words.view(np.uint8)
        clean = np.full(words.size, SENTINEL).view(np.uint8)
        changed = content != clean
        return int(changed[:BAND].sum() + changed[BAND + self.size :].sum())


@contextmanager
def guard_bands(device: Device) -> Iterator[list[Guarded]]:
    """Guard every array that `device` makes in the block; its end checks all bands."""
    made: list[Guarded] = []

    def empty(shape: tuple[int, ...], dtype: Any = None) -> Any:
        made.append(Guarded(device, shape, dtype or device.dtype))
        return made[-1].array

    def paste(source: Any, target: Any, row: int, column: int = 0, *, stage: str = "copies") -> None:
        """`Device.paste` by way of the host: PoCL 3.0 crashes as it copies a rectangle between parts of buffers."""
        if source.size:
            whole = target.get()
            whole[row : row + len(source), column : column + source.shape[1]] = source.get()
            target.set(whole)

    device.empty = empty  # type: ignore[method-assign]
    if device.platform == POCL:
        device.paste = paste  # type: ignore[method-assign]
    try:
        yield made
    finally:
        del device.empty
        vars(device).pop("paste", None)
    for guarded in made:
        touched = guarded.touched()
        assert not touched, f"{touched} bytes outside an array of shape {guarded.array.shape} were written"

"""One OpenCL device at work: its context, its in-order queue, its programs and its clock."""

from __future__ import annotations

import os
import tempfile
import threading
import warnings
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute import choice
from prtcl.compute.defines import Defines
from prtcl.compute.profile import Profile
from prtcl.compute.source import expand
from prtcl.errors import DeviceError, InputError, KernelBuildError

PRECISIONS = {
    "float32": ("float", "float", np.float32),
    "mixed": ("float", "double", np.float32),
    "float64": ("double", "double", np.float64),
}
"""Precision: (type stored, type of sums and products, NumPy dtype stored)."""

_BUILDING = threading.Lock()

MAX_ROWS = 65_535
"""Rows of work-items one launch may have: CUDA's limit on a grid's second dimension, which OpenCL on it inherits."""


class Device:
    """Context, queue and program cache of one OpenCL device.

    Parameters
    ----------
    spec : ``platform:device`` as in `prtcl.compute.choice`; None chooses
    queue : a caller's own `pyopencl.CommandQueue`; its context and device are used and never released here.
        It must execute in order.
    precision : "float32"; "mixed" stores float32 and sums in float64; "float64"
    build_options : more options for the OpenCL compiler, such as -cl-fast-relaxed-math; `prtcl stress` measures what
        they do to answers

    Raises
    ------
    DeviceError
        If there is no OpenCL device, or `precision` needs float64 and the device has none.
    InputError
        If the SPEC matches nothing or `precision` is unknown.

    Notes
    -----
    Nothing is allocated or compiled until it is needed. Device arrays of two `Device`s do not mix: OpenCL
    buffers belong to one context, and `array` says so.
    """

    def __init__(
        self, spec: str | None = None, *, queue: Any = None, precision: str = "float32",
        build_options: Sequence[str] = (),
    ) -> None:  # fmt: skip
        import pyopencl as cl
        from pyopencl.tools import ImmediateAllocator, MemoryPool

        if precision not in PRECISIONS:
            raise InputError(f"precision: expected one of {', '.join(PRECISIONS)}, got {precision!r}")
        if queue is None:
            seen, self.reason = choice.choose(spec)
            self.context = cl.Context([seen.handle])
            self.queue = cl.CommandQueue(
                self.context, properties=cl.command_queue_properties.PROFILING_ENABLE
            )
        elif queue.properties & cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE:
            raise InputError("queue: expected an in-order command queue, got an out-of-order one")
        else:
            self.context, self.queue, self.reason = queue.context, queue, "the caller's queue"
        self.handle = self.queue.device
        self.name: str = self.handle.name.strip()
        self.precision, self.build_options = precision, tuple(build_options)
        self.real, self.accumulator, dtype = PRECISIONS[precision]
        self.dtype: npt.DTypeLike = dtype
        if "double" in (self.real, self.accumulator) and "cl_khr_fp64" not in self.handle.extensions:
            raise DeviceError(f"{self.name}: precision {precision} needs float64, which this device lacks")
        self.is_cpu = bool(self.handle.type & cl.device_type.CPU)
        self.profile = Profile(
            enabled=bool(self.queue.properties & cl.command_queue_properties.PROFILING_ENABLE)
        )
        self._pool = MemoryPool(ImmediateAllocator(self.queue))
        self._programs: dict[tuple[str, Defines], dict[str, Any]] = {}
        self._constants: dict[Hashable, Any] = {}
        self._lock = threading.Lock()

    def __enter__(self) -> Device:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Wait for the queue and give back pooled memory; arrays still alive stay valid."""
        self.queue.finish()
        self._pool.stop_holding()

    def __repr__(self) -> str:
        return f"<prtcl.Device {self.name}, {self.precision}>"

    # --- memory ---------------------------------------------------------------------------------------------

    @cached_property
    def driver(self) -> str:
        """The driver's version."""
        return str(self.handle.driver_version.strip())

    @cached_property
    def platform(self) -> str:
        """Name of the OpenCL implementation."""
        return str(self.handle.platform.name.strip())

    @property
    def takes_vectors(self) -> bool:
        """Whether kernels written in vectors of sixteen suit it: a CPU's compiler keeps them.

        Mesa's rusticl takes them apart again, and minutes over each.
        """
        return self.is_cpu and self.platform != "rusticl"

    @property
    def beside_host(self) -> bool:
        """Whether it computes while the host does something else; a CPU's kernels take the host's own cores."""
        return not self.is_cpu

    @property
    def compute_units(self) -> int:
        """Cores of a CPU, multiprocessors of a GPU."""
        return int(self.handle.max_compute_units)

    @property
    def clock(self) -> int:
        """The largest clock frequency in MHz, 0 where the device does not say."""
        return int(self.handle.max_clock_frequency)

    @property
    def memory(self) -> int:
        """Bytes of global memory."""
        return int(self.handle.global_mem_size)

    @property
    def max_allocation(self) -> int:
        """Bytes of the largest single buffer."""
        return int(self.handle.max_mem_alloc_size)

    @property
    def held_bytes(self) -> int:
        """Bytes of device memory that the pool holds: about the most that was in use at once so far."""
        return int(self._pool.managed_bytes)

    def empty(self, shape: tuple[int, ...], dtype: npt.DTypeLike | None = None) -> Any:
        """An uninitialised device array, from the pool."""
        import pyopencl.array as cla

        return cla.empty(self.queue, shape, dtype or self.dtype, allocator=self._pool)

    def fetch(self, array: Any) -> Callable[[], npt.NDArray[Any]]:
        """Begin to copy a device array to the host, behind what is queued; the result, called, waits and returns it.

        Work queued in between runs on while the copy is waited for. The device array must not be written to before.
        """
        import pyopencl as cl

        host = np.empty(array.shape, dtype=array.dtype)
        if not array.size:
            return lambda: host
        event = cl.enqueue_copy(self.queue, host, array.base_data, src_offset=array.offset, is_blocking=False)
        self.queue.flush()

        def wait(_kept: Any = array) -> npt.NDArray[Any]:
            event.wait()
            return host

        return wait

    def array(self, value: Any, dtype: npt.DTypeLike | None = None, *, name: str = "array") -> Any:
        """`value` as a C-contiguous device array of `dtype`; a device array of this context passes unchanged.

        Raises
        ------
        InputError
            If a device array belongs to another context, or has another dtype or order.
        """
        import pyopencl.array as cla

        wanted = np.dtype(dtype or self.dtype)
        if isinstance(value, cla.Array):
            if value.context != self.context:
                raise InputError(
                    f"{name}: a device array of another OpenCL context (on {value.queue.device.name.strip()}) "
                    f"cannot be used on {self.name}; copy it with .get() first"
                )
            if value.dtype != wanted or not value.flags.c_contiguous:
                raise InputError(f"{name}: expected a C-contiguous {wanted} device array, got {value.dtype}")
            return value
        host = np.ascontiguousarray(value, dtype=wanted)
        out = self.empty(host.shape, wanted)
        if host.size:
            out.set(host, queue=self.queue)
        return out

    def constant(self, key: Hashable, make: Callable[[], npt.ArrayLike]) -> Any:
        """A device array that never changes, such as a table of directions: made and uploaded once."""
        if key not in self._constants:
            self._constants[key] = self.array(make())
        return self._constants[key]

    def paste(self, source: Any, target: Any, row: int, column: int = 0, *, stage: str = "copies") -> None:
        """Copy `source` (n, w) to ``target[row : row + n, column : column + w]``, device arrays of two axes.

        `source` may be some rows of a larger array of the same width.
        """
        import pyopencl as cl

        if not source.size:
            return
        item = source.dtype.itemsize
        width, pitch = source.shape[1] * item, target.shape[1] * item
        event = cl.enqueue_copy(
            self.queue, target.data, source.base_data, src_origin=(0, source.offset // width, 0),
            dst_origin=(column * item, row, 0), region=(width, source.shape[0], 1), src_pitches=(width, 0),
            dst_pitches=(pitch, 0),
        )  # fmt: skip
        self.profile.add(stage, event)

    # --- programs -------------------------------------------------------------------------------------------

    def kernels(self, file: str, **defines: int | float | str) -> dict[str, Any]:
        """The kernels of kernels/FILE built with `defines` (REAL and ACC are added), compiled once a device.

        Raises
        ------
        KernelBuildError
            With file, device, driver, defines, the compiler's log and where the expanded source was left.
        """
        key = (file, Defines(REAL=self.real, ACC=self.accumulator, **defines))
        with self._lock:
            if key not in self._programs:
                self._programs[key] = self._build(*key)
            return self._programs[key]

    def _build(self, file: str, defines: Defines) -> dict[str, Any]:
        import pyopencl as cl

        source = expand(file)
        try:
            # Warnings are filtered, and pyopencl keeps builds on disk, for the whole process.
            with _BUILDING, warnings.catch_warnings():
                # Several drivers fill the log of every good build; a bad one raises below.
                warnings.simplefilter("ignore", cl.CompilerWarning)
                program = cl.Program(self.context, source).build(
                    options=["-cl-std=CL1.2", *self.build_options, *defines.options], devices=[self.handle]
                )
        except cl.Error as error:
            handle, path = tempfile.mkstemp(prefix="prtcl-", suffix=".cl")
            with os.fdopen(handle, "w", encoding="utf-8") as dump:
                dump.write(source)
            raise KernelBuildError(
                f"{file}: does not build on {self.name} (driver {self.handle.driver_version}) with {defines}\n"
                f"the expanded source is in {path}; the compiler said:\n{error}"
            ) from error
        # Taken once: pyopencl makes a new kernel object at each retrieval, and warns.
        return {kernel.function_name: kernel for kernel in program.all_kernels()}

    def _argument(self, value: Any) -> Any:
        """What a kernel takes: sizes are ints, other numbers REALs, arrays their buffers."""
        if isinstance(value, int):
            return np.int32(value)
        if isinstance(value, float):
            return np.asarray(value, dtype=self.dtype)[()]
        return value.data if hasattr(value, "base_data") else value

    def launch(
        self, kernel: Any, items: int, group: int, *arguments: Any, y: int = 1, stage: str | None = None
    ) -> Any:
        """Enqueue `kernel` over at least `items` work-items in x, in groups of `group`, and `y` rows of them.

        The work-group size is always stated: PoCL otherwise picks a large one on its own. More than `MAX_ROWS`
        rows go in several launches with an offset, so a kernel learns its row from get_global_id(1), never from
        get_group_id(1).

        Returns
        -------
        event : pyopencl.Event of the last launch; all are recorded in `profile` under `stage` (default: the
            kernel's name)
        """
        if items == 0 or y == 0:
            return None
        data = [self._argument(argument) for argument in arguments]
        width = -(-items // group) * group
        with self._lock:  # argument setting and enqueueing of one kernel object is not thread-safe
            events = [
                kernel(self.queue, (width, min(MAX_ROWS, y - row)), (group, 1), *data, global_offset=(0, row))
                for row in range(0, y, MAX_ROWS)
            ]
        for event in events:
            self.profile.add(stage or kernel.function_name, event)
        return events[-1]

"""Several devices on one job: each point is shaded by one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Light
from prtcl.factors.visibility import Progress, Tracer
from prtcl.transport.pipeline import Pipeline, Pipelines, Points

Radiance = npt.NDArray[np.floating]


def shares(devices: Sequence[Device]) -> npt.NDArray[np.float64]:
    """How much of the work each device gets: (k,), their sum is 1.

    In proportion to compute units times clock, with a GPU's unit taken for as many lanes as eight of a CPU's cores
    have. A figure measured would be a better one, but then two runs would not share the work alike, and devices differ
    in their last bits.
    """
    rates = np.array(
        [d.compute_units * d.clock * (1.0 if d.is_cpu else 8.0) for d in devices], dtype=np.float64
    )
    rates = np.where(rates > 0.0, rates, 1.0)
    return rates / rates.sum()


class Several:
    """Pipelines of one job on several devices, used like `Pipelines`.

    Parameters
    ----------
    each : the same job's `Pipelines`, one a device

    Notes
    -----
    Points are dealt out in contiguous runs by `shares`: the same devices give the same bytes, and alike devices the
    bytes of one alone. Rays are traced by the host's cores for all.

    Raises
    ------
    InputError
        If the devices do not share one precision.
    """

    def __init__(self, each: Sequence[Pipelines]) -> None:
        precisions = {pipelines.device.precision for pipelines in each}
        if len(precisions) > 1:
            raise InputError(f"devices: expected one precision for all, got {', '.join(sorted(precisions))}")
        self.each = list(each)
        self._shares = shares([pipelines.device for pipelines in each])

    @property
    def all(self) -> list[Pipeline]:
        """Every device's pipelines."""
        return [pipeline for pipelines in self.each for pipeline in pipelines.all]

    @property
    def light(self) -> Light:
        """The light, as the first device's first pipeline has it."""
        return self.each[0].light

    def soft(
        self, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None = None,
        progress: Progress | None = None,
    ) -> Radiance:  # fmt: skip
        """As `Pipelines.soft`."""
        return self._dealt(
            points,
            lambda own, at: own.soft(tracer, points[at], None if bits is None else bits[at], progress),
        )

    def hard(self, tracer: Tracer, points: Points, progress: Progress | None = None) -> Radiance:
        """As `Pipelines.hard`."""
        return self._dealt(points, lambda own, at: own.hard(tracer, points[at], progress))

    def radiance(
        self, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None = None,
        progress: Progress | None = None,
    ) -> Radiance:  # fmt: skip
        """As `Pipelines.radiance`."""
        return np.asarray(self.soft(tracer, points, bits, progress) + self.hard(tracer, points))

    def _dealt(self, points: Points, run: Callable[[Pipelines, slice], Radiance]) -> Radiance:
        ends = np.rint(np.cumsum(self._shares) * len(points)).astype(int).tolist()
        parts = [slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True)]
        work = [(own, part) for own, part in zip(self.each, parts, strict=True) if part.stop > part.start]
        if len(work) <= 1:
            return run(*work[0]) if work else run(self.each[0], slice(0, 0))
        with ThreadPoolExecutor(len(work)) as pool:
            return np.concatenate(list(pool.map(lambda item: run(*item), work)))

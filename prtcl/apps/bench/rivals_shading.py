"""Rivals of the inner product with slices, and embree's bare loop, which visibility can at best be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from prtcl.apps.bench import world
from prtcl.apps.bench.costs import Size
from prtcl.apps.bench.oracle import FIRST
from prtcl.apps.bench.rivals import RivalJob, bounded, in_numba, in_torch, package, rival
from prtcl.apps.bench.shading import looked_up, table_of_slices
from prtcl.factors import hemisphere
from prtcl.factors import visibility as rays

STEP = 256
"""Points whose slices NumPy gathers at a time."""


class Shaded:
    """Coefficients, slices, and each point's two slices and weights, as the stage has them."""

    def __init__(self, points: int, levels: int, channels: int) -> None:
        self.points = bounded(points, Size(points, levels, channels).row)
        self.rows = world.host_rows(world.coefficients(levels, channels), self.points)
        self.slices = table_of_slices(levels, channels)
        index, weight = looked_up(points, levels)
        self.index, self.weight = index[: self.points], weight[: self.points]
        self.scale = 2 * np.pi / 4.0**levels

    def answer(self, result: Any) -> Any:
        """Radiance (k, 3) of the first points from sums (n, channels)."""
        sums = np.asarray(result[:FIRST]) * self.scale
        return np.broadcast_to(sums, (len(sums), 3))

    def job(self, calls: dict[str, Callable[[], Any]]) -> RivalJob:
        return RivalJob(calls, self.answer, self.points)


@rival("NumPy", "inner_product")
def numpy(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """Slices gathered and mixed some points at a time, and an einsum."""
    own = Shaded(points, levels, channels)

    def call() -> Any:
        out = np.empty((own.points, channels), dtype=np.float32)
        for start in range(0, own.points, STEP):
            part = slice(start, start + STEP)
            mixed = (own.slices[own.index[part]] * own.weight[part, :, None, None]).sum(axis=1)
            np.einsum("ncs,ncs->nc", own.rows[part], mixed, out=out[part])
        return out

    return own.job({"einsum": call})


@rival("PyTorch", "inner_product")
def pytorch(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """The same in tensor operations on all points at once."""
    torch = package("torch", "PyTorch")
    own = Shaded(points, levels, channels)
    given = [
        torch.from_numpy(x)
        for x in (own.rows, own.slices, own.index[:, 0].copy(), own.index[:, 1].copy(), own.weight)
    ]

    def shade(rows: Any, slices: Any, first: Any, second: Any, weight: Any) -> Any:
        mixed = slices[first] * weight[:, :1, None] + slices[second] * weight[:, 1:, None]
        return (rows * mixed).sum(dim=-1)

    return own.job(in_torch(torch, shade, *given))


@rival("Numba", "inner_product")
def numba(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """Loops in parallel over points, with fastmath."""
    compiler = package("numba", "Numba")
    own = Shaded(points, levels, channels)
    out = np.empty((own.points, channels), dtype=np.float32)

    @compiler.njit(parallel=True, fastmath=True)
    def shade(rows, slices, index, weight, out):  # type: ignore[no-untyped-def]
        for p in compiler.prange(rows.shape[0]):
            for c in range(rows.shape[1]):
                first, second = slices[index[p, 0], c], slices[index[p, 1], c]
                a, b = weight[p, 0], weight[p, 1]
                total = np.float32(0)
                for s in range(rows.shape[2]):
                    total += rows[p, c, s] * (a * first[s] + b * second[s])
                out[p, c] = total

    def call() -> Any:
        shade(own.rows, own.slices, own.index, own.weight, out)
        return out

    return own.job(in_numba(compiler, call))


@rival("embree, bare", "visibility")
def embree(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """embreex on every ray, made before, in as many threads as the tracer takes: nothing turned, nothing packed."""
    count = bounded(points, 2 * 3 * 4 * 4**levels)
    some, tracer = world.points(count), world.tracer()
    local = hemisphere.directions(levels)[:, :3]
    towards = np.matmul(local, some.frames).reshape(-1, 3)
    origins = np.repeat(some.origins, 4**levels, axis=0)

    def trace(part: slice) -> Any:
        return tracer._scene.run(origins[part], towards[part], query="OCCLUDED")

    def call() -> Any:
        return rays.in_parallel(trace, len(towards), rays.RAYS_PER_TASK)

    def answer(result: list[Any]) -> Any:
        seen = np.concatenate(result).reshape(count, -1) < 0
        return rays.pack(seen[:FIRST], max(1, 4**levels // 32))

    return RivalJob({"every ray": call}, answer, count)

"""Rivals of the products in the pixel domain: they mask samples, and give samples, which takes no transform."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from prtcl.apps.bench import oracle, world
from prtcl.apps.bench.costs import Size
from prtcl.apps.bench.oracle import FIRST
from prtcl.apps.bench.rivals import RivalJob, bounded, in_numba, in_torch, package, rival

NOTE = "gives samples, not coefficients"
PRODUCTS = ("product", "dense_reduction")


class Masked:
    """Samples (n, channels, 4**levels) and who sees them (n, 4**levels), unpacked."""

    def __init__(self, points: int, levels: int, channels: int) -> None:
        self.points = bounded(points, Size(points, levels, channels).row)
        self.samples = world.host_rows(world.samples(levels, channels), self.points)
        self.seen = world.unpacked(world.bits(self.points, levels), levels)
        self.out = np.empty_like(self.samples)

    def job(self, calls: dict[str, Callable[[], Any]]) -> RivalJob:
        return RivalJob(calls, lambda result: oracle.haar(np.asarray(result[:FIRST])), self.points, NOTE)


@rival("NumPy", *PRODUCTS)
def numpy(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """One multiplication into an array that is there already, by a mask of either kind."""
    own = Masked(points, levels, channels)
    whole, real = own.seen.astype(np.bool_)[:, None], own.seen.astype(np.float32)[:, None]
    return own.job(
        {
            "float mask": lambda: np.multiply(own.samples, real, out=own.out),
            "bool mask": lambda: np.multiply(own.samples, whole, out=own.out),
        }
    )


@rival("PyTorch", *PRODUCTS)
def pytorch(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """The same in one tensor operation."""
    torch = package("torch", "PyTorch")
    own = Masked(points, levels, channels)
    samples, out = torch.from_numpy(own.samples), torch.from_numpy(own.out)
    mask = torch.from_numpy(own.seen.astype(np.bool_))[:, None]

    def product(samples: Any, mask: Any, out: Any) -> Any:
        return out.copy_(torch.where(mask, samples, 0.0))

    return own.job(in_torch(torch, product, samples, mask, out))


@rival("Numba", *PRODUCTS)
def numba(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """Loops in parallel over points, with fastmath."""
    compiler = package("numba", "Numba")
    own = Masked(points, levels, channels)

    @compiler.njit(parallel=True, fastmath=True)
    def product(samples, seen, out):  # type: ignore[no-untyped-def]
        for p in compiler.prange(samples.shape[0]):
            for c in range(samples.shape[1]):
                for s in range(samples.shape[2]):
                    out[p, c, s] = samples[p, c, s] * seen[p, s]

    def call() -> Any:
        product(own.samples, own.seen, own.out)
        return own.out

    return own.job(in_numba(compiler, call))

"""Rivals of the Haar transforms: PyWavelets and PyTorch."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.apps.bench import world
from prtcl.apps.bench.costs import Size
from prtcl.apps.bench.oracle import FIRST
from prtcl.apps.bench.rivals import (
    RivalJob,
    bounded,
    in_threads,
    in_torch,
    package,
    rival,
    thread_counts,
    threaded,
)  # fmt: skip

PIECES = 4
"""Batches a thread."""
Pictures = npt.NDArray[Any]


def pictures(rows: Pictures) -> Pictures:
    """Rows (..., 4**levels) in Morton order as pictures (rows, side, side)."""
    levels = quadtree.levels_of(rows.shape[-1])
    side = 1 << levels
    return np.ascontiguousarray(
        rows.reshape(-1, side * side)[:, quadtree.grid_to_morton(levels).ravel()]
    ).reshape(-1, side, side)


def ours_of(bands: list[Any]) -> Pictures:
    """PyWavelets' bands [mean, (rows, columns, both) coarse to fine] as our rows of coefficients (n, 4**levels).

    Its details are a difference of the first and the second; ours are, too. Its first band is the one that changes
    sign with the row, our wavelet 10.
    """
    out = [bands[0].reshape(len(bands[0]), 1)]
    for level, (rows, columns, both) in enumerate(bands[1:]):
        order = quadtree.morton_to_grid(level)
        details = np.stack([band[:, order[0], order[1]] for band in (columns, rows, both)], axis=2)
        out.append(details.reshape(len(details), -1))
    return np.concatenate(out, axis=1)


@rival("PyWavelets", "forward_haar", "inverse_haar")
def pywavelets(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """wavedec2 and waverec2, by one thread and by all."""
    pywt = package("pywt", "PyWavelets")
    size = Size(points, levels, channels)
    count = bounded(points, size.row)
    images = pictures(world.host_rows(world.samples(levels, channels), count))
    how = {"wavelet": "haar", "mode": "periodization", "axes": (-2, -1)}

    def decompose(batch: Pictures) -> list[Any]:
        return list(pywt.wavedec2(batch, level=levels, **how))

    def recompose(bands: list[Any]) -> Pictures:
        return np.asarray(pywt.waverec2(bands, **how))

    def by(threads: int) -> Callable[[], list[Any]]:
        batches: list[Any] = np.array_split(images, min(len(images), PIECES * threads))
        if stage == "forward_haar":
            return partial(in_threads, threads, batches, decompose)
        return partial(in_threads, threads, [decompose(batch) for batch in batches], recompose)

    def forward(results: list[Any]) -> Pictures:
        rows = np.concatenate([ours_of(bands) for bands in results])
        return rows[: FIRST * channels].reshape(-1, channels, size.samples)

    def inverse(results: list[Any]) -> Pictures:
        grid = np.concatenate(results)[: FIRST * channels]
        rows, columns = quadtree.morton_to_grid(levels)
        return grid[:, rows, columns].reshape(-1, channels, size.samples)

    calls: dict[str, Callable[[], Any]] = {threaded(count): by(count) for count in thread_counts()}
    return RivalJob(calls, forward if stage == "forward_haar" else inverse, count)


@rival("PyTorch", "forward_haar", "inverse_haar")
def pytorch(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """The same butterflies in tensor operations, rows in Morton order as ours."""
    torch = package("torch", "PyTorch")
    size = Size(points, levels, channels)
    count = bounded(points, size.row)
    rows = world.samples if stage == "forward_haar" else world.coefficients
    given = torch.from_numpy(world.host_rows(rows(levels, channels), count))
    signs = torch.from_numpy(np.vstack([np.ones((1, 4)), quadtree.SIGNS]).astype(np.float32) / 2)

    def butterfly(values: Any) -> Any:
        return sum(values[..., c, None] * signs[:, c] for c in range(4))

    def forward(means: Any) -> Any:
        details = []
        for _ in range(levels):
            bands = butterfly(means.unflatten(-1, (-1, 4)))
            details.append(bands[..., 1:].flatten(-2))
            means = bands[..., 0]
        return torch.cat([means, *details[::-1]], dim=-1)

    def inverse(coefficients: Any) -> Any:
        means = coefficients[..., :1]
        for level in range(levels):
            details = coefficients[..., 4**level : 4 ** (level + 1)].unflatten(-1, (-1, 3))
            means = butterfly(torch.cat([means[..., None], details], dim=-1)).flatten(-2)
        return means

    calls = in_torch(torch, forward if stage == "forward_haar" else inverse, given)
    return RivalJob(calls, lambda result: result[:FIRST].numpy(), count)

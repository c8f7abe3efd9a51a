"""The stage of fixed views, transport times many environments, and its rival: NumPy's BLAS."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.apps.bench import costs, oracle
from prtcl.apps.bench.costs import Size
from prtcl.apps.bench.registry import Job, stage
from prtcl.apps.bench.rivals import RivalJob, bounded, rival
from prtcl.compute.device import Device
from prtcl.factors import sphere
from prtcl.transport import pixel_transport

ENVIRONMENTS = 100
VARIETY = 64
"""Different rows of transport, repeated."""

Array = npt.NDArray[np.float32]


def factors(points: int, levels: int, channels: int) -> tuple[Array, Array]:
    """Stand-ins for transport (channels, points, cells) and light (environments, cells, 3)."""
    rng, cells = np.random.default_rng([11, levels]), sphere.n_cells(levels)
    rows = rng.uniform(size=(channels, min(points, VARIETY), cells)).astype(np.float32)
    lights = rng.uniform(size=(ENVIRONMENTS, cells, 3)).astype(np.float32)
    return rows[:, np.arange(points) % rows.shape[1]], lights


def expected(rows: Array, lights: Array) -> npt.NDArray[np.float64]:
    """Radiance (k, 3, environments) of the first pixels in float64."""
    first = np.broadcast_to(rows[:, : oracle.FIRST], (3, *rows[:, : oracle.FIRST].shape[1:]))
    return np.einsum("cpk,ekc->pce", first.astype(np.float64), lights.astype(np.float64))


@stage("pixel_product", "transport times 100 environments", unit="pixels", rows=2.2)
def pixel_product(device: Device, points: int, levels: int, channels: int) -> Job:
    """Radiance of pixels under 100 environments from their transport over all cells of the sphere."""
    rows, lights = factors(points, levels, channels)
    transport, columns = device.array(rows), device.array(pixel_transport.panels(lights))
    cells = device.array(np.arange(sphere.n_cells(levels)), np.int32)

    def call() -> Any:
        return pixel_transport.product(device, transport, columns, cells)

    def check(result: Any) -> float:
        return oracle.error(oracle.host(result)[..., :ENVIRONMENTS], expected(rows, lights))

    return Job(
        call, *costs.pixel_product(Size(points, levels, channels), ENVIRONMENTS), check, tolerance=1e-4
    )


@rival("NumPy", "pixel_product")
def numpy(stage: str, points: int, levels: int, channels: int) -> RivalJob:
    """One matrix product of the BLAS for each channel."""
    own = bounded(points, 2 * Size(points, levels, channels).row)
    rows, lights = factors(own, levels, channels)
    cells = sphere.n_cells(levels)
    columns = np.ascontiguousarray(lights.transpose(2, 1, 0))  # (3, cells, environments)
    if channels == 1:
        columns = np.ascontiguousarray(columns.transpose(1, 0, 2).reshape(1, cells, -1))

    def call() -> Any:
        return np.matmul(rows, columns)

    def answer(result: Any) -> Any:
        first = np.asarray(result)[:, : oracle.FIRST]
        if channels == 1:
            return first[0].reshape(len(first[0]), 3, ENVIRONMENTS)
        return first.transpose(1, 0, 2)

    return RivalJob({"matmul": call}, answer, own)

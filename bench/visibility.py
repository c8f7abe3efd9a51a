"""Visibility: rays a second against the bare embree loop, and what tracing where neighbours disagree saves and costs.

    python bench/visibility.py [--points 2000] [-o bench/results/visibility.json]

Points are what a camera's pixels see. The bare loop is embreex on arrays made before, in as many threads as the tracer
takes: no directions turned, no bits packed. Medians of five runs.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import scenes

from prtcl.factors import hemisphere, visibility
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import read_mesh
from prtcl.scene.points import pixel_points, shoot
from prtcl.transport.pipeline import Points

MESHES = ("stanford_bunny", "nefertiti", "koala", "dream_apartment")
RUNS = 5


def seconds(job: Callable[[], object]) -> float:
    """Median wall time."""
    spent = []
    for _ in range(RUNS + 1):
        start = time.perf_counter()
        job()
        spent.append(time.perf_counter() - start)
    return median(spent[1:])


def measured(name: str, tracer: visibility.Tracer, points: Points, levels: int) -> dict[str, object]:
    """One row of the table."""
    count = len(points) * 4**levels
    world = np.matmul(hemisphere.directions(levels)[:, :3], points.frames).reshape(-1, 3)
    origins = np.repeat(points.origins, 4**levels, axis=0)

    def bare(part: slice) -> object:
        return tracer._scene.run(origins[part], world[part], query="OCCLUDED")

    def trace(every: bool) -> np.ndarray:  # type: ignore[type-arg]
        return tracer.visibility(points.origins, points.frames, levels, every=every)

    alone = seconds(lambda: visibility.in_parallel(bare, len(world), visibility.RAYS_PER_TASK))
    every, adaptive = seconds(lambda: trace(True)), seconds(lambda: trace(False))
    exact, before = trace(True), tracer.rays
    wrong = np.unpackbits((trace(False) ^ exact).view(np.uint8)).mean()
    traced = tracer.rays - before
    return {
        "mesh": name, "points": len(points), "cells": 4**levels, "bare_rays_per_second": count / alone,
        "every_of_bare": alone / every, "rays_saved": count / traced, "wrong_bits": float(wrong),
        "times_faster": every / adaptive, "points_per_second": len(points) / adaptive,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    scenes.require_data()
    rows = []
    for name in MESHES:
        mesh = read_mesh(scenes.mesh_path(name))
        tracer = visibility.Tracer(mesh.vertices, mesh.faces)
        camera = Camera.framing(mesh.bounds, size=(120, 120))
        pixels = np.arange(120 * 120)
        hits = shoot(tracer, camera, pixels, np.zeros_like(pixels))
        points = pixel_points(mesh, tracer, hits, np.zeros(len(hits.ray), dtype=np.int64))
        points = points[np.linspace(0, len(points) - 1, options.points).astype(int)]
        for levels in (5, 6):
            row = measured(name, tracer, points, levels)
            rows.append(row)
            print(
                "  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()),
                flush=True,
            )
    scenes.save(
        options.output, device=f"embree, {visibility.threads()} cores of {platform.machine()}",
        command="python bench/visibility.py", rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()

"""What tracing hard light in runs saves and costs: rays, and irradiance from the light's peaks at a mesh's vertices.

    python bench/hard_runs.py [-o bench/results/hard_runs.json]

Every sample of the peaks traced, against runs of several lengths of which three samples are traced first (Tree.runs,
Tracer.light_visibility): relative RMSE of the peaks' irradiance, and the worst vertex's error over the mean.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import scenes

from prtcl.factors.environment import Environment
from prtcl.factors.visibility import Tracer
from prtcl.files.radiance import read_radiance
from prtcl.scene.mesh import read_mesh
from prtcl.scene.points import vertex_points
from prtcl.transport import hard_tree

VERTICES, SIZES, MESHES = 4000, (32, 16, 8, 4), ("bob_342k", "nefertiti")


def seen(bits: np.ndarray, count: int) -> np.ndarray:
    return np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little", count=count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    scenes.require_data()
    rows = []
    for mesh_name in MESHES:
        mesh = read_mesh(scenes.mesh_path(mesh_name)).smooth()
        tracer = Tracer(mesh.vertices, mesh.faces)
        chosen = np.random.default_rng(0).choice(len(mesh.vertices), VERTICES, replace=False)
        points = vertex_points(mesh, tracer, only=chosen)
        for name in scenes.ENVIRONMENTS:
            image, _ = read_radiance(scenes.environment_path(name))
            for rotate in (0.0, 90.0):
                tree = hard_tree.Tree.over(hard := Environment(image, rotate).split(6).hard)
                samples = hard[tree.order]
                energy = np.maximum(points.frames[:, 2] @ samples[:, :3].T, 0.0) * samples[:, 3:].mean(axis=1)
                wanted = None
                for size in (1, *SIZES):
                    runs, rays, start = tree.runs(size), tracer.rays, time.perf_counter()
                    bits = tracer.light_visibility(
                        points.origins, points.frames[:, 2], samples[:, :3], runs=runs
                    )
                    seconds, rays = time.perf_counter() - start, tracer.rays - rays
                    irradiance = (seen(bits, len(samples)) * energy).sum(axis=1)
                    if wanted is None:
                        wanted, every = irradiance, rays
                    off = np.abs(irradiance - wanted) / wanted.mean()
                    row = {"mesh": mesh_name, "environment": name, "rotate": rotate, "samples": len(samples),
                           "run": size, "runs": len(runs), "seconds": seconds, "rays": rays / every,
                           "rmse": float(np.sqrt((off**2).mean())), "worst": float(off.max())}  # fmt: skip
                    rows.append(row)
                    print("{mesh:10} {environment:22} {rotate:3.0f}: runs of {run:2}: {rays:4.0%} of the rays, "
                          "{seconds:.2f} s, error {rmse:.2%}, worst {worst:.1%}".format(**row), flush=True)  # fmt: skip
    scenes.save(options.output, command="python bench/hard_runs.py", vertices=VERTICES, rows=rows)


if __name__ == "__main__":
    main()

"""How many rays a sub-pixel point needs: ambient occlusion with and without the rays' own cosines.

    python bench/rays.py [MESH ...] [-o bench/results/rays.json]

Every pixel's 64 points send 4^R rays each to places of their own in the cells. What is shown is relative RMSE over
the fully covered pixels, against 4^6 rays with their cosines, of sum V mean-cosine (what a table f_v alone gives) and
of sum V cosine (`hemisphere.ray_weights`). No mesh: the demo's own.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scenes

from prtcl.apps.demo_scene import build
from prtcl.factors import hemisphere
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh, read_mesh
from prtcl.scene.points import pixel_points, shoot

POINTS, SIZE, REFERENCE = 64, (36, 30), 6


def occlusion(mesh: Mesh, rays: int) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    """Pixels without and with the weights, those fully covered."""
    tracer, camera = Tracer(mesh.vertices, mesh.faces), Camera.framing(mesh.bounds, size=SIZE)
    count = SIZE[0] * SIZE[1]
    cosine = hemisphere.directions(rays)[:, 3].astype(np.float64)
    plain, weighted, hits_of = np.zeros(count), np.zeros(count), np.zeros(count, dtype=np.int64)
    for sub in range(POINTS):
        pixels = np.arange(count)
        hits = shoot(tracer, camera, pixels, np.full(count, sub))
        points = pixel_points(mesh, tracer, hits, np.full(len(hits.ray), sub))
        bits = tracer.visibility(points.origins, points.frames, rays, points.grid)
        seen = np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little")[:, : 4**rays]
        plain[hits.ray] += seen @ cosine
        weighted[hits.ray] += seen @ (cosine * hemisphere.ray_weights(rays, sub))
        hits_of[hits.ray] += 1
    whole = hits_of == POINTS
    scale = 2 / 4**rays / POINTS
    return plain[whole] * scale, weighted[whole] * scale


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="*")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    rows = []
    for mesh in [read_mesh(path) for path in options.mesh] or [build()]:
        _, truth = occlusion(mesh, REFERENCE)
        for rays in (3, 4, 5):
            errors = [
                float(np.sqrt(((got - truth) ** 2).mean()) / truth.mean()) for got in occlusion(mesh, rays)
            ]
            rows.append({"mesh": mesh.name, "rays": 4**rays, "plain": errors[0], "weighted": errors[1]})
            print(
                f"{mesh.name:16} {4**rays:5} rays: {100 * errors[0]:.2f} % plain, {100 * errors[1]:.2f} % weighted"
            )
    scenes.save(options.output, rows=rows)


if __name__ == "__main__":
    main()

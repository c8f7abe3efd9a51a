"""The reduction in place against the dense one, on the visibility of real meshes' vertices.

    python bench/sparse.py [--points 4000] [-o bench/results/sparse.json]

Both start from the light's coefficients of every point (three channels) and the same bits; the input is restored before
each run, outside the clock. Device time, medians of seven runs, the two in turn. Shares are of the finest squares.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from statistics import median

import numpy as np
import scenes

from prtcl import quadtree
from prtcl.apps.bench.costs import Size, bits_reduction, sparse_reduction
from prtcl.apps.bench.measure import measure
from prtcl.compute.device import Device
from prtcl.factors.visibility import Tracer
from prtcl.scene.mesh import read_mesh
from prtcl.scene.points import vertex_points
from prtcl.wavelet import masked

MESHES = ("stanford_bunny", "nefertiti", "koala", "dream_apartment")
RUNS, CHANNELS = 7, 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=4000)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    scenes.require_data()
    device, rows = Device(), []
    for name in MESHES:
        mesh = read_mesh(scenes.mesh_path(name))
        tracer = Tracer(mesh.vertices, mesh.faces)
        chosen = np.linspace(0, len(mesh.vertices) - 1, options.points).astype(int)
        points = vertex_points(mesh, tracer, None, chosen)
        for levels in (5, 6):
            bits = tracer.visibility(points.origins, points.frames, levels)
            rng, shape = np.random.default_rng(levels), (len(points), CHANNELS, quadtree.n_samples(levels))
            light = device.array(rng.standard_normal(shape, dtype=np.float32))
            work, words = device.empty(shape), device.array(bits, np.uint32)
            flat = light.reshape(len(points), -1), work.reshape(len(points), -1)

            def restore(flat=flat) -> None:  # type: ignore[no-untyped-def]
                device.paste(flat[0], flat[1], 0)

            def dense(light=light, words=words, levels=levels):  # type: ignore[no-untyped-def]
                return masked.reduce_coefficients(device, light, words, levels, levels)

            def sparse(work=work, words=words):  # type: ignore[no-untyped-def]
                return masked.reduce_in_place(device, work, words)

            times = [
                median(measure(device, call, runs=RUNS, reset=restore)[0].device) for call in (dense, sparse)
            ]
            restore()
            differs = float(np.abs(sparse().get() - dense().get()).max() / np.abs(light.get()).max())
            size = Size(len(points), levels, CHANNELS)
            finest = np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little").reshape(len(points), -1, 4)
            row = {
                "mesh": name, "levels": levels, "points": len(points),
                "dense_points_per_second": len(points) / times[0],
                "sparse_points_per_second": len(points) / times[1], "times_faster": times[0] / times[1],
                "bytes_ratio": bits_reduction(size)[0] / sparse_reduction(size, bits)[0],
                "mixed": float((finest.any(2) & ~finest.all(2)).mean()), "hidden": float((~finest.any(2)).mean()),
                "difference": differs,
            }  # fmt: skip
            rows.append(row)
            print(
                "  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()),
                flush=True,
            )
    scenes.save(
        options.output, device=device.name, driver=device.handle.driver_version, command="python bench/sparse.py",
        rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()

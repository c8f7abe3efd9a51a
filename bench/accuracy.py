"""The acceptance table: `prtcl render` at its defaults against the float64 reference at a higher resolution.

    python bench/accuracy.py [-o bench/results/accuracy.json] [--pixels 24] [--size 72x60]

Meshes and environments are those of bench/scenes.py. The reference is equation (1) in float64 NumPy
(`prtcl.reference`), at a sample of covered pixels stratified by their brightness. A pixel has 1,024 points. At each
the light below a threshold is summed over 32 x 32 directions, a random one of every cell, and the light above it with
a sample for every quarter texel; rays by embree as in the render. What is reported is relative RMSE over the sampled
pixels and all channels, and the reference's own noise: it is made in two halves, each a stratified set of points with
random directions of its own, and a quarter of their squared difference is the variance of their mean.

Directions must not follow from the points' places: taken from one sequence, they fill a plane of the integral's four
dimensions, both halves err alike, and this table's reference was once off by 2-3 % in some pixels. Mitsuba's picture
told (bench/path_tracer.py).
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import scenes

from prtcl import reference
from prtcl.apps.cli import size
from prtcl.compute.device import Device
from prtcl.factors.material import Material
from prtcl.scene.camera import Camera
from prtcl.scene.points import pixel_points, shoot
from prtcl.scene.scene import Scene

THRESHOLD = 30.0
"""Peaks start at this many times the mean radiance: well above the render's own threshold of ten."""
LEVELS, POINTS, PEAK_SIDE = 5, 1024, 4


def reference_pixel(
    scene: Scene, pixel: int, materials: list[dict], peaks: tuple, threshold: float
) -> np.ndarray:  # type: ignore[type-arg]
    """(materials, 2 halves, 3) radiance of one pixel."""
    total = np.zeros((len(materials), 2, 3))
    image, count = scene.environment.image, POINTS // 2
    for half in (0, 1):
        rng = np.random.default_rng([pixel, half])
        # Numbers far beyond those the render uses: the reference shares no sub-pixel point with it. An aligned run
        # of the sequence is stratified over the pixel by itself.
        hits = shoot(scene.tracer, scene.camera, np.full(count, pixel), 4096 * (half + 1) + np.arange(count))
        points = pixel_points(scene.mesh, scene.tracer, hits, np.zeros(len(hits.ray), dtype=np.int64))
        for i in range(len(points)):
            axes, view = points.frames[i].astype(np.float64), points.views[i].astype(np.float64)
            local = reference.directions(LEVELS, tuple(rng.random((2, 4**LEVELS))))
            soft = reference.environment_below(image, local @ axes, threshold) * (2 * np.pi / 4**LEVELS)
            above = peaks[0] @ axes[2] > 0
            local = np.concatenate([local, peaks[0][above] @ axes.T])
            light = np.concatenate([soft, peaks[1][above]])
            origins = np.repeat(points.origins[i : i + 1], len(local), axis=0)
            seen = ~scene.tracer.occluded(origins, (local @ axes).astype(np.float32))
            incoming = light[seen] * local[seen, 2:3]
            for m, material in enumerate(materials):
                f = reference.brdf(material, local[seen], view)
                total[m, half] += (incoming * f).sum(axis=0) / count
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--pixels", type=int, default=24)
    parser.add_argument("--size", type=size, default=(72, 60))
    parser.add_argument("--meshes", nargs="*", default=scenes.MESHES)
    parser.add_argument("--environments", nargs="*", default=scenes.ENVIRONMENTS)
    options = parser.parse_args()
    scenes.require_data()
    device = Device()
    rows = []
    for mesh in options.meshes:
        for environment in options.environments:
            renders = []
            for spec in scenes.MATERIALS:
                scene = Scene(
                    scenes.mesh_path(mesh), scenes.environment_path(environment), spec, device=device
                )
                scene.camera = Camera.framing(scene.mesh.bounds, size=options.size)
                renders.append((spec, scene.render()))
            solid = scene.environment.texel_solid_angles()[:, None]
            mean = float((scene.environment.image.mean(axis=2) * solid).sum() / (4 * np.pi))
            threshold = THRESHOLD * mean
            peaks = reference.peaks(scene.environment.image, threshold, PEAK_SIDE)
            covered = np.nonzero(renders[0][1].image[..., 3].ravel() > 0)[0]
            grey = renders[0][1].image[..., :3].sum(axis=2).ravel()[covered]
            ranked = covered[np.argsort(grey, kind="stable")]
            strata = np.array_split(ranked, options.pixels)
            rng = np.random.default_rng(7)
            pixels = np.array([rng.choice(stratum) for stratum in strata if len(stratum)])
            start = time.perf_counter()
            materials = [Material.parse(spec).reference() for spec in scenes.MATERIALS]
            exact = np.stack([reference_pixel(scene, int(p), materials, peaks, threshold) for p in pixels])
            seconds = time.perf_counter() - start
            for m, (spec, render) in enumerate(renders):
                truth = exact[:, m].mean(axis=1)
                noise = float(np.sqrt(((exact[:, m, 0] - exact[:, m, 1]) ** 2).mean() / 4) / truth.mean())
                got = render.image.reshape(-1, 4)[pixels, :3]
                row = {
                    "mesh": mesh,
                    "environment": environment,
                    "material": spec,
                    "relative_rmse": float(np.sqrt(((got - truth) ** 2).mean()) / truth.mean()),
                    "reference_noise": noise,
                    "bias": float(got.mean() / truth.mean() - 1),
                    "limit": scenes.LIMITS[m],
                    "pixels": len(pixels),
                    "seconds": round(render.report["seconds"]["total"], 2),
                    "points_per_pixel": render.report["points_per_pixel"],
                    "hard_samples": render.report["light"]["hard_samples"],
                }
                rows.append(row)
                print(
                    f"{mesh:15} {environment:24} {spec:28} rmse {100 * row['relative_rmse']:.2f} % "
                    f"(limit {100 * row['limit']:.0f} %, reference noise "
                    f"{100 * noise:.2f} %, bias {100 * row['bias']:+.2f} %)"
                    f"  {row['seconds']:.1f} s  reference {seconds:.0f} s",
                    flush=True,
                )
    if options.output is not None:
        result = {
            "device": device.name,
            "size": options.size,
            "command": "python bench/accuracy.py",
            "rows": rows,
        }
        options.output.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if any(row["relative_rmse"] > row["limit"] for row in rows):
        raise SystemExit("a limit was missed")


if __name__ == "__main__":
    main()

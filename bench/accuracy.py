"""The acceptance table: `prtcl render` at its defaults against the float64 reference at a higher resolution.

    python bench/accuracy.py [-o bench/results/accuracy.json] [--pixels 24] [--size 72x60]
    python bench/accuracy.py --meshes bob nefertiti --environments modern_buildings_2 --pixels 12 \
        --measured red-plastic gold-metallic-paint pearl-paint nickel -o bench/results/measured.json

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
import sys
import tempfile
import time
from pathlib import Path

import networks
import numpy as np
import scenes
from exact import Exact

from prtcl.apps.arguments import size
from prtcl.compute.device import Device
from prtcl.factors.material import Material
from prtcl.files.merl import write_merl
from prtcl.scene.camera import Camera
from prtcl.scene.points import pixel_points, shoot
from prtcl.scene.scene import Scene

LEVELS, POINTS, PEAK_SIDE = 5, 1024, 4
MEASURED_LIMIT = 0.03


def reference_pixel(scene: Scene, pixel: int, materials: list[dict], exact: Exact) -> np.ndarray:  # type: ignore[type-arg]
    """(materials, 2 halves, 3) radiance of one pixel."""
    total, count = np.zeros((len(materials), 2, 3)), POINTS // 2
    for half in (0, 1):
        rng = np.random.default_rng([pixel, half])
        # Numbers far beyond those the render uses: the reference shares no sub-pixel point with it. An aligned run
        # of the sequence is stratified over the pixel by itself.
        hits = shoot(scene.tracer, scene.camera, np.full(count, pixel), 4096 * (half + 1) + np.arange(count))
        points = pixel_points(scene.mesh, scene.tracer, hits, np.zeros(len(hits.ray), dtype=np.int64))
        for i in range(len(points)):
            axes, view = points.frames[i].astype(np.float64), points.views[i].astype(np.float64)
            places = tuple(rng.random((2, 4**LEVELS)))
            total[:, half] += exact.radiance(points.origins[i : i + 1], axes, view, materials, places) / count
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--pixels", type=int, default=24)
    parser.add_argument("--size", type=size, default=(72, 60))
    parser.add_argument("--meshes", nargs="*", default=scenes.MESHES)
    parser.add_argument("--environments", nargs="*", default=scenes.ENVIRONMENTS)
    parser.add_argument(
        "--measured",
        nargs="+",
        metavar="NAME",
        help="fitted materials of MERL, in its layout, in place of the others",
    )
    options = parser.parse_args()
    scenes.require_data()
    with tempfile.TemporaryDirectory() as folder:
        specs = [measured_file(name, Path(folder)) for name in options.measured or ()]
        run(options, specs or list(scenes.MATERIALS), (MEASURED_LIMIT,) * len(specs) or scenes.LIMITS)


def measured_file(name: str, folder: Path) -> str:
    """The SPEC of a fitted material, written in MERL's layout."""
    own = networks.measured("merl", name)
    write_merl(folder / f"{name}.binary", own.values, own.valid)
    return f"merl:{folder / name}.binary"


def run(options: argparse.Namespace, specs: list[str], limits: tuple[float, ...]) -> None:
    """All meshes, environments and materials."""
    device, rows = Device(), []
    given = [Material.parse(spec) for spec in specs]
    names = [Path(spec).stem if spec.startswith("merl:") else spec for spec in specs]
    for mesh in options.meshes:
        for environment in options.environments:
            renders = []
            for name, material in zip(names, given, strict=True):
                scene = Scene(
                    scenes.mesh_path(mesh), scenes.environment_path(environment), material, device=device
                )
                scene.camera = Camera.framing(scene.mesh.bounds, size=options.size)
                renders.append((name, scene.render()))
            exact = Exact(scene.environment, scene.tracer, LEVELS, PEAK_SIDE)
            covered = np.nonzero(renders[0][1].image[..., 3].ravel() > 0)[0]
            grey = renders[0][1].image[..., :3].sum(axis=2).ravel()[covered]
            ranked = covered[np.argsort(grey, kind="stable")]
            strata = np.array_split(ranked, options.pixels)
            rng = np.random.default_rng(7)
            pixels = np.array([rng.choice(stratum) for stratum in strata if len(stratum)])
            start = time.perf_counter()
            materials = [material.reference() for material in given]
            halves = np.stack([reference_pixel(scene, int(p), materials, exact) for p in pixels])
            seconds = time.perf_counter() - start
            for m, (spec, render) in enumerate(renders):
                truth = halves[:, m].mean(axis=1)
                noise = float(np.sqrt(((halves[:, m, 0] - halves[:, m, 1]) ** 2).mean() / 4) / truth.mean())
                got = render.image.reshape(-1, 4)[pixels, :3]
                row = {
                    "mesh": mesh,
                    "environment": environment,
                    "material": spec,
                    "relative_rmse": float(np.sqrt(((got - truth) ** 2).mean()) / truth.mean()),
                    "reference_noise": noise,
                    "bias": float(got.mean() / truth.mean() - 1),
                    "limit": limits[m],
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
    command = (
        " ".join(["python bench/accuracy.py", *sys.argv[1:]])
        if options.measured
        else "python bench/accuracy.py"
    )
    scenes.save(options.output, device=device.name, size=options.size, command=command, rows=rows)
    if any(row["relative_rmse"] > row["limit"] for row in rows):
        raise SystemExit("a limit was missed")


if __name__ == "__main__":
    main()

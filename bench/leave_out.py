"""What leaving out saves: each name on and off, on scenes where it should matter, and on one where it need not.

    python bench/leave_out.py [-o bench/results/leave_out.json] [--runs 5]

A flat ground under a grey sky with a bunny on it (a ball of as many vertices where ../shared/data is absent), half of
it away from the camera; the same from its vertices and from pixels. Every row is `Scene.render` from the mesh's arrays
to the image, on a device object of its own: seconds of the wall (the median of runs that take turns), bytes that the
device's memory pool came to hold and bytes of visibility on the host, and the difference of the picture from that of
everything computed. "all" leaves out what it can; a row "no-X" all but X; "none" nothing.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import scenes
import trimesh

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.factors.sky import sun_sky
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh, read_mesh
from prtcl.scene.scene import Scene, read_environment
from prtcl.transport.leave_out import WHAT

SIZE = (256, 192)


def grey_sky() -> Environment:
    image = sun_sky(128, sun_elevation=45.0, sun_azimuth=120.0).mean(axis=2, keepdims=True)
    return Environment(np.repeat(image, 3, axis=2), name="grey sky")


def still_life() -> Mesh:
    """The object on a flat ground of 129 × 129 vertices."""
    ball = trimesh.creation.icosphere(subdivisions=6)
    if scenes.DATA.is_dir():
        own = read_mesh(scenes.mesh_path("stanford_bunny"))
        ball = trimesh.Trimesh(own.vertices, own.faces, process=False)
    ball.apply_translation(-ball.bounds.mean(axis=0))
    ball.apply_scale(1.0 / ball.extents.max())
    ball.apply_translation([0.0, -ball.bounds[0, 1], 0.0])
    edge = np.linspace(-8.0, 8.0, 129)
    x, z = np.meshgrid(edge, edge)
    ground = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    corner = (np.arange(128)[:, None] * 129 + np.arange(128)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 129, corner + 1], 1),
            np.stack([corner + 1, corner + 129, corner + 130], 1),
        ]
    )
    vertices = np.concatenate([ball.vertices, ground])
    normals = np.concatenate([ball.vertex_normals, np.tile([0.0, 1.0, 0.0], (len(ground), 1))])
    return Mesh.from_arrays(
        vertices, np.concatenate([ball.faces, faces + len(ball.vertices)]), normals, "still life"
    )


def measured(make, points: str, leave_out: str) -> tuple[dict, np.ndarray]:  # type: ignore[no-untyped-def, type-arg]
    device = Device()
    start = time.perf_counter()
    scene = make(device=device, leave_out=leave_out)
    render = scene.render(points=points)
    seconds = time.perf_counter() - start
    shaded = sum(v for k, v in render.report["points_shaded"].items() if k != "hard")
    words = quadtree.visibility_words(render.report["settings"][0]["rays"])
    row = {
        "leave_out": leave_out, "seconds": seconds, "device_bytes": device.held_bytes,
        "bytes_of_all_points": shaded * (sum(render.report["bytes_per_point"].values()) + 4 * words),
        "points": shaded, "rays": render.report["rays"], "left_out": render.report["left_out"],
    }  # fmt: skip
    return row, render.image


def rows(make, points: str, runs: int, names: list[str]) -> list[dict]:  # type: ignore[no-untyped-def, type-arg]
    """All, all but each, and nothing left out, taking turns."""
    found: dict[str, list[dict]] = {name: [] for name in names}  # type: ignore[type-arg]
    measured(make, points, "all")  # kernels built
    measured(make, points, "none")
    images = {}
    for _ in range(runs):
        for name in names:
            row, images[name] = measured(make, points, name)
            found[name].append(row)
    seen = images["none"][..., 3] > 0
    mean = float(images["none"][seen][:, :3].mean())
    out = []
    for name in names:
        off = (images[name] - images["none"])[seen][:, :3].astype(np.float64)
        seconds = [row["seconds"] for row in found[name]]
        out.append(
            {
                **found[name][-1], "seconds": statistics.median(seconds), "fastest": min(seconds),
                "difference": float(np.sqrt((off**2).mean())) / mean,
            }
        )  # fmt: skip
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--names", nargs="+", default=["all", *(f"no-{name}" for name in WHAT), "none"])
    parser.add_argument("--cases", type=int, nargs="+", help="numbers of scenes, from 0")
    options = parser.parse_args()
    mesh = still_life()
    camera = Camera((1.2, 1.5, 2.6), (0.0, 0.35, 0.0), size=SIZE)
    still = partial(Scene, mesh, grey_sky(), "lambert:albedo=0.5", camera)
    fine = partial(still, levels=6, rays=6)
    cases = [("still life at 4^6 directions", fine, "vertex"), ("still life", still, "pixel")]
    if scenes.DATA.is_dir():
        real = read_mesh(scenes.mesh_path("nefertiti"))
        light = read_environment(scenes.environment_path("modern_buildings_2"))[0]
        framed = Camera.framing(real.bounds, size=SIZE)
        spec = "ggx:alpha=0.3,eta=0.2,k=3.0"
        cases.append(
            ("nefertiti, modern_buildings_2, GGX 0.3", partial(Scene, real, light, spec, framed), "vertex")
        )
    result = []
    for name, make, points in [cases[number] for number in options.cases or range(len(cases))]:
        own = rows(make, points, options.runs, options.names)
        best = own[0]
        print(f"{name}, {points} points")
        for row in own:
            print(
                f"  {row['leave_out']:14} {row['seconds']:7.2f} s ({row['seconds'] / best['seconds']:5.2f} x)  device "
                f"{row['device_bytes'] / 2**20:7.1f} MiB ({row['device_bytes'] / best['device_bytes']:5.2f} x)  "
                f"all points {row['bytes_of_all_points'] / 2**20:8.1f} MiB "
                f"({row['bytes_of_all_points'] / best['bytes_of_all_points']:5.2f} x)  "
                f"{row['rays'] / 1e6:7.2f} M rays  differs by {100 * row['difference']:.3f} %",
                flush=True,
            )
        result.append({"scene": name, "points": points, "rows": own})
    scenes.save(
        options.output,
        device=Device().name,
        size=SIZE,
        cases=result,
        command=" ".join(["python bench/leave_out.py", *sys.argv[1:]]),
    )


if __name__ == "__main__":
    main()

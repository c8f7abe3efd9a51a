"""What the numbers of the fixed-view engine cost and leave: one at a time away from its defaults.

    python bench/relight_choices.py [-o bench/results/relight_choices.json] [--pixels 60] [--points 128]

Relative RMSE over random covered pixels of the Stanford bunny at 512 × 512, against the float64 reference of
bench/relight.py, under a hard sun and an interior of many lamps. A row is one number changed: points along a pixel's
side, levels of the visibility grid and the blocks its rays begin with, the share of light from which it is hard, the
share from which hard light is traced, its pairs of direction and point, the probes of a group, and the spread of a
pixel's normals from which it traces all (-1: every pixel does).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scenes
from relight import MAPS, MESH, reference, rmse

from prtcl.compute.device import Device
from prtcl.factors import hard_groups, pixel_visibility
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import read_mesh
from prtcl.scene.points import pixel_points, shoot
from prtcl.scene.scene import read_environment
from prtcl.transport import light_columns
from prtcl.transport.fixed_view import FixedView

CHANGES = {
    "side": (4, 16), "rays": (6,), "blocks": (8, 32), "share": (0.005, 0.05, 0.3), "strong": (0.0, 0.05),
    "pairs": (1, 512), "probes": (4, 16), "uneven": (-1.0,),
}  # fmt: skip
DEFAULT = {
    "side": 8, "rays": 7, "blocks": pixel_visibility.BLOCKS, "share": light_columns.SHARE,
    "strong": hard_groups.STRONG, "pairs": hard_groups.PAIRS, "probes": hard_groups.PROBES,
    "uneven": pixel_visibility.UNEVEN,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--pixels", type=int, default=60)
    parser.add_argument("--points", type=int, default=128)
    options = parser.parse_args()
    scenes.require_data()
    device, mesh = Device(), read_mesh(scenes.mesh_path(MESH))
    tracer, camera = Tracer(mesh.vertices, mesh.faces), Camera.framing(mesh.bounds)
    count = camera.size[0] * camera.size[1]
    covered = np.concatenate(
        [
            part[shoot(tracer, camera, part, np.zeros_like(part)).ray]
            for part in np.array_split(np.arange(count), 8)
        ]
    )
    chosen = np.sort(np.random.default_rng(7).choice(covered, options.pixels, replace=False))
    maps = {name: read_environment(scenes.environment_path(name))[0] for name in MAPS}
    looks = [[Material.parse(spec)] for spec in scenes.MATERIALS]
    halves = reference(
        (mesh, tracer), [camera], [(0, int(p)) for p in chosen], maps, [look[0].reference() for look in looks],
        options.points, (False,),
    )  # fmt: skip
    rows = []
    for name, value in [("", 0), *((name, value) for name, values in CHANGES.items() for value in values)]:
        own = {**DEFAULT, **({name: value} if name else {})}
        pixel_visibility.BLOCKS = own["blocks"]
        hard_groups.STRONG, hard_groups.PAIRS = own["strong"], own["pairs"]
        hard_groups.PROBES, pixel_visibility.UNEVEN = own["probes"], own["uneven"]
        each = own["side"] ** 2
        pixel, sub = np.repeat(chosen, each), np.tile(np.arange(each), len(chosen))
        hits = shoot(tracer, camera, pixel, sub)
        points = pixel_points(mesh, tracer, hits, sub[hits.ray])
        before = tracer.rays
        view = FixedView(device, tracer, points, pixel[hits.ray], rays=own["rays"])
        between = tracer.rays
        got = view.radiance(list(maps.values()), looks, share=own["share"])
        row = {
            "changed": name, "to": value, "rays_per_pixel": (between - before) / len(chosen),
            "hard_rays_per_pixel": (tracer.rays - between) / len(chosen) / len(maps),
            "relative_rmse": [
                [rmse(got[m, n], halves[key, False].mean(axis=2)[:, m]) for m in range(len(looks))]
                for n, key in enumerate(maps)
            ],
        }  # fmt: skip
        rows.append(row)
        print(row, flush=True)
    noise = [
        [
            float(np.sqrt(((h[:, m, 0] - h[:, m, 1]) ** 2).mean() / 4) / h[:, m].mean())
            for m in range(len(looks))
        ]
        for h in halves.values()
    ]
    print("the reference's own noise", noise)
    scenes.save(
        options.output, command="python bench/relight_choices.py", maps=MAPS, materials=scenes.MATERIALS,
        default=DEFAULT, reference_noise=noise, rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()

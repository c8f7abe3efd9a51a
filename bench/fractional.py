"""Would fractional visibility pay? Four rays a cell averaged, against one ray a cell and against a finer product.

    python bench/fractional.py [-o bench/results/fractional.json]

Soft light of three environments at vertices of two meshes, from random views: relative RMSE against 4^7 directions with
four rays each. `one` is the default, L V f on 4^5 cells with a ray each; `fraction` the same with the share of four
rays; `multiplied fine` the product on 4^6 cells, kept at 4^5 (`--levels 6 --keep 5`), with the rays of `fraction`.

It would not: on the same rays the finer product errs half as much (bench/results/fractional.json).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scenes

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.factors import environment
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.files.radiance import read_radiance
from prtcl.scene.mesh import read_mesh
from prtcl.scene.points import vertex_points

VERTICES, MESHES, SPECS = 150, ("stanford_bunny", "nefertiti"), scenes.MATERIALS[:2]
FINE, TRUTH = 6, 7


def averaged(samples: np.ndarray, levels: int) -> np.ndarray:
    """Means over the cells of 4**levels, Morton order."""
    return samples.reshape(*samples.shape[:-1], 4**levels, -1).mean(axis=-1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    scenes.require_data()
    device, rng, rows = Device(), np.random.default_rng(0), []
    for mesh_name in MESHES:
        mesh = read_mesh(scenes.mesh_path(mesh_name)).smooth()
        tracer = Tracer(mesh.vertices, mesh.faces)
        points = vertex_points(mesh, tracer, only=rng.choice(len(mesh.vertices), VERTICES, replace=False))
        theta = np.arccos(rng.uniform(0.2, 1.0, VERTICES))
        views = np.stack([np.sin(theta), np.zeros(VERTICES), np.cos(theta)], axis=1)
        seen = {}
        for rays in (FINE - 1, FINE, TRUTH + 1):
            bits = tracer.visibility(points.origins, points.frames, rays, points.grid, every=True)
            seen[rays] = np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little")[
                :, None, : 4**rays
            ].astype(float)
        for name in scenes.ENVIRONMENTS:
            image, _ = read_radiance(scenes.environment_path(name))
            light = {r: environment.gather(device, Environment(image).split(r), points.frames).get().astype(float)
                     for r in (FINE - 1, FINE, TRUTH)}  # fmt: skip
            for spec in SPECS:
                material = Material.parse(spec).reference()
                f = {
                    r: np.stack([reference.slice_samples(material, v, r, 2).T for v in views])
                    for r in (FINE - 1, TRUTH)
                }
                truth = (light[TRUTH] * averaged(seen[TRUTH + 1], TRUTH) * f[TRUTH]).mean(axis=-1)
                coarse = light[FINE - 1]
                tried = {
                    "one": coarse * seen[FINE - 1],
                    "fraction": coarse * averaged(seen[FINE], FINE - 1),
                    "multiplied fine": averaged(light[FINE] * seen[FINE], FINE - 1),
                }
                row = {"mesh": mesh_name, "environment": name, "material": spec}
                for key, product in tried.items():
                    off = (product * f[FINE - 1]).mean(axis=-1) - truth
                    row[key] = float(np.sqrt((off**2).mean()) / truth.mean())
                rows.append(row)
                print(f"{mesh_name:15} {name:22} {spec:28}", {k: f"{row[k]:.2%}" for k in tried}, flush=True)
    scenes.save(options.output, command="python bench/fractional.py", vertices=VERTICES, rows=rows)


if __name__ == "__main__":
    main()

"""Whether Haar truncation of pixels' transport pays over the dense product with all environments.

    python bench/relight_wavelets.py [-o bench/results/relight_wavelets.json] [--pixels 512]

Rows of T of neighbouring pixels of the bunny are transformed, hemisphere by hemisphere, and each keeps its largest
coefficients, weighted by how much the environments' coefficients there vary: the same for every environment, so that
nothing can flicker between them. Per kept share: relative RMSE of radiance against the whole row, and seconds of
SciPy's sparse-dense product, beside those of the dense kernel on the columns that are not zero.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import scenes
from scipy import sparse

from prtcl.compute.device import Device
from prtcl.factors import sphere
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import read_mesh
from prtcl.scene.scene import read_environment
from prtcl.scene.view_points import ViewPoints
from prtcl.transport import pixel_transport
from prtcl.transport.fixed_view import FixedView, grids_for
from prtcl.transport.light_columns import Lights
from prtcl.wavelet import haar

SHARES = (1 / 128, 1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4)


def fastest(work, runs: int = 5) -> float:  # type: ignore[no-untyped-def]
    """Seconds of the best of some runs after one."""
    work()
    spent = []
    for _ in range(runs):
        begin = time.perf_counter()
        work()
        spent.append(time.perf_counter() - begin)
    return min(spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--pixels", type=int, default=512)
    options = parser.parse_args()
    scenes.require_data()
    device, rows = Device(), []
    mesh = read_mesh(scenes.mesh_path("stanford_bunny"))
    tracer = Tracer(mesh.vertices, mesh.faces)
    seen = ViewPoints.of(mesh, tracer, Camera.framing(mesh.bounds), 4, one_material=True)
    middle = seen.seen[len(seen.seen) // 2 :][: options.pixels]
    some = np.isin(seen.pixel, middle)
    view = FixedView(device, tracer, seen.points[some], seen.pixel[some], rays=6)
    maps = [
        read_environment(scenes.environment_path(name))[0]
        for name in ("modern_buildings_2", "st_fagans_interior")
    ]
    lights = [replace(own, rotate=7.2 * i) for own in maps for i in range(50)]
    for spec in scenes.MATERIALS:
        materials = Materials(device, [Material.parse(spec)])
        grids = grids_for(materials.list, 6)
        means = Lights.of(device, lights, [grids.light]).means[grids.light]
        _, _, tile = view._tile(slice(0, len(view)))
        every = device.array(np.arange(sphere.n_cells(grids.light)), np.int32)
        material = device.array(np.zeros(len(view.points)), np.int32)
        t = pixel_transport.transport(device, materials, material, tile, every, grids, 1)
        half = 4**grids.light
        whole = haar.forward(device, t.reshape(-1, 2, half)).get().reshape(len(view), -1).astype(np.float64)
        light = np.ascontiguousarray(means.transpose(0, 2, 1).reshape(-1, 2, half))
        light = (
            haar.forward(device, device.array(light)).get().reshape(len(lights) * 3, -1).astype(np.float64)
        )
        exact = whole @ light.T
        columns = device.array(pixel_transport.panels(means))
        cells = device.array(tile.seen(6, grids.light), np.int32)
        dense_rows = pixel_transport.transport(device, materials, material, tile, cells, grids, 1)

        def dense(rows=dense_rows, columns=columns, cells=cells):  # type: ignore[no-untyped-def]
            pixel_transport.product(device, rows, columns, cells)
            device.queue.finish()

        row = {
            "material": spec,
            "cells": len(every),
            "seen_cells": len(cells),
            "dense_seconds": fastest(dense),
        }
        importance = np.abs(whole) * light.std(axis=0)
        order, row["kept"] = np.argsort(-importance, axis=1), []
        packed = np.ascontiguousarray(light.T.astype(np.float32))
        for share in SHARES:
            count = int(share * whole.shape[1])
            kept = np.zeros_like(whole)
            np.put_along_axis(kept, order[:, :count], np.take_along_axis(whole, order[:, :count], 1), 1)
            error = float(np.sqrt(((kept @ light.T - exact) ** 2).mean()) / exact.mean())
            matrix = sparse.csr_matrix(kept.astype(np.float32))
            seconds = fastest(lambda matrix=matrix, packed=packed: matrix @ packed)
            row["kept"].append({"share": share, "relative_rmse": error, "sparse_seconds": seconds})
        rows.append(row)
        print(row, flush=True)
    scenes.save(options.output, command="python bench/relight_wavelets.py", device=device.name, rows=rows)


if __name__ == "__main__":
    main()

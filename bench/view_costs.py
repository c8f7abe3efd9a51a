"""Where the time of V ⊕ f_v goes, and what keeping parts of it would save: a view's rays, its transport, its products.

    python bench/view_costs.py [-o bench/results/view_costs.json] [--size 192] [--environments 128]

For one view of a mesh and each material: seconds of every stage for a block of turned lights, as `prtcl relight` makes
them. Then, of the first tiles of pixels,

- what the transport T itself takes as a file: bytes a pixel, and seconds to read it (Zstandard level 1 and SHA-256, on
  one core, from memory) against those to make it again;
- the same for what T is made of and no material or light changes: the bits of visibility;
- an incremental update I_t = I_(t−1) + T ΔL at a share of changed cells, against the product over all cells.
"""

from __future__ import annotations

import argparse
import hashlib
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import scenes

from prtcl.compute.device import Device
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import read_mesh
from prtcl.scene.scene import read_environment
from prtcl.scene.view_points import ViewPoints
from prtcl.transport import pixel_transport
from prtcl.transport.fixed_view import TILE, FixedView, grids_for, rays_for
from prtcl.transport.light_columns import Lights

COLOURED = "lambert:albedo=0.8/0.2/0.1"
SHARES = (0.01, 0.1, 1.0)
REPEAT = 3


def best(work):  # type: ignore[no-untyped-def]
    """Seconds of the fastest of some runs, and what the last gave."""
    seconds = []
    for _ in range(REPEAT):
        start = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - start)
    return min(seconds), result


def stored(array):  # type: ignore[no-untyped-def]
    """Bytes of an array as a file, and seconds to check and unpack it."""
    from numcodecs.zstd import Zstd

    codec = Zstd(level=1)
    packed = codec.encode(np.ascontiguousarray(array))
    seconds, _ = best(lambda: (hashlib.sha256(packed).digest(), codec.decode(packed)))
    return len(packed), seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--mesh", default="nefertiti")
    parser.add_argument("--environment", default="modern_buildings_2")
    parser.add_argument("--size", type=int, default=192)
    parser.add_argument("--environments", type=int, default=128)
    options = parser.parse_args()
    scenes.require_data()
    device, mesh = Device(), read_mesh(scenes.mesh_path(options.mesh))
    tracer = Tracer(mesh.vertices, mesh.faces)
    camera = Camera.framing(mesh.bounds, size=(options.size, options.size))
    light, _ = read_environment(scenes.environment_path(options.environment))
    turns = [replace(light, rotate=360.0 * i / options.environments) for i in range(options.environments)]
    rows = []
    for spec in (*scenes.MATERIALS, COLOURED):
        look = [Material.parse(spec)]
        rays = rays_for(look)
        start = time.perf_counter()
        seen = ViewPoints.of(mesh, tracer, camera, one_material=True)
        shot = time.perf_counter() - start
        start = time.perf_counter()
        view = FixedView(device, tracer, seen.points, seen.pixel, rays=rays)
        traced = time.perf_counter() - start
        view.radiance(turns[:1], [look])  # compiles, and splits the map
        device.profile.reset()
        start = time.perf_counter()
        view.radiance(turns, [look])
        whole = time.perf_counter() - start
        host, kernels = device.profile.host_seconds(), device.profile.device_seconds()
        pixels = len(view)
        row = {
            "material": spec, "pixels": pixels, "rays": rays, "camera_rays": shot, "visibility_rays": traced,
            "radiance": whole, "host": host, "kernels": kernels,
            "resample_ms_a_light": 1e3 * host["resample_light"] / len(turns),
            "resample_share": host["resample_light"] / (shot + traced + whole),
        }  # fmt: skip
        grids, known = grids_for(look, rays), Materials(device, look)
        lights = Lights.of(device, turns[:16], [grids.light])
        columns = pixel_transport.panels(lights.means[grids.light])
        points, _, tile = view._tile(slice(0, min(TILE // 4, pixels)))
        cells = tile.seen(rays, grids.light)
        on_device, material = device.array(cells, np.int32), device.array(points.material, np.int32)

        def transport(args=(known, material, tile, on_device, grids)):  # type: ignore[no-untyped-def]
            got = pixel_transport.transport(device, *args, args[0].channels)
            device.queue.finish()
            return got

        made, transports = best(transport)
        packed, unpacked = stored(transports.get())
        bits, bits_seconds = stored(tile.bits)
        row |= {
            "transport_us_a_pixel": 1e6 * made / len(tile), "visibility_us_a_pixel": 1e6 * traced / pixels,
            "camera_us_a_pixel": 1e6 * shot / pixels,
            "transport_bytes_a_pixel": packed / len(tile), "transport_raw_bytes": transports.nbytes / len(tile),
            "transport_read_us_a_pixel": 1e6 * unpacked / len(tile),
            "bits_bytes_a_pixel": bits / len(tile), "bits_raw_bytes": tile.bits.nbytes / len(tile),
            "bits_read_us_a_pixel": 1e6 * bits_seconds / len(tile),
        }  # fmt: skip
        for share in SHARES:
            some = np.sort(
                np.random.default_rng(5).choice(len(cells), max(1, int(share * len(cells))), replace=False)
            )
            own, on = device.array(columns), device.array(cells[some], np.int32)
            part = device.array(np.ascontiguousarray(transports.get()[:, :, some]))

            def product(args=(part, own, on)):  # type: ignore[no-untyped-def]
                pixel_transport.product(device, *args)
                device.queue.finish()

            seconds, _ = best(product)
            row[f"product_us_a_pixel_and_light_{share}"] = 1e6 * seconds / len(tile) / 16
        rows.append(row)
        for key, value in row.items():
            print(f"  {key}: {value}")
    scenes.save(
        options.output, command="python bench/view_costs.py", device=device.name, mesh=options.mesh,
        size=options.size, environments=options.environments, rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()

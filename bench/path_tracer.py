"""Independent check: `prtcl render` at its defaults against Mitsuba 3, a path tracer that shares no code with it.

    DRJIT_LIBLLVM_PATH=/path/to/libLLVM-19.so python bench/path_tracer.py [-o bench/results/mitsuba.json]

Direct light, full images. Mitsuba's noise is what two halves of its samples differ by; it is part of the relative
RMSE shown. Both programs' seconds are wall time on the same cores, Mitsuba's at the samples a pixel shown: this is a
check of the picture, not a race at equal error.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import scenes
from rival import Rival

from prtcl.apps.arguments import size
from prtcl.compute.device import Device
from prtcl.scene.camera import Camera
from prtcl.scene.scene import Scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--spp", type=int, default=8192)
    parser.add_argument("--size", type=size, default=(110, 90))
    parser.add_argument("--meshes", nargs="*", default=scenes.MESHES)
    parser.add_argument("--environments", nargs="*", default=scenes.ENVIRONMENTS)
    options = parser.parse_args()
    scenes.require_data()
    device, rows = Device(), []
    for mesh in options.meshes:
        for environment in options.environments:
            for spec, limit in zip(scenes.MATERIALS, scenes.LIMITS, strict=True):
                scene = Scene(
                    scenes.mesh_path(mesh), scenes.environment_path(environment), spec, device=device
                )
                scene.camera = Camera.framing(scene.mesh.bounds, size=options.size)
                render = scene.render()
                rival = Rival(scene.mesh, scene.environment, scene.materials[0], scene.camera)
                rival.render(16)  # warm kernels
                start = time.perf_counter()
                halves = [rival.render(options.spp // 2, seed) for seed in (1, 2)]
                seconds = time.perf_counter() - start
                truth = (halves[0] + halves[1]) / 2
                covered = truth[..., 3] > 0
                row = {
                    "mesh": mesh,
                    "environment": environment,
                    "material": spec,
                    "relative_rmse": scenes.relative_rmse(render.image, truth),
                    "mitsuba_noise": scenes.relative_rmse(*halves) / 2,
                    "bias": float(render.image[covered][:, :3].mean() / truth[covered][:, :3].mean() - 1),
                    "limit": limit,
                    "seconds": round(render.report["seconds"]["total"], 2),
                    "mitsuba_seconds": round(seconds, 2),
                    "mitsuba_spp": options.spp,
                }
                rows.append(row)
                print(
                    "  ".join(f"{k} {v:.4f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()),
                    flush=True,
                )
    scenes.save(
        options.output, device=device.name, size=options.size,
        command=f"python bench/path_tracer.py --spp {options.spp}", rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()

"""`prtcl.relight` against a loop of single renders: the same images, at the same number of points a pixel.

    python bench/relight_loop.py [-o bench/results/relight_loop.json] [--size 96x96] [--rotations 4]

The loop makes a `Scene` of files for each image, as a shell loop of `prtcl render --samples 3` would, less the start of
a process. Both run once before they are timed, on one image, so that no kernel is compiled in the times. What differs
between the images is told, in units of float32's rounding of each value.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import scenes

from prtcl.apps.arguments import size
from prtcl.compute.device import Device
from prtcl.scene.camera import Camera
from prtcl.scene.frames import relight
from prtcl.scene.frames_engine import BUSY
from prtcl.scene.mesh import read_mesh
from prtcl.scene.scene import Scene, read_environment

MATERIALS = ["lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.04,kd=0.5", "ggx:alpha=0.4,f0=1.0/0.77/0.34"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--size", type=size, default=(96, 96))
    parser.add_argument("--rotations", type=int, default=4)
    parser.add_argument("--mesh", default="nefertiti")
    parser.add_argument("--environments", nargs="+", default=["lebombo", "kloppenheim_05"])
    options = parser.parse_args()
    scenes.require_data()
    path, maps = (
        scenes.mesh_path(options.mesh),
        [scenes.environment_path(name) for name in options.environments],
    )
    turns = [360.0 * k / options.rotations for k in range(options.rotations)]
    camera = Camera.framing(read_mesh(path).bounds, size=options.size)
    device = Device()

    def batch(lights: list[Path], degrees: list[float], materials: list[str]) -> list[np.ndarray]:
        frames = relight(path, lights, materials, [camera], rotations=degrees, device=device)
        return [frame.image for frame in frames]

    def loop(lights: list[Path], degrees: list[float], materials: list[str]) -> list[np.ndarray]:
        return [
            Scene(path, read_environment(light, rotate=turn)[0], material, camera, device=device)
            .render(samples=3)
            .image
            for light in lights
            for turn in degrees
            for material in materials
        ]

    for way in (batch, loop):
        way(maps[:1], turns[:1], MATERIALS)
    device.profile.reset()
    start = time.perf_counter()
    ours = batch(maps, turns, MATERIALS)
    seconds = time.perf_counter() - start
    host, kernels = device.profile.host_seconds(), sum(device.profile.device_seconds().values())
    start = time.perf_counter()
    theirs = loop(maps, turns, MATERIALS)
    naive = time.perf_counter() - start
    rounding = 2.0**-24 * np.abs(theirs)
    errors = np.divide(
        np.abs(np.subtract(ours, theirs)), rounding, out=np.zeros_like(rounding), where=rounding > 0
    )
    result = {
        "device": device.name, "mesh": options.mesh, "size": list(options.size), "images": len(ours),
        "environments": options.environments, "rotations": turns, "materials": MATERIALS,
        "relight_seconds": round(seconds, 2), "loop_seconds": round(naive, 2), "ratio": round(naive / seconds, 2),
        "images_per_second": round(len(ours) / seconds, 3),
        "busy_share": round((kernels + sum(host.get(stage, 0.0) for stage in BUSY)) / seconds, 3),
        "seconds_by_stage": {k: round(v, 2) for k, v in {**host, "kernels": kernels}.items()},
        "largest_difference_in_roundings": round(float(errors.max()), 2),
    }  # fmt: skip
    print(json.dumps(result, indent=2))
    scenes.save(options.output, command="python bench/relight_loop.py", **result)


if __name__ == "__main__":
    main()

"""Render a small image on the OpenCL device in sight: `python tests/render_small.py OUT.npz`.

Every kernel of a render takes part: all kinds of reflectance, light and visibility multiplied in the `pixel` domain
with the sun as hard light, and through the `tree` with the sun left in the map. OUT.npz holds these two images,
(18, 24, 4) float32 each, and the device's name.
tests/test_implementations.py compares what several OpenCL implementations make of it.
"""

from __future__ import annotations

import sys

import numpy as np

from prtcl.apps import demo_scene
from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material, from_table
from prtcl.factors.sky import sun_sky
from prtcl.scene.camera import Camera
from prtcl.scene.scene import Scene


def materials() -> list[Material]:
    """One of every kind, for the ground, the knot, the sphere, the vase and the steps."""
    values = np.linspace(0.5, 0.1, 6)[:, None] * np.linspace(1.0, 1.5, 5)
    return [
        Material.parse("lambert:albedo=0.45/0.42/0.38"),
        Material.parse("ggx:alpha=0.25,eta=0.18/0.42/1.37,k=3.4/2.35/1.77"),
        Material.parse("ggx:alpha=0.1,f0=0.04,kd=0.05/0.25/0.5"),
        Material.parse("blinn:exponent=40,ks=0.3,kd=0.4/0.3/0.2"),
        from_table(values, np.linspace(0.0, 1.5, 6), np.linspace(0.0, 1.5, 5)),
    ]


def main(path: str) -> None:
    camera = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(24, 18))
    sky = Environment(sun_sky(32, sun_elevation=52.0, sun_azimuth=130.0))
    mesh, device = demo_scene.build(), Device()
    images = {}
    for method, hard in (("pixel", "auto"), ("tree", "off")):
        settings = {"levels": 3, "rays": 3, "keep": 2, "views": 6, "method": method, "hard": hard}
        scene = Scene(mesh, sky, materials(), camera, device=device, **settings)
        render = scene.render(samples=2)
        if hard == "auto":
            assert render.report["light"]["hard_samples"] > 0, "no sun: the hard light was not tested"
        images[method] = render.image
    np.savez(path, device=f"{device.handle.platform.name.strip()} / {device.name}", **images)


if __name__ == "__main__":
    main(*sys.argv[1:])

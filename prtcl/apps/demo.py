"""`prtcl demo`: a first run that needs nothing: its own scene, a sun-and-sky environment, several materials."""

from __future__ import annotations

import argparse
import json

import numpy as np

from prtcl.apps.demo_scene import build
from prtcl.apps.progress import bar
from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.factors.sky import sun_sky
from prtcl.files.atomic import made_folder, replacing
from prtcl.files.image import write_exr
from prtcl.scene.camera import Camera
from prtcl.scene.scene import Scene

MATTE = ("lambert:albedo=0.45/0.42/0.38", "lambert:albedo=0.7/0.25/0.15", "lambert:albedo=0.2/0.35/0.6",
         "lambert:albedo=0.75", "lambert:albedo=0.6/0.55/0.3")  # fmt: skip
# Gold's and copper's indices are approximate, one for each of Rec.709's primaries.
STUDIO = ("lambert:albedo=0.45/0.42/0.38", "ggx:alpha=0.25,eta=0.18/0.42/1.37,k=3.4/2.35/1.77",
          "ggx:alpha=0.1,f0=0.04,kd=0.05/0.25/0.5", "ggx:alpha=0.3,f0=0.04,kd=0.75/0.7/0.62",
          "ggx:alpha=0.3,eta=0.27/0.68/1.22,k=3.6/2.63/2.29")  # fmt: skip
# A quarter of the default's rays, a third of its care for each pixel: a first look, there within the minute.
RAYS, PIXEL_ERROR = 4, 0.02
VIEWS = (
    ("noon-matte", 52.0, MATTE),
    ("noon-metal-and-glaze", 52.0, STUDIO),
    ("evening-metal-and-glaze", 9.0, STUDIO),
)


def run(options: argparse.Namespace) -> int:
    """Render the demo's images; leave EXR, PNG and report.json in the folder."""
    folder = made_folder(options.output)
    device = Device(options.device)
    mesh = build()
    camera = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=options.size)
    reports = {}
    for name, elevation, materials in VIEWS:
        sky = sun_sky(256, sun_elevation=elevation, sun_azimuth=130.0, turbidity=3.0)
        write_exr(
            folder / f"sky-{elevation:.0f}.exr", np.dstack([sky, np.ones(sky.shape[:2], np.float32)]), None
        )
        scene = Scene(
            mesh, Environment(sky, name="sun and sky"), materials, camera, device=device, rays=RAYS,
            pixel_error=PIXEL_ERROR,
        )  # fmt: skip
        with bar(name, options.quiet) as notify:
            render = scene.render(progress=notify)
        # Expose the sunlit ground to about two thirds of the display's white.
        exposure = float(np.log2(0.45 / np.percentile(render.image[..., :3][render.image[..., 3] > 0.5], 80)))
        render.save(folder / f"{name}.exr", png=folder / f"{name}.png", exposure=exposure)
        reports[name] = render.report
        if not options.quiet and not options.json:
            report = render.report
            print(
                f"{folder / name}.png  {sum(report['points_shaded'].values())} points, "
                f"{report['rays'] / 1e6:.1f} M rays, {report['seconds']['total']:.1f} s on {device.name}"
            )
    with replacing(folder / "report.json") as aside:
        aside.write_text(json.dumps(reports, indent=2) + "\n", encoding="utf-8")
    if options.json:
        print(json.dumps(reports, indent=2))
    return 0

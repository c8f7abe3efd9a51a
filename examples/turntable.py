"""A turntable: an object seen from all around, and a light that turns about it.

Purpose: the command line's `relight`, with views by --turntable and light by --env-rotate, and how its images become a
         video. Stop it at any moment, even by kill -9: the same command makes what is missing.
Expect:  two folders of PNG and EXR images in the folder given (default: a temporary one), `views` and `lights`, 8
         images each, and the ffmpeg command for a video.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import prtcl
from prtcl.apps.cli import main
from prtcl.files.image import read_image, write_exr

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())

body = trimesh.creation.icosphere(subdivisions=4)
body.vertices *= 1.0 + 0.15 * np.sin(5.0 * body.vertices[:, :1]) * np.cos(4.0 * body.vertices[:, 2:])
body.export(folder / "body.ply")
sky = prtcl.sun_sky(64, sun_elevation=35.0, sun_azimuth=60.0)
write_exr(folder / "sky.exr", np.dstack([sky, np.ones(sky.shape[:2])]))

common = [f"{folder}/body.ply", "--env", f"{folder}/sky.exr", "--brdf", "ggx:alpha=0.3,f0=0.04,kd=0.4/0.1/0.05",
          "--size", "80x80", "--samples", "2", "--smooth", "--png", "--exposure", "-4"]  # fmt: skip
assert main(["relight", *common, "--turntable", "8", "--elevation", "15", "-o", f"{folder}/views"]) == 0
assert main(["relight", *common, "--env-rotate", "0:360:45", "-o", f"{folder}/lights"]) == 0

images = f"{folder}/views/*.png"
print(
    f"ffmpeg -framerate 8 -pattern_type glob -i '{images}' -vf premultiply=inplace=1 -pix_fmt yuv420p turntable.mp4"
)

# The check: names sort as the object turns; views differ in shape, lights do not.
for kind in ("views", "lights"):
    frames = json.loads((folder / kind / "manifest.json").read_text())["frames"]
    assert [f["png"] for f in frames] == sorted(path.name for path in (folder / kind).glob("*.png"))
    images = [read_image(folder / kind / f["file"]) for f in frames]
    assert len(images) == 8 and len({image.tobytes() for image in images}) == 8
    assert (len({image[..., 3].tobytes() for image in images}) == 1) == (kind == "lights")

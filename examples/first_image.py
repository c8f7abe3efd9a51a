"""First image: a mesh, a light and a material made in memory, rendered and saved.

Purpose: the shortest path from arrays to a picture. A ball on a plate under a noon sky; no file is read.
Expect:  first_image.exr and first_image.png in the folder given (default: a temporary one), a ball with a hard
         shadow, and one line with the time it took.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import prtcl

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())

ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
ball.apply_translation([0.0, 1.0, 0.0])
plate = trimesh.creation.box(extents=[6.0, 0.1, 6.0])
plate.apply_translation([0.0, -0.05, 0.0])
both = trimesh.util.concatenate([ball, plate])
mesh = prtcl.Mesh.from_arrays(both.vertices, both.faces, name="ball on a plate")

sky = prtcl.Environment(prtcl.sun_sky(128, sun_elevation=45.0, sun_azimuth=60.0))
camera = prtcl.Camera(eye=(4.0, 3.0, 6.0), target=(0.0, 0.6, 0.0), size=(160, 120))
render = prtcl.Scene(mesh, sky, "lambert:albedo=0.6/0.5/0.4", camera).render()
render.save(folder / "first_image.exr", png=folder / "first_image.png", exposure=-4.0)
print(f"{folder}/first_image.png in {render.report['seconds']['total']:.1f} s on {render.report['device']}")

# The check: sunlit plate, and plate in the ball's shadow (the sun stands at the right, the shadow falls left).
lit, alpha = render.image[..., :3].mean(axis=2), render.image[..., 3]
assert np.isfinite(render.image).all() and 0.2 < alpha.mean() < 0.9
assert lit[alpha == 1].max() > 3 * np.percentile(lit[alpha == 1], 2), "no shadow in the picture"

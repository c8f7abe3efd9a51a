"""A light stage: one light at a time, then any light as a sum of the images.

Purpose: light transport is linear. The images of an object under each light of a stage, one at a time, are a basis: a
         weighted sum of them is the image under any light that the stage can make. Here the stage has a light for each
         texel of a coarse map.
Expect:  light_stage.npz in the folder given (default: a temporary one), a stack of 72 images of 40 × 40 pixels, and a
         line that says how near the sum comes to the image computed under all lights at once.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import prtcl

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())

ball = trimesh.creation.icosphere(subdivisions=3, radius=0.8)
ball.apply_translation([0.0, 0.8, 0.0])
post = trimesh.creation.box(extents=[0.3, 2.4, 0.3])
post.apply_translation([1.2, 1.2, 0.0])
both = trimesh.util.concatenate([ball, post])
mesh = prtcl.Mesh.from_arrays(both.vertices, both.faces, name="ball and post")
camera = prtcl.Camera((2.0, 2.0, 5.0), (0.4, 1.0, 0.0), size=(40, 40))
material = "ggx:alpha=0.35,f0=0.04,kd=0.5/0.4/0.3"

rows, columns = 6, 12
stage = np.zeros((rows * columns, rows, columns, 3), dtype=np.float32)
for number in range(rows * columns):
    stage[number, number // columns, number % columns] = 1.0
stack = np.stack([frame.image for frame in prtcl.relight(mesh, list(stage), [material], [camera])])
np.savez(folder / "light_stage.npz", stack=stack, lights=stage)

# A sky shown on the stage: the sum of its images, each weighted by the colour of its light. Alpha is that of all.
sky = prtcl.sun_sky(rows, sun_elevation=40.0, sun_azimuth=70.0)
summed = np.einsum("nhwc,nc->hwc", stack[..., :3], sky.reshape(-1, 3))
(direct,) = prtcl.relight(mesh, [sky], [material], [camera])
error = np.sqrt(np.mean((summed - direct.image[..., :3]) ** 2) / np.mean(direct.image[..., :3] ** 2))
print(
    f"{folder}/light_stage.npz: {len(stack)} images; their sum under a sky is {100 * error:.2f} % off the image itself"
)

# The check: a lone light is taken from its map and traced exactly, of a whole sky most stays in the map. Both agree.
assert error < 0.03 and len({image.tobytes() for image in stack}) > rows * columns // 2

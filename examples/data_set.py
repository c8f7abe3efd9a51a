"""A data set: one object under many environments, fed to a training loop as it is made.

Purpose: `prtcl.relight` as a generator. Rays are traced once a view; every light is then collapsed with them once, for
         all materials. No file is written for the loop: images are NumPy arrays, which PyTorch, JAX and others take
         without a copy (`torch.from_dlpack(frame.image)`). `prtcl relight --env FOLDER …` writes the same as files.
Expect:  data_set.npz in the folder given (default: a temporary one): images of a ring under 12 skies in 2 materials
         from 2 views with what each shows, and a line with the images a second.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh

import prtcl

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())

ring = trimesh.creation.torus(major_radius=1.0, minor_radius=0.4, major_sections=96, minor_sections=48)
mesh = prtcl.Mesh.from_arrays(ring.vertices, ring.faces, name="ring").smooth()
suns = [(elevation, azimuth) for elevation in (15.0, 35.0, 60.0) for azimuth in (0.0, 90.0, 180.0, 270.0)]
skies = [prtcl.Environment(prtcl.sun_sky(32, sun_elevation=e, sun_azimuth=a)) for e, a in suns]
materials = ["lambert:albedo=0.6/0.3/0.2", "ggx:alpha=0.3,f0=0.04,kd=0.1/0.2/0.4"]
cameras = [prtcl.Camera((0.0, 2.0, 4.0), (0.0, 0.0, 0.0), size=(48, 48)),
           prtcl.Camera((3.0, 2.0, 2.5), (0.0, 0.0, 0.0), size=(48, 48))]  # fmt: skip

start = time.perf_counter()
images, labels = [], []
for frame in prtcl.relight(mesh, skies, materials, cameras, samples=2):
    tensor = np.from_dlpack(frame.image)  # no copy; a training loop would take its step here
    images.append(tensor[..., :3])
    labels.append((*suns[frame.job.light], frame.job.material, frame.job.view))
seconds = time.perf_counter() - start
np.savez(folder / "data_set.npz", images=np.stack(images), labels=np.array(labels))
print(f"{folder}/data_set.npz: {len(images)} images, {len(images) / seconds:.1f} a second")

# The check: every image is its own, and over all images where the sun is, is where the light comes from.
assert len(images) == 48 and len({image.tobytes() for image in images}) == 48
brightness, height = np.array([image.mean() for image in images]), np.array(labels)[:, 0]
assert np.isfinite(brightness).all() and brightness[height == 60.0].mean() > brightness[height == 15.0].mean()

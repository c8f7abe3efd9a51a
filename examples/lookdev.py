# %% [markdown]
# # Lookdev: one object, one light, material after material
#
# Purpose: an editing session as an artist uses it. Light and visibility are collapsed once; after that every material
#          and every view costs milliseconds, without noise. Run the cells (`# %%`) in Jupyter or VS Code, where renders
#          and sessions show themselves, or all of it as a script.
# Expect:  lookdev.png in the folder given (default: a temporary one), six materials on a ring over a painted floor, and
#          a line a material: what was recomputed, and how long it took.

# %%
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

import prtcl

folder = Path(sys.argv[1] if len(sys.argv) == 2 else tempfile.mkdtemp())

# %% A ring in the first material slot, a floor in the second, whose vertices are painted: a checker of two colours.
ring = trimesh.creation.torus(major_radius=0.8, minor_radius=0.32, major_sections=160, minor_sections=64)
ring.apply_transform(trimesh.transformations.rotation_matrix(np.radians(25.0), [-0.6, 1, 0]))
ring.apply_translation([0.0, 1.15, 0.0])
side = np.linspace(-2.5, 2.5, 161)
x, z = np.meshgrid(side, side)
corner = np.arange(160 * 161).reshape(160, 161)[:, :-1].ravel()
tiles = np.concatenate([np.stack([corner, corner + 161, corner + 1], 1),
                        np.stack([corner + 1, corner + 161, corner + 162], 1)])  # fmt: skip
floor = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)
dark = (np.floor(floor[:, 0] * 2) + np.floor(floor[:, 2] * 2)) % 2 == 0

vertices = np.concatenate([ring.vertices, floor])
colours = np.ones((len(vertices), 3))
colours[len(ring.vertices) :] = np.where(dark[:, None], [0.25, 0.22, 0.2], [0.75, 0.72, 0.65])
mesh = prtcl.Mesh.from_arrays(
    vertices, np.concatenate([ring.faces, tiles + len(ring.vertices)]), name="ring", colours=colours
)
slot = (np.arange(len(vertices)) >= len(ring.vertices)).astype(int)

# %% The session: a low sun in a clear sky. The floor wears the mesh's own colours.
sky = prtcl.Environment(prtcl.sun_sky(128, sun_elevation=28.0, sun_azimuth=70.0))
camera = prtcl.Camera(eye=(2.6, 2.6, 4.4), target=(0.0, 0.9, 0.0), fov=38.0, size=(240, 200))
session = prtcl.Session(
    mesh, sky, ["lambert:albedo=0.6", "lambert:albedo=mesh"], camera, assignment=slot, levels=5
)
print(f"first view: {session.view(samples=2).report['seconds']}")
session.snapshot("plaster")

# %% Material after material: light and visibility are not touched again.
looks = {
    "gold": "ggx:alpha=0.15,f0=1.0/0.77/0.34",
    "brushed steel": "ggx:alpha=0.35,f0=0.56/0.57/0.58",
    "red plastic": "ggx:alpha=0.12,f0=0.04,kd=0.5/0.03/0.03",
    "jade glaze": "ggx:alpha=0.06,f0=0.05,kd=0.05/0.28/0.14",
    "rubber": "ggx:alpha=0.6,f0=0.03,kd=0.03",
}
shots = [session.view(samples=2)]
for name, look in looks.items():
    session.set_material(0, look)
    shots.append(session.view(samples=2))
    spent = {stage: round(1e3 * seconds) for stage, seconds in session.last.seconds.items()}
    print(f"{name:14} {sum(spent.values()):4} ms: {spent}")
    assert not {"light", "visibility", "collapse"} & session.last.seconds.keys(), (
        "an edit recomputed the light"
    )

# %% Go back, walk around, and turn the light: then L + V is collapsed anew, and no ray of visibility is traced again.
session.restore("plaster")
assert (session.view(samples=2).image == shots[0].image).all(), (
    "undone, the picture is the first again, bit for bit"
)
session.rotate_light(90.0)
session.view(samples=2)
assert "collapse" in session.last.seconds and "visibility" not in session.last.seconds

# %% The contact sheet. A render is linear and premultiplied; `save` writes EXR, and PNG as a preview.
images = [shot.image for shot in shots]
sheet = np.concatenate([np.concatenate(images[:3], axis=1), np.concatenate(images[3:], axis=1)], axis=0)
contact = replace(shots[0], image=sheet)
contact.save(folder / "lookdev.exr", png=folder / "lookdev.png", exposure=-4.2)
print(f"{folder}/lookdev.png on {session.device.name}")
contact  # noqa: B018  # shown by a notebook

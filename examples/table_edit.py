# %% [markdown]
# # A table: edit a BRDF by its angles
#
# Purpose: make a bivariate table f(θ_h, θ_d) of a material, edit it in ways that make sense, keep an eye on its energy,
#          and see both under the same light. `prtcl.Table.load("measured.npz")` starts from a measured one.
# Expect:  table_edit.png in the folder given (default: a temporary one): gold, and what became of it: sharper, redder,
#          mixed with plastic. A line for each edit, with the energy: the largest share of light that it reflects.

# %%
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

import prtcl

folder = Path(sys.argv[1] if len(sys.argv) == 2 else tempfile.mkdtemp())

# %% One edit after another; each gives a new table.
gold = prtcl.Table.of("ggx:alpha=0.3,f0=1.0/0.77/0.34")
print(gold.notes[-1])
edits = {"gold": gold}
edits["sharper"] = gold.sharpened(1.6)
edits["redder"] = edits["sharper"].tinted(1.0, 0.6, 0.5)
edits["no highlight at grazing angles"] = edits["redder"].painted((0, 20), (75, 90), factor=0.0)
edits["mixed"] = edits["redder"].blended("ggx:alpha=0.1,f0=0.04,kd=0.3/0.05/0.05", 0.4).conserved()
for name, table in edits.items():
    print(f"{name:32} energy {table.energy:.3f}")
edits["mixed"].save(folder / "mixed.npz")  # what `--brdf table:mixed.npz` reads

# %% Two pictures. The session edits what it wears in place, and undo takes it back.
ball = trimesh.creation.icosphere(subdivisions=5)
mesh = prtcl.Mesh.from_arrays(ball.vertices, ball.faces, name="ball")
sky = prtcl.Environment(prtcl.sun_sky(128, sun_elevation=40.0))
camera = prtcl.Camera(eye=(2.0, 1.5, 3.5), target=(0.0, 0.0, 0.0), fov=36.0, size=(200, 200))
session = prtcl.Session(mesh, sky, gold.material(), camera, levels=5)
before = session.view(samples=2)
session.edit(lambda worn: edits["mixed"])
after = session.view(samples=2)
print(f"after the edit: {round(1e3 * session.last.seconds['cuts'])} ms for its cuts")
session.undo()

# %% Checks: edits keep the energy that they should, no table makes light, and undo is bit for bit.
assert abs(edits["sharper"].energy / gold.energy - 1) < 0.02, "a sharper highlight reflects as much"
assert all(table.energy <= 1.0 + 1e-9 for table in edits.values()), "a table makes light"
assert (session.view(samples=2).image == before.image).all(), "undone, the picture is the first again"
red, green = (float(after.image[..., channel].mean()) for channel in (0, 1))
assert red > 1.5 * green, "the tint is seen"

sheet = replace(before, image=np.concatenate([before.image, after.image], axis=1))
sheet.save(folder / "table_edit.exr", png=folder / "table_edit.png", exposure=-4.5)
print(f"{folder}/table_edit.png on {session.device.name}")
sheet  # noqa: B018  # shown by a notebook

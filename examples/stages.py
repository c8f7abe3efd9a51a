"""The stages one by one: visibility, light, their product, a material, radiance.

Purpose: what `Scene` does, in six lines of arrays; here at the vertices of a mesh, for two materials that share one
         collapsed product L (+) V.
Expect:  two lines with the mean radiance of each material, and the same from the float64 reference.
"""

import numpy as np
import trimesh

import prtcl
from prtcl import reference
from prtcl.factors.hemisphere import frames_from

LEVELS = 5
torus = trimesh.creation.torus(1.0, 0.4, major_sections=24, minor_sections=12)
mesh = prtcl.Mesh.from_arrays(torus.vertices, torus.faces).smooth()
frames = frames_from(mesh.normals)
sky = prtcl.sun_sky(64, sun_elevation=60.0)

bits = prtcl.visibility(mesh, levels=LEVELS)  # what each vertex sees of the environment
light = prtcl.environment(sky, frames, levels=LEVELS)  # the environment in each vertex's frame
reduced = prtcl.triple(prtcl.haar(light), prtcl.visibility_haar(bits, levels=LEVELS))  # L (+) V, once

straight_up = np.array([[0.0, 0.0, 1.0]])  # every vertex seen along its own normal
for spec in ("lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.04,kd=0.4"):
    slices = prtcl.brdf(spec, straight_up, levels=LEVELS)  # all that a material edit recomputes
    radiance = prtcl.shade(reduced, slices)

    # The same sum over directions in float64, from the same visibility and light.
    seen = np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little")[:, None, : 4**LEVELS]
    f = reference.slice_samples(prtcl.Material.parse(spec).reference(), straight_up[0], LEVELS, supersample=2)
    exact = np.einsum("ncs,sc->nc", light * seen, f) * 2 * np.pi / 4**LEVELS
    error = np.sqrt(((radiance - exact) ** 2).mean()) / exact.mean()
    print(
        f"{spec}: mean radiance {radiance.mean():.4f}, float64 {exact.mean():.4f}, relative RMSE {error:.1e}"
    )
    assert error < 2e-3  # two grids of subsamples differ by this much; the arithmetic itself by 1e-6

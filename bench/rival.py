"""Mitsuba 3 as rival and independent check: the same mesh, environment, material and camera, path traced.

Needs the `bench` extra and LLVM 17 or later (Debian: libllvm19; DRJIT_LIBLLVM_PATH names the library).
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import face_normals

WAVEFRONT = 1 << 25
"""Most samples of vertices in flight: what they keep between passes fits in 2 GiB."""
NEAR = 1e-3
"""How far before its vertex a ray starts, of the mesh's size."""
INSIDE = 1e-3
"""How far beside its vertex a ray arrives, of the way to the middle of a face."""


def _bsdf(material: Material) -> dict[str, object]:
    rgb = {"type": "rgb"}
    if material.kind == "lambert":
        inner: dict[str, object] = {
            "type": "diffuse",
            "reflectance": {**rgb, "value": list(material.numbers["albedo"])},
        }
    elif material.kind == "ggx-conductor":
        inner = {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": material.numbers["alpha"],
            "eta": {**rgb, "value": list(material.numbers["eta"])},
            "k": {**rgb, "value": list(material.numbers["k"])},
        }
    else:
        raise ValueError(f"{material.spec}: Mitsuba has no equal of this material")
    return {"type": "twosided", "bsdf": inner}


def _rows_on_edges(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """2 h + 1 rows at v = i / 2h: Mitsuba puts the first and last row on the poles, prtcl half a texel inside."""
    height = len(image)
    y = np.clip(np.arange(2 * height + 1) / 2 - 0.5, 0, height - 1)
    low = np.floor(y).astype(int)
    weight = (y - low)[:, None, None].astype(np.float32)
    return image[low] * (1 - weight) + image[np.minimum(low + 1, height - 1)] * weight


class Rival:
    """A Mitsuba scene: `render(spp)` gives (h, w, 4) premultiplied RGBA, `radiance(rays(…), spp)` that of vertices.

    What is run a second time at the same spp finds its kernels compiled.
    """

    def __init__(self, mesh: Mesh, environment: Environment, material: Material, camera: Camera) -> None:
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        self._mi, self._mesh = mi, mesh
        if mesh.normals is None:
            corners = mesh.vertices[mesh.faces].reshape(-1, 3)  # unshared vertices: Mitsuba then shades flat
            faces, normals = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3), None
        else:
            corners, faces, normals = mesh.vertices, mesh.faces.astype(np.uint32), mesh.normals
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(_bsdf(material))
        if normals is None:
            properties["face_normals"] = True
        shape = mi.Mesh(
            "mesh", len(corners), len(faces), has_vertex_normals=normals is not None, props=properties
        )
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = corners.astype(np.float32).ravel()
        parameters["faces"] = faces.ravel()
        if normals is not None:
            parameters["vertex_normals"] = normals.astype(np.float32).ravel()
        parameters.update()
        transform = mi.ScalarTransform4f().rotate([0, 1, 0], environment.rotate)
        self._scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct", "hide_emitters": True},
                "emitter": {
                    "type": "envmap",
                    "bitmap": mi.Bitmap(np.ascontiguousarray(_rows_on_edges(environment.image))),
                    "to_world": transform,
                },
                "sensor": {
                    "type": "perspective",
                    "fov": camera.fov,
                    "fov_axis": "x",
                    "to_world": mi.ScalarTransform4f().look_at(
                        origin=list(camera.eye), target=list(camera.target), up=list(camera.up)
                    ),
                    "film": {
                        "type": "hdrfilm",
                        "width": camera.size[0],
                        "height": camera.size[1],
                        "rfilter": {"type": "box"},
                        "pixel_format": "rgba",
                        "component_format": "float32",
                    },
                    "sampler": {"type": "multijitter"},
                },
                "shape": shape,
            }
        )

    def render(self, spp: int, seed: int = 0) -> npt.NDArray[np.float32]:
        return np.array(self._mi.render(self._scene, spp=spp, seed=seed), dtype=np.float32)

    def rays(self, vertices: npt.NDArray[np.integer], eyes: npt.ArrayLike) -> Any:
        """Rays from eyes (n, 3) to vertices (n,): their last bit only, that no nearer surface is in the way.

        A ray that aims at a vertex itself may slip through between its faces, so it aims a little inside one of them.
        """
        mesh, mi = self._mesh, self._mi
        at = mesh.vertices[vertices]
        at = at + INSIDE * (mesh.vertices[mesh.faces[self._flattest[vertices]]].mean(axis=1) - at)
        along = at - np.asarray(eyes, dtype=np.float64)
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        near = NEAR * mesh.scale
        rays = mi.RayDifferential3f(
            o=mi.Point3f((at - near * along).T.astype(np.float32)),
            d=mi.Vector3f(along.T.astype(np.float32)),
            time=0.0,
            wavelengths=[],
        )
        rays.maxt = mi.Float(2 * near)
        return rays

    @cached_property
    def _flattest(self) -> npt.NDArray[np.int64]:
        """(n,) of the faces around each vertex the one whose normal is nearest the vertex's; 0 where there is none."""
        mesh = self._mesh
        assert mesh.normals is not None
        corners = mesh.faces.ravel()
        normals = np.repeat(face_normals(mesh, mesh.faces), 3, axis=0)
        order = np.argsort((normals * mesh.normals[corners]).sum(axis=1))
        found = np.zeros(len(mesh.vertices), dtype=np.int64)
        found[corners[order]] = order // 3  # of several values for one place the last one stays
        return found

    def radiance(self, rays: Any, spp: int, seed: int = 0) -> npt.NDArray[np.float32]:
        """Radiance (n, 4) of the vertices of `rays` towards their eyes, as `render` estimates that of pixels.

        The fourth number is 1 where the ray met the surface.

        Parameters
        ----------
        spp : a power of four
        """
        import drjit as dr

        mi, count = self._mi, dr.width(rays)
        together = spp
        while count * together > WAVEFRONT and together > 1:
            together //= 2
        sampler = mi.load_dict({"type": "multijitter", "sample_count": spp})
        sampler.set_samples_per_wavefront(together)
        sampler.seed(dr.opaque(mi.UInt32, seed), count * together)
        which = dr.arange(mi.UInt32, count * together) // together
        # One lane a sample, a point's samples side by side; every pass is one kernel.
        each = dr.gather(mi.RayDifferential3f, rays, which)
        total = dr.zeros(mi.Vector4f, count)
        for _ in range(spp // together):
            colour, met, _ = self._scene.integrator().sample(self._scene, sampler, each)
            for channel, value in zip(total, (*colour, mi.Float(met)), strict=True):
                dr.scatter_add(channel, value, which)
            sampler.advance()
            sampler.schedule_state()
            dr.eval(total)
        dr.sync_thread()
        return np.array(total, dtype=np.float32).T / np.float32(spp)

"""Mitsuba 3 as rival and independent check: the same mesh, environment, material and camera, path traced.

Needs the `bench` extra and LLVM 17 or later (Debian: libllvm19; DRJIT_LIBLLVM_PATH names the library).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh


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
    """A Mitsuba scene with warm kernels; `render(spp)` gives (h, w, 4) premultiplied RGBA."""

    def __init__(self, mesh: Mesh, environment: Environment, material: Material, camera: Camera) -> None:
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        self._mi = mi
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

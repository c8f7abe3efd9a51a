"""What cameras see of a mesh, kept while they stand still, and pictures made of its vertices' radiance."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import face_normals, shoot

KEPT = 4
"""Cameras whose hits are kept, so that an edit under a still camera shoots no ray."""

Array = npt.NDArray[np.float32]


@dataclass(eq=False)
class Seen:
    """What a camera's rays hit.

    Attributes
    ----------
    size : of the image, width and height
    samples : for every sub-pixel sample its pixels, the faces they see, and the weights of those faces' corners
    vertices : that are corners of a face seen
    back : (vertices,) whether all faces by which one is seen show their back
    colours : the mesh's own at every sample's hits, once a material asked for them
    """

    size: tuple[int, int]
    samples: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.int32], Array]]
    vertices: npt.NDArray[np.int32]
    back: npt.NDArray[np.bool_]
    colours: list[Array] | None = None


class Viewfinder:
    """One mesh, with vertex normals, seen by the last few cameras.

    Parameters
    ----------
    two_sided : tell faces seen from behind; a face's front is where its vertices' normals point, whatever its winding
    """

    def __init__(self, mesh: Mesh, tracer: Tracer, two_sided: bool = True) -> None:
        self.mesh, self.tracer = mesh, tracer
        assert mesh.normals is not None
        self._fronts: Array | None = None
        if two_sided:
            fronts = face_normals(mesh, mesh.faces)
            along = np.einsum("fx,fx->f", fronts, mesh.normals[mesh.faces].sum(axis=1))
            self._fronts = (fronts * np.where(along < 0.0, -1.0, 1.0)[:, None]).astype(np.float32)
        self._kept: OrderedDict[tuple[Camera, int], Seen] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    def known(self, camera: Camera, samples: int) -> Seen | None:
        """What a camera sees at N × N sub-pixel points a pixel, if it was shot not long ago."""
        key = (camera, samples)
        if key in self._kept:
            self._kept.move_to_end(key)
        return self._kept.get(key)

    def shoot(self, camera: Camera, samples: int) -> Seen:
        """What a camera sees."""
        width, height = camera.size
        pixels = np.arange(width * height)
        front, back = np.zeros((2, len(self.mesh.vertices)), dtype=np.bool_)
        found = []
        for sub in range(samples**2):
            hits = shoot(self.tracer, camera, pixels, np.full_like(pixels, sub))
            behind = np.zeros(len(hits.face), dtype=np.bool_)
            if self._fronts is not None:
                behind = np.einsum("kx,kx->k", self._fronts[hits.face], hits.towards) < 0.0
            for side, faces in ((front, hits.face[~behind]), (back, hits.face[behind])):
                side[self.mesh.faces[faces].ravel()] = True
            found.append((hits.ray, hits.face, hits.barycentric.astype(np.float32)))
        vertices = np.flatnonzero(front | back).astype(np.int32)
        seen = Seen(camera.size, found, vertices, ~front[vertices])
        self._kept[camera, samples] = seen
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return seen

    def develop(self, seen: Seen, full: Array, left: Array | None) -> Array:
        """Vertex radiance interpolated over the faces that each sub-pixel point hit, averaged: (h, w, 4).

        The mesh's colour is applied at the hits: a texture is as sharp as the picture, not as the mesh.

        Parameters
        ----------
        full : (k, 3) radiance of `seen.vertices` under a white mesh
        left : (k, 3) what of it the mesh's colour does not multiply; None where it multiplies nothing
        """
        width, height = seen.size
        image = np.zeros((width * height, 4), dtype=np.float32)
        values = np.zeros((len(self.mesh.vertices), 3 if left is None else 6), dtype=np.float32)
        values[seen.vertices, :3] = full
        if left is not None:
            values[seen.vertices, 3:] = left
            if seen.colours is None:
                seen.colours = [self.mesh.base_colour(face, weights) for _, face, weights in seen.samples]
        for number, (pixels, face, weights) in enumerate(seen.samples):
            mixed = np.einsum("kc,kcx->kx", weights, values[self.mesh.faces[face]])
            if left is not None and seen.colours is not None:
                mixed = mixed[:, 3:] + seen.colours[number] * (mixed[:, :3] - mixed[:, 3:])
            image[pixels, :3] += mixed
            image[pixels, 3] += 1.0
        return (image / np.float32(len(seen.samples))).reshape(height, width, 4)

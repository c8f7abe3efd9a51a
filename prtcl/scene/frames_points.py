"""What one camera sees of a mesh at a fixed number of points a pixel, and the image that their radiance makes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from prtcl.compute import host
from prtcl.errors import InputError
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import check_eye, pixel_points, seeing_pixels, shoot, vertex_points, with_eye
from prtcl.transport.pipeline import Points

BATCH = 1 << 17
"""Rays shot at a time: bounds the memory of what is only needed in between."""

Array = npt.NDArray[np.float64]


@dataclass(eq=False)
class Sight:
    """Hits of a camera's rays, and the points at which radiance is computed for them.

    Attributes
    ----------
    size : of the image, width and height
    each : rays a pixel
    pixel : (hits,) the flat index of the pixel that each hit belongs to
    face : (hits,) int32; barycentric : (hits, 3) float32 weights of its corners
    points : one a hit, or one for each of `vertices`
    vertices : (k,) ascending, those that are corners of a face seen; None where points are the hits
    """

    size: tuple[int, int]
    each: int
    pixel: npt.NDArray[np.int64]
    face: npt.NDArray[np.int32]
    barycentric: npt.NDArray[np.float32]
    points: Points
    vertices: npt.NDArray[np.int64] | None
    _colour: npt.NDArray[np.float32] | None = field(default=None, repr=False)

    def colour(self, mesh: Mesh) -> npt.NDArray[np.float32]:
        """(points, 3) the mesh's own colour, once a material asked for it."""
        if self._colour is None:
            if self.vertices is None:
                self._colour = mesh.base_colour(self.face, self.barycentric)
            else:
                self._colour = mesh.vertex_colour(self.vertices)
        return self._colour

    def develop(self, mesh: Mesh, radiance: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """The image (h, w, 4): the box average of the points of each pixel, premultiplied by coverage.

        Parameters
        ----------
        radiance : (points, 3)
        """
        if self.vertices is not None:
            corners = np.searchsorted(self.vertices, mesh.faces[self.face])
            radiance = np.einsum("nc,ncx->nx", self.barycentric, radiance[corners])
        width, height = self.size
        count = width * height
        image = np.empty((count, 4))
        for channel in range(3):
            image[:, channel] = np.bincount(self.pixel, radiance[:, channel], count)
        image[:, 3] = np.bincount(self.pixel, minlength=count)
        return (image / self.each).reshape(height, width, 4).astype(np.float32)


def see(
    mesh: Mesh,
    tracer: Tracer,
    camera: Camera,
    samples: int,
    vertex: bool,
    two_sided: bool,
    fixed: bool = False,
    pixels: npt.NDArray[np.int64] | None = None,
    pixel_bytes: float = 0.0,
) -> Sight:
    """Shoot N × N rays through every pixel.

    Parameters
    ----------
    samples : N
    vertex : compute radiance at the vertices, in frames turned to the eye
    two_sided : of pixels' points, as `pixel_points` takes it
    fixed : vertices keep the frames that a bake was traced in
    pixels : (k,) flat indices of those to look through, from an eye that was checked; the image is then one row of
        them. None looks through all, and raises what `check_view` does
    pixel_bytes : as `check_view` takes it
    """
    each, size = samples * samples, camera.size
    if pixels is None:
        check_view(tracer, mesh, pixel_bytes, camera)
        pixels = np.arange(size[0] * size[1])
    else:
        size = len(pixels), 1
    step = max(1, BATCH // each)
    pixel, face, barycentric, points = [], [], [], []
    for start in range(0, len(pixels), step):
        some = pixels[start : start + step]
        sub = np.tile(np.arange(each), len(some))
        hits = shoot(tracer, camera, np.repeat(some, each), sub)
        pixel.append(start + hits.ray // each)
        face.append(hits.face)
        barycentric.append(hits.barycentric.astype(np.float32))
        if not vertex:
            points.append(pixel_points(mesh, tracer, hits, sub[hits.ray], two_sided))
    faces = np.concatenate(face)
    vertices = np.unique(mesh.faces[faces]).astype(np.int64) if vertex else None
    if vertices is None:
        whole = _joined(points)
    elif fixed:
        whole = with_eye(vertex_points(mesh, tracer, None, vertices), mesh.vertices[vertices], camera.eye)
    else:
        whole = vertex_points(mesh, tracer, camera.eye, vertices)
    return Sight(size, each, np.concatenate(pixel), faces, np.concatenate(barycentric), whole, vertices)


def check_view(tracer: Tracer, mesh: Mesh, pixel_bytes: float, camera: Camera) -> None:
    """Refuse a view that shows nothing, or takes more of the host's memory than there is.

    Parameters
    ----------
    pixel_bytes : for each pixel that sees the mesh; 0 checks no memory

    Raises
    ------
    InputError
        If the camera sees nothing of the mesh, stands inside it, or needs more memory: how much.
    """
    check_eye(tracer, mesh, camera)
    if host.holds(pixel_bytes * camera.size[0] * camera.size[1]):
        return
    pixels = len(seeing_pixels(tracer, camera))
    if not host.holds(pixel_bytes * pixels):
        raise InputError(
            f"{pixels} pixels see the mesh, and what is kept of them takes about {pixel_bytes * pixels / 2**30:.3g} "
            f"GiB of this machine's {(host.memory() or 0) / 2**30:.3g}\nask for a smaller --size or fewer --samples"
        )


def _joined(parts: list[Points]) -> Points:
    """Points one after another; the parts are given up."""
    names = ("origins", "frames", "views", "material", "grid")
    fields = {name: [getattr(part, name) for part in parts] for name in names}
    parts.clear()  # so that no field is there twice but the one that is joined
    return Points(**{name: np.concatenate(fields.pop(name)) for name in names}, polar=True)

"""All sub-pixel points of a view at once, for engines that keep a view: `prtcl.transport.fixed_view`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.frames_points import see
from prtcl.scene.mesh import Mesh
from prtcl.transport.pipeline import Points

SIDE = 8
"""Points along a pixel's side: V ⊕ f_v traces no more rays for more points, and glints need them
(bench/relight_choices.py)."""


@dataclass(frozen=True, eq=False)
class ViewPoints:
    """What a camera's pixels see.

    Attributes
    ----------
    points : of all pixels, those of each together, pixels in ascending order
    pixel : (points,) int64, flat index of each one's pixel, row by row
    seen : (pixels,) int64, the pixels that see the mesh, ascending
    coverage : (pixels,) float64, the share of their points that do
    size : width and height
    """

    points: Points
    pixel: npt.NDArray[np.int64]
    seen: npt.NDArray[np.int64]
    coverage: npt.NDArray[np.float64]
    size: tuple[int, int]

    @classmethod
    def of(
        cls, mesh: Mesh, tracer: Tracer, camera: Camera, side: int = SIDE, *, two_sided: bool = True,
        one_material: bool = False, pixels: npt.NDArray[np.int64] | None = None,
        pixel_bytes: float = 0.0,
    ) -> ViewPoints:  # fmt: skip
        """Shoot side × side camera rays through every pixel.

        Parameters
        ----------
        one_material : all points are of material 0, whatever the mesh's parts
        pixels, pixel_bytes : as `see` takes them, and refuses views
        """
        sight = see(mesh, tracer, camera, side, False, two_sided, pixels=pixels, pixel_bytes=pixel_bytes)
        points = sight.points
        if one_material:
            points = replace(points, material=np.zeros_like(points.material))
        seen, hits_of = np.unique(sight.pixel, return_counts=True)
        return cls(points, sight.pixel, seen, hits_of / sight.each, sight.size)

    def without_points(self) -> ViewPoints:
        """What `image` needs of it: the points are let go of."""
        none = np.zeros(0, dtype=np.int64)  # a slice would hold them
        return replace(self, points=self.points[none], pixel=self.pixel[none])

    def image(self, radiance: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """(h, w, 4) linear RGBA, colour premultiplied by coverage, of the radiance (pixels, 3) of what was seen."""
        out = np.zeros((self.size[0] * self.size[1], 4), dtype=np.float32)
        out[self.seen, :3] = radiance * self.coverage[:, None]
        out[self.seen, 3] = self.coverage
        return out.reshape(self.size[1], self.size[0], 4)

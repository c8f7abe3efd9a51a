"""The engine for many lights: V ⊕ f_v of each view's pixels, multiplied with blocks of lights at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import islice

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import sphere
from prtcl.factors.environment import Environment
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.frames_engine import RADIANCE, Image, Wanted
from prtcl.scene.frames_looks import Looks
from prtcl.scene.kept_visibility import KeptVisibility
from prtcl.scene.mesh import Mesh
from prtcl.scene.view_points import SIDE, ViewPoints
from prtcl.transport.fixed_view import Bits, FixedView, Keeper, rays_for

NOT_TAKEN = ("levels", "rays", "keep", "views", "method", "visibility")
"""Settings of L ⊕ V that V ⊕ f_v has no use for."""
POINT_BYTES = 200
"""Host bytes of a sub-pixel point, at most, while all are put in order."""
TOGETHER = 128
"""Lights of one product, at most: transport is made anew for each block."""


class ViewEngine:
    """Pixels of a view and their visibility are traced once; each block of lights costs their transport once.

    Costs a block V ⊕ f_v at every pixel and material, and a light one row of a matrix product and its own hard rays: it
    pays from some ten lights on (`prtcl.scene.engine_choice`).

    Parameters
    ----------
    looks : what the mesh is seen in; none may be tinted by the mesh's own colours
    samples : N × N sub-pixel points a pixel; None takes `SIDE`
    two_sided : as for `Scene`
    hard : as in `Settings`
    tracer : of the mesh; None makes it
    kept : where the visibility of whole views is kept; None traces

    Raises
    ------
    InputError
        If a material has the mesh's colour.
    """

    def __init__(
        self, mesh: Mesh, looks: Looks, device: Device, *, samples: int | None = None, two_sided: bool = True,
        hard: str = "auto", tracer: Tracer | None = None, kept: KeptVisibility | None = None,
    ) -> None:  # fmt: skip
        if not serves(looks):
            raise InputError("factorization: view does not take colours of the mesh; choose light")
        self.mesh, self.looks, self._device = mesh, looks, device
        self.side, self.two_sided, self.hard = SIDE if samples is None else samples, two_sided, hard
        with device.profile.host("build_bvh"):
            self.tracer = tracer or Tracer(mesh.vertices, mesh.faces)
        # Of all looks, whichever are wanted: an image does not depend on the others.
        self._rays, self._kept = rays_for(looks.materials), kept
        self.pixel_bytes = self.side**2 * POINT_BYTES + sphere.n_cells(self._rays) / 8
        self._worn = [[looks.materials[i] for i in own] for own in looks.full]
        self._seen: tuple[ViewPoints, FixedView | None] | None = None

    @property
    def device(self) -> Device:
        """Where kernels run."""
        return self._device

    def ahead(self, environment: Environment) -> None:
        """Nothing: lights are taken apart block by block."""

    def prepare(
        self, camera: Camera, pixels: npt.NDArray[np.int64] | None = None,
        traced: npt.NDArray[np.uint32] | None = None,
    ) -> npt.NDArray[np.uint32]:  # fmt: skip
        """Shoot the camera's rays, and trace what each pixel sees: `FixedView.bits`."""
        self._seen = None
        with self.device.profile.host("camera_rays"):
            points = ViewPoints.of(
                self.mesh, self.tracer, camera, self.side, two_sided=self.two_sided, pixels=pixels,
                pixel_bytes=self.pixel_bytes,
            )  # fmt: skip
        if not len(points.points):  # the mesh lies between the few points of all pixels
            self._seen = points, None
            return np.zeros((0, 0), np.uint32)
        keeper: Keeper | None = None
        if traced is not None:
            keeper = partial(_given, traced)
        elif self._kept is not None and pixels is None:
            keeper = partial(self._kept.of_pixels, camera, self._rays)
        view = FixedView(
            self.device, self.tracer, points.points, points.pixel, rays=self._rays, keeper=keeper
        )
        # The view has points of its own, in another order.
        self._seen = points.without_points(), view
        return view.bits

    def images(self, lights: Iterable[Wanted]) -> Iterator[Image]:
        """As `Engine.images`; a block of lights at a time."""
        assert self._seen is not None, "no view was prepared"
        points, view = self._seen
        if view is None:
            for _, wanted in lights:
                yield from (points.image(np.zeros((0, 3))) for _ in wanted)
            return
        waiting = iter(lights)
        while block := list(islice(waiting, together(len(view), len(self._worn)))):
            looks = sorted({look for _, wanted in block for look in wanted})
            radiance = view.radiance(
                [environment for environment, _ in block],
                [self._worn[look] for look in looks],
                hard=self.hard,
            )
            for number, (_, wanted) in enumerate(block):
                for look in wanted:
                    yield points.image(radiance[looks.index(look), number])


def together(pixels: int, looks: int) -> int:
    """How many lights one transport of so many pixels and looks serves, for their radiance has to fit the host."""
    return max(1, min(TOGETHER, RADIANCE // max(1, 12 * pixels * looks)))


def _given(bits: Bits, *_: object) -> Bits:
    """The keeper of bits that another process traced."""
    return bits


def serves(looks: Looks) -> bool:
    """Whether the engine can make some looks."""
    return not any(own.any() for own in looks.tinted)

"""Several materials under one light: L ⊕ V collapsed once, then an inner product for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from prtcl.compute.chunks import chunk_size, chunks
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.transport import collapse, shade
from prtcl.transport.pipeline import HARD_CHUNK, Pipeline, Points
from prtcl.transport.settings import Settings, choose


class Looks:
    """One light and several looks, each a list of materials that `Points.material` indexes.

    Parameters
    ----------
    device : where the kernels run
    environment : the light
    looks : one or more, all of one length
    settings : resolutions; None takes those of the sharpest material of all
    polar, budget : as for `Pipeline`

    Notes
    -----
    Rays and the collapse, which cost most, are done once for each point whatever the number of looks; so all looks
    share one `Settings`.

    Raises
    ------
    InputError
        If there are no looks, or they have different lengths.
    """

    def __init__(
        self, device: Device, environment: Environment, looks: Sequence[Sequence[Material]],
        settings: Settings | None = None, *, polar: bool = True, budget: int | None = None,
    ) -> None:  # fmt: skip
        lengths = {len(look) for look in looks}
        if len(lengths) != 1 or 0 in lengths:
            raise InputError(
                f"looks: expected one or more lists of as many materials each, got lengths {lengths}"
            )
        every = [material for look in looks for material in look]
        sharpest = min(every, key=lambda material: material.roughness)
        self.count, self.each = len(looks), lengths.pop()
        self.pipeline = Pipeline(
            device, environment, every, settings or choose(sharpest)[0], polar=polar, budget=budget
        )

    def radiance(
        self, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None = None
    ) -> npt.NDArray[np.floating]:
        """Outgoing radiance of every look at every point: (looks, n, 3), linear RGB.

        Parameters
        ----------
        bits : visibility as `Pipeline.visibility` returns it; None traces it
        """
        soft = self.soft(tracer, points, bits)
        return np.asarray(soft + self.hard(tracer, points))

    def soft(
        self, tracer: Tracer, points: Points, bits: npt.NDArray[np.uint32] | None = None
    ) -> npt.NDArray[np.floating]:
        """What `Pipeline.soft` gives for each look, from one collapse: (looks, n, 3)."""
        own = self.pipeline
        device, stages = own.device, own.bytes_per_point()
        size = chunk_size(device, sum(stages.values()), max(stages.values()), own.budget)
        out = np.empty((self.count, len(points), 3), dtype=device.dtype)
        nodes, weight = own.table.locate(points.views)
        keys = [own.slices.keys(points.material + look * self.each, nodes) for look in range(self.count)]
        for part in chunks(len(points), size):
            some = points[part]
            seen = own.visibility(tracer, some) if bits is None else bits[part]
            reduced = collapse.reduced_coefficients(
                device, own.light, seen, some.frames, own.settings, own.channels, some.grid
            )
            for look in range(self.count):
                # The store may hold too few slices for all points at once; theirs then go in parts, out of order.
                for inner in own.slices.parts(keys[look][part], len(some)):
                    slices, index = own.slices.take(keys[look][part][inner])
                    whole = len(inner) == len(some) and bool((np.diff(inner) == 1).all())
                    rows = reduced if whole else device.array(reduced.get()[inner])
                    got = shade.soft_radiance(
                        device, rows, slices, index, weight[part][inner], own.settings.levels
                    )
                    out[look, part][inner] = got.get()[:, :3] * own.unit
        return out

    def hard(self, tracer: Tracer, points: Points) -> npt.NDArray[np.floating]:
        """What `Pipeline.hard` gives for each look, its rays traced once: (looks, n, 3)."""
        own = self.pipeline
        out = np.zeros((self.count, len(points), 3), dtype=own.device.dtype)
        if not len(own.light.hard):
            return out
        for part in chunks(len(points), HARD_CHUNK):
            some = points[part]
            with own.device.profile.host("hard_light_rays"):
                seen = tracer.light_visibility(some.origins, some.frames[:, 2], own.light.hard[:, :3])
            for look in range(self.count):
                got = own.device.array(np.zeros((len(some), 4)))
                this = replace(some, material=some.material + np.int32(look * self.each))
                shade.add_hard_radiance(
                    own.device, own.materials, own.light, seen, this.material, this.frames, this.views, got
                )
                out[look, part] = got.get()[:, :3] * own.unit
        return out

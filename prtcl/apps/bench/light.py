"""Stages that begin with the scene: rays, the environment in the points' frames, and that times visibility."""

from __future__ import annotations

from typing import Any

import numpy as np

from prtcl import quadtree
from prtcl.apps.bench import costs, oracle, world
from prtcl.apps.bench.costs import Size
from prtcl.apps.bench.oracle import FIRST, Array
from prtcl.apps.bench.registry import Job, stage
from prtcl.compute.device import Device
from prtcl.factors import environment
from prtcl.factors.environment import Light
from prtcl.transport import collapse
from prtcl.transport.settings import Settings
from prtcl.wavelet import pyramid

NEAR = 1e-4
"""Of what is looked up in the cube: a direction between two faces is rounded to either."""


@stage("visibility", "visibility, by embree", rows=0.1, clock="wall", host=True, grey=True)
def visibility(device: Device, points: int, levels: int, channels: int) -> Job:
    """Rays where neighbours disagree, as bits; some bits of a thousand may differ from every ray's."""
    some, tracer = world.points(points), world.tracer()

    def check(result: Any) -> float:
        wanted = oracle.bits(tracer, some[:FIRST], levels)
        return float((world.unpacked(result[:FIRST], levels) != wanted).mean())

    return Job(
        lambda: tracer.visibility(some.origins, some.frames, levels, some.grid),
        *costs.visibility(Size(points, levels, 1)),
        check,
        tolerance=0.02,
    )


@stage("light", "light in the points' frames", rows=1.1)
def light(device: Device, points: int, levels: int, channels: int) -> Job:
    """The environment gathered on every hemisphere."""
    size, own = Size(points, levels, channels), world.light(levels, channels)
    frames = world.points(points).frames
    out, held = device.empty((points, channels, size.samples)), device.array(frames)

    def check(result: Any) -> float:
        return oracle.error(result, oracle.gathered(own, frames[:FIRST], levels)[:, :channels])

    def call() -> Any:
        return environment.gather(device, own, held, channels=channels, out=out)

    return Job(call, *costs.light(size), check, tolerance=NEAR)


class Lit:
    """What light times visibility takes, in all of its forms."""

    def __init__(self, points: int, levels: int, channels: int) -> None:
        self.size, self.light = Size(points, levels, channels), world.light(levels, channels)
        self.bits, self.frames = world.bits(points, levels), world.points(points).frames
        self.settings = Settings(levels=levels, rays=levels, keep=levels)
        self.seen = world.seen(self.bits)
        self.arguments = (self.light, self.bits, self.frames, self.settings, channels)

    def expected(self) -> Array:
        """Samples of the first points' product: (k, channels, 4**levels)."""
        return lit(self.light, self.bits[:FIRST], self.frames[:FIRST], self.size)


def lit(light: Light, bits: Any, frames: Any, size: Size) -> Array:
    """L V of some points in float64: (n, channels, 4**levels)."""
    seen = world.unpacked(bits, size.levels)[:, None]
    return oracle.gathered(light, frames, size.levels)[:, : size.channels] * seen


@stage("light_times_visibility", "light x visibility, samples", rows=1.2)
def light_times_visibility(device: Device, points: int, levels: int, channels: int) -> Job:
    """L V straight from the environment."""
    own = Lit(points, levels, channels)
    return Job(
        lambda: collapse.product_samples(device, *own.arguments),
        *costs.light_times_visibility(own.size, own.seen),
        lambda result: oracle.error(result, own.expected()),
        tolerance=NEAR,
    )


@stage("light_times_visibility_reduced", "light x visibility, reduced", rows=2.2)
def light_times_visibility_reduced(device: Device, points: int, levels: int, channels: int) -> Job:
    """L ⊕ V straight from the environment."""
    own = Lit(points, levels, channels)
    return Job(
        lambda: collapse.reduced_coefficients(device, *own.arguments),
        *costs.light_times_visibility_reduced(own.size, own.seen),
        lambda result: oracle.error(result, oracle.haar(own.expected())),
        tolerance=NEAR,
    )


@stage("light_times_visibility_packed", "light x visibility, packed sums", rows=3.4)
def light_times_visibility_packed(device: Device, points: int, levels: int, channels: int) -> Job:
    """Packed parent sums of L ⊕ V straight from the environment."""
    own = Lit(points, levels, channels)
    rows = device.array(np.arange(points), np.int32)
    sums = device.empty((points, quadtree.n_squares(levels + 1)), np.uint32)
    scale = pyramid.scale_for(float(own.light.cube[..., :3].max()))

    def call() -> Any:
        collapse.packed_sums(device, *own.arguments, rows, sums, scale)
        return sums

    def check(result: Any) -> float:
        got = pyramid.unpack(result[:FIRST].get(), scale).transpose(0, 2, 1)
        return oracle.error(got, np.broadcast_to(oracle.means(own.expected()), got.shape))

    return Job(
        call,
        *costs.light_times_visibility_packed(own.size, own.seen),
        check,
        tolerance=pyramid.ROUNDING,
    )

"""Stages that end in radiance: slices of the BRDF, inner products with them and over a cut, and the whole job."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.apps.bench import costs, oracle, world
from prtcl.apps.bench.costs import Size
from prtcl.apps.bench.light import NEAR, lit
from prtcl.apps.bench.oracle import FIRST
from prtcl.apps.bench.registry import Job, stage
from prtcl.compute.device import Device
from prtcl.factors.slices import Materials, subsamples
from prtcl.transport import collapse, shade
from prtcl.transport import cut as cuts
from prtcl.transport.leaves import Leaves, Squares
from prtcl.transport.pipeline import Pipeline
from prtcl.transport.settings import Settings
from prtcl.wavelet import haar, pyramid

LEFT_OUT = 0.005
"""What a cut may leave out by its own sum: fitted to a mesh, one of 1 % leaves out about that (`pilots.GUESS`)."""


@stage("slices", "slices f_v", unit="slices", rows=2.2, most=256)
def slices(device: Device, points: int, levels: int, channels: int) -> Job:
    """f_v of a rough conductor at view angles from the zenith to near the horizon."""
    size, material = Size(points, levels, channels), world.material(channels)
    materials = Materials(device, [material])
    theta = np.linspace(0.0, 1.5, points)
    views = np.stack([np.sin(theta), np.zeros(points), np.cos(theta)], axis=1)
    sub = subsamples(material, levels)

    def check(result: Any) -> float:
        wanted = oracle.slice_samples(material, views[:FIRST], levels, sub)[:, :channels]
        return oracle.error(result, oracle.haar(wanted))

    return Job(lambda: materials.slices_of(0, views, levels), *costs.slices(size, sub), check, tolerance=NEAR)


def looked_up(count: int, levels: int) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]:
    """Slices (count, 2) and their weights for the ball's points, sorted by slice."""
    index, weight = world.table(levels).locate(world.points(count).views)
    order = np.argsort(index[:, 0], kind="stable")
    return index[order], weight[order]


@stage("inner_product", "inner product with slices", rows=1.2)
def inner_product(device: Device, points: int, levels: int, channels: int) -> Job:
    """Radiance from reduced coefficients, two slices a point."""
    size = Size(points, levels, channels)
    index, weight = looked_up(points, levels)
    made = table_of_slices(levels, channels)
    rows, own = world.light_rows(device, size, transformed=True), device.array(made)
    where, weights = device.array(index, np.int32), device.array(weight)

    def call() -> Any:
        return shade.soft_radiance(device, rows, own, where, weights, levels)

    def check(result: Any) -> float:
        first = world.coefficients(levels, channels)[: min(points, FIRST)]
        wanted = oracle.inner_product(first, made[index[:FIRST]], weight[:FIRST], levels)
        return oracle.error(oracle.host(result)[:, :3], wanted)

    return Job(call, *costs.inner_product(size, len(np.unique(index))), check, tolerance=1e-4)


def table_of_slices(levels: int, channels: int) -> npt.NDArray[np.float32]:
    """Stand-ins for slices (views, channels, 4**levels): any numbers take as long."""
    rng = np.random.default_rng([9, levels, channels])
    shape = (world.table(levels).nodes, channels, quadtree.n_samples(levels))
    return rng.uniform(0.2, 1.0, shape).astype(np.float32)


@stage("cut", "inner product over a cut", rows=1.4)
def cut(device: Device, points: int, levels: int, channels: int) -> Job:
    """Radiance from packed parent sums, as an edit of a material takes it."""
    size, material = Size(points, levels, channels), world.material(channels)
    sums, scale, spread = _packed(device, size)
    own = cuts.build(cuts.energies(device, cuts.ends(material)[0], levels, spread), LEFT_OUT)
    squares, materials = Squares(levels), Materials(device, [material])
    leaves = Leaves(device, squares, [own])
    views = np.pad(world.points(points).views, ((0, 0), (0, 1)))
    turn, canonical, bins = _canonical(views[:, :3])
    chosen, kind = device.array(np.arange(points), np.int32), device.array(np.zeros(points), np.int32)
    seen, out = device.array(views), device.empty((points, 4))
    count = int(np.diff(own.starts)[bins].sum(dtype=np.int64))

    def call() -> Any:
        leaves.shade(materials, kind, sums, chosen, seen, out, 1.0 / scale)
        return out

    def check(result: Any) -> float:
        wanted = []
        means = pyramid.unpack(sums[:FIRST].get(), scale).astype(np.float64)
        for mean, t, view, own_bin in zip(means, turn, canonical, bins, strict=False):
            listed = own.leaves[own.starts[own_bin] : own.starts[own_bin + 1]]
            directions = squares.directions[listed].astype(np.float64)
            f = oracle.reference.brdf(material.reference(), directions[:, :3], view) * directions[:, 3:]
            wanted.append((f * mean[squares.turns[t, listed]]).sum(axis=0))
        return oracle.error(oracle.host(result)[:, :3], wanted)

    note = f"{count / points:.0f} leaves a point"
    return Job(call, *costs.cut(size, count), check, tolerance=1e-4, note=note)


def _packed(device: Device, size: Size) -> tuple[Any, float, npt.NDArray[np.float64]]:
    """Packed sums of the ball's points, their scale, and w_r of `prtcl.transport.cut`, all of some rows' product."""
    light, count = world.light(size.levels, size.channels), min(size.points, world.ROWS)
    settings = Settings(levels=size.levels, rays=size.levels, keep=size.levels)
    bits, frames = world.bits(count, size.levels), world.points(count).frames
    product = collapse.product_samples(device, light, bits, frames, settings, size.channels)
    coefficients = haar.forward(device, product).get().astype(np.float64)
    mean = coefficients[..., 0].mean() / 2.0**size.levels
    spread = [(coefficients[..., 4**r : 4 ** (r + 1)] ** 2).mean() / mean**2 for r in range(size.levels)]
    scale = pyramid.scale_for(float(light.cube[..., :3].max()))
    sums = device.empty((count, quadtree.n_squares(size.levels + 1)), np.uint32)
    pyramid.pack(device, product, device.array(np.arange(count), np.int32), sums, scale)
    return world.repeated(device, sums.get(), size.points), scale, np.maximum(spread, 0.05)


def _canonical(
    views: npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Each view's turn, the view turned to x ≥ y ≥ 0, and its bin, as kernels/cut.cl has them."""
    v = views.astype(np.float64)
    x, y = np.abs(v[:, 0]), np.abs(v[:, 1])
    turn = (v[:, 0] < 0) + 2 * (v[:, 1] < 0) + 4 * (y > x)
    x, y, half = np.maximum(x, y), np.minimum(x, y), cuts.SIDE // 2
    radius = np.sqrt(np.maximum(1 - v[:, 2], 0))
    row = np.clip((radius * half).astype(np.int64), 0, half - 1)
    column = np.clip((radius * np.arctan2(y, x) * (4 / np.pi) * half).astype(np.int64), 0, row)
    return turn, np.stack([x, y, v[:, 2]], axis=1), row * (row + 1) // 2 + column


@stage("job", "whole job, bits given", rows=0.1, clock="wall")
def job(device: Device, points: int, levels: int, channels: int) -> Job:
    """Radiance of points whose visibility is known, through `Pipeline`; slices are made in the warm-up."""
    size, material, table = Size(points, levels, channels), world.material(channels), world.table(levels)
    settings = Settings(levels=levels, rays=levels, keep=levels, views=table.nodes)
    pipeline = Pipeline(device, world.environment(channels), [material], settings)
    some, bits, tracer = world.points(points), world.bits(points, levels), world.tracer()
    index, weight = table.locate(some.views)

    def check(result: Any) -> float:
        product = lit(pipeline.light, bits[:FIRST], some.frames[:FIRST], size) * pipeline.unit
        sub, first = subsamples(material, levels), table.views[index[:FIRST]]
        f = oracle.slice_samples(material, first.reshape(-1, 3), levels, sub)[:, :channels]
        f = f.reshape(len(first), 2, channels, -1)
        return oracle.error(result, oracle.inner_product(product, f, weight[:FIRST], levels))

    cost = costs.job(size, world.seen(bits), len(np.unique(index)))
    return Job(lambda: pipeline.soft(tracer, some, bits), *cost, check, tolerance=NEAR)

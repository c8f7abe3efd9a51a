"""Stages on rows of coefficients: transforms, parent sums, products of light and visibility."""

from __future__ import annotations

from typing import Any

import numpy as np

from prtcl import quadtree
from prtcl.apps.bench import costs, oracle, world
from prtcl.apps.bench.costs import Size
from prtcl.apps.bench.oracle import FIRST
from prtcl.apps.bench.registry import Job, stage
from prtcl.compute.device import Device
from prtcl.wavelet import haar, masked, pyramid, triple


@stage("bits_to_coefficients", "bits to coefficients", rows=1.3, grey=True)
def bits_to_coefficients(device: Device, points: int, levels: int, channels: int) -> Job:
    """Visibility's Haar coefficients from its bits."""
    words = world.bits(points, levels)
    own = device.array(words, np.uint32)

    def check(result: Any) -> float:
        return oracle.error(result, oracle.haar(world.unpacked(words[:FIRST], levels))[:, None])

    return Job(
        lambda: masked.visibility_coefficients(device, own, levels),
        *costs.bits_to_coefficients(Size(points, levels, 1)),
        check,
    )


@stage("forward_haar", "forward Haar", rows=2.1)
def forward_haar(device: Device, points: int, levels: int, channels: int) -> Job:
    """Samples to coefficients."""
    size = Size(points, levels, channels)
    samples = world.light_rows(device, size)
    out = device.empty(samples.shape)

    def check(result: Any) -> float:
        return oracle.error(result, oracle.haar(world.samples(levels, channels)[: min(points, FIRST)]))

    return Job(lambda: haar.forward(device, samples, out=out), *costs.haar(size), check)


@stage("inverse_haar", "inverse Haar", rows=2.1)
def inverse_haar(device: Device, points: int, levels: int, channels: int) -> Job:
    """Coefficients to samples."""
    size = Size(points, levels, channels)
    rows = world.light_rows(device, size, transformed=True)
    out = device.empty(rows.shape)

    def check(result: Any) -> float:
        first = world.coefficients(levels, channels)[: min(points, FIRST)]
        return oracle.error(result, oracle.reference.ihaar(first))

    return Job(lambda: haar.inverse(device, rows, out=out), *costs.haar(size), check)


@stage("parent_sums", "parent sums", rows=1.4)
def parent_sums(device: Device, points: int, levels: int, channels: int) -> Job:
    """The mean over every square, from coefficients."""
    size = Size(points, levels, channels)
    rows = world.light_rows(device, size, transformed=True)

    def check(result: Any) -> float:
        first = world.coefficients(levels, channels)[: min(points, FIRST)]
        sums = result.reshape(points, channels, quadtree.n_squares(levels))
        return oracle.error(sums, oracle.reference.parent_sums(first))

    return Job(
        lambda: triple.parent_sums(device, rows, channels=channels, channels_b=1),
        *costs.parent_sums(size),
        check,
    )


@stage("packed_sums", "packed parent sums", rows=3.4)
def packed_sums(device: Device, points: int, levels: int, channels: int) -> Job:
    """The mean over every square, from samples, four bytes each."""
    size = Size(points, levels, channels)
    samples = world.light_rows(device, size)
    rows = device.array(np.arange(points), np.int32)
    sums = device.empty((points, quadtree.n_squares(levels + 1)), np.uint32)
    scale = pyramid.scale_for(float(world.samples(levels, channels).max()))

    def call() -> Any:
        pyramid.pack(device, samples, rows, sums, scale)
        return sums

    def check(result: Any) -> float:
        got = pyramid.unpack(result[:FIRST].get(), scale).transpose(0, 2, 1)
        wanted = oracle.means(world.samples(levels, channels)[: min(points, FIRST)])
        return oracle.error(got, np.broadcast_to(wanted, got.shape))

    return Job(call, *costs.pack(size), check, tolerance=pyramid.ROUNDING)


@stage("dense_reduction", "dense reduction, from coefficients", rows=4.2)
def dense_reduction(device: Device, points: int, levels: int, channels: int) -> Job:
    """L ⊕ V from the coefficients of both."""
    size = Size(points, levels, channels)
    words = world.bits(points, levels)
    rows = world.light_rows(device, size, transformed=True)
    seen = masked.visibility_coefficients(device, words, levels)

    return Job(
        lambda: triple.reduce(device, rows, seen),
        *costs.reduction(size),
        lambda result: oracle.error(result, _reduced(words, levels, channels)),
        tolerance=1e-4,
    )


@stage("product", "product in the pixel domain, from samples", rows=3.1)
def product(device: Device, points: int, levels: int, channels: int) -> Job:
    """L ⊕ V from samples of the light and bits."""
    size = Size(points, levels, channels)
    words = world.bits(points, levels)
    own, samples = device.array(words, np.uint32), world.light_rows(device, size)

    def check(result: Any) -> float:
        first = world.samples(levels, channels)[: min(points, FIRST)].astype(np.float64)
        return oracle.error(result, oracle.haar(first * world.unpacked(words[:FIRST], levels)[:, None]))

    return Job(
        lambda: masked.reduce_samples(device, samples, own, levels, levels), *costs.product(size), check
    )


@stage("bits_reduction", "dense reduction, by bits", rows=3.1)
def bits_reduction(device: Device, points: int, levels: int, channels: int) -> Job:
    """L ⊕ V from the light's coefficients and bits, every square of the tree."""
    size = Size(points, levels, channels)
    words = world.bits(points, levels)
    own, rows = device.array(words, np.uint32), world.light_rows(device, size, transformed=True)
    return Job(
        lambda: masked.reduce_coefficients(device, rows, own, levels, levels),
        *costs.bits_reduction(size),
        lambda result: oracle.error(result, _reduced(words, levels, channels)),
        tolerance=1e-4,
    )


@stage("sparse_reduction", "sparse reduction, by bits, in place", rows=3.1)
def sparse_reduction(device: Device, points: int, levels: int, channels: int) -> Job:
    """The same, at the cost of the squares in which visibility changes."""
    size = Size(points, levels, channels)
    words = world.bits(points, levels)
    own, rows = device.array(words, np.uint32), world.light_rows(device, size, transformed=True)
    work = device.empty(rows.shape)
    flat = rows.reshape(points, -1), work.reshape(points, -1)
    return Job(
        lambda: masked.reduce_in_place(device, work, own),
        *costs.sparse_reduction(size, words),
        lambda result: oracle.error(result, _reduced(words, levels, channels)),
        tolerance=1e-4,
        reset=lambda: device.paste(flat[0], flat[1], 0),
    )


def _reduced(words: Any, levels: int, channels: int) -> Any:
    """L ⊕ V of the first points in float64."""
    first = world.coefficients(levels, channels)[: min(len(words), FIRST)]
    other = oracle.haar(world.unpacked(words[:FIRST], levels))[:, None]
    return oracle.reference.triple(first, other)

"""What storage loses: shared exponents of a session's sums, and numbers below float32's normal range."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median

import numpy as np

from prtcl import bounds, quadtree
from prtcl.apps.bench.measure import measure
from prtcl.apps.stress import data, oracle
from prtcl.apps.stress.oracle import OWN, Array, reference
from prtcl.apps.stress.products import product_bound
from prtcl.apps.stress.registry import Size, Trial, case
from prtcl.compute.device import Device
from prtcl.wavelet import haar, masked, pyramid

LEVELS = 5
CHANNELS = (1.0, 1e-5, 1e-10)
"""How bright each channel is."""
TINY = 2.0**-126
"""The smallest normal number of float32."""
KEPT_APART = "`prtcl render` keeps every channel in numbers of its own, and loses nothing of the kind"


def _packed(device: Device, samples: Array) -> Array:
    """Means over all squares through four bytes each: (n, squares, 3)."""
    levels = quadtree.levels_of(samples.shape[-1])
    sums = device.array(np.zeros((len(samples), quadtree.n_squares(levels + 1))), np.uint32)
    scale = pyramid.scale_for(float(samples.max()))
    rows = device.array(np.arange(len(samples)), np.int32)
    pyramid.pack(device, device.array(samples), rows, sums, scale)
    return np.asarray(pyramid.unpack(sums.get(), scale))


def _packed_bound(means: Array, brightest: float) -> Array:
    """Half a step of the square's largest channel, half of the last step that there is, and the sums before."""
    step = pyramid.ROUNDING / 2 * means.max(axis=-1, keepdims=True)
    return np.asarray(
        step + 2.0**-25 / pyramid.scale_for(brightest) + 3 * LEVELS * bounds.STORED["float32"] * means
    )


@case("channels", "Channels and squares that differ by 1e10")
def channels(device: Device, size: Size) -> Iterator[Trial]:
    """Packed sums share an exponent among three channels; coefficients do not."""
    levels = min(LEVELS, size.levels)
    samples = data.stored(
        data.light("lamps", levels, 6).reshape(2, 3, -1) * np.array(CHANNELS)[None, :, None]
    )
    means = oracle.means(samples).transpose(0, 2, 1)
    bound = _packed_bound(means, float(samples.max()))
    theory = "2⁻⁹ of the square's largest channel, 2⁻⁴⁰ of the brightest sample, and float32's sums"
    yield Trial(
        "packed sums",
        lambda: _packed(device, samples),
        means,
        bound,
        theory,
        means.max(axis=-1, keepdims=True),
        "the square's largest channel",
        note="a step of the largest channel is 2⁻⁸ of it at most, and an error half of that: 0.2 % of one square, less "
        "in a sum of many",
    )
    for channel in (1, 2):
        yield Trial(
            f"packed sums, the channel of {CHANNELS[channel]:.0e}",
            lambda c=channel: _packed(device, samples)[..., c],  # type: ignore[misc]
            means[..., channel],
            bound[..., channel],
            theory,
            means[..., channel],
            "the channel itself",
            note=f"a channel below 1/512 of its square's brightest is lost to it: in a session. {KEPT_APART}",
        )
    dark = samples[:, :1].copy()
    dark[..., 0] = 1e11 * dark[..., 1:].max()
    dark_means = np.repeat(oracle.means(dark), 3, axis=1).transpose(0, 2, 1)
    yield Trial(
        "packed sums, squares of 1e-11 of the brightest and less",
        lambda: _packed(device, dark),
        dark_means,
        _packed_bound(dark_means, float(dark.max())),
        theory,
        dark_means,
        "the square itself",
        note="steps end 2⁻³⁹ below the brightest sample: squares darker than 1e-9 of it lose digits, and below 1e-12 "
        f"all. Light so bright is hard light, which a session keeps apart. {KEPT_APART}",
    )
    seen = data.visibility("horizon", levels)
    passed = samples * seen[:, None]
    exact = reference.haar(passed)
    own, bits = device.array(samples), data.packed(seen)
    each = [
        product_bound("pixel", samples[:, c], seen, levels, device.precision) for c in range(len(CHANNELS))
    ]
    yield Trial(
        "L ⊕ V in the pixel domain, every channel by itself",
        lambda: masked.reduce_samples(device, own, bits, levels, levels).get(),
        exact,
        np.stack(each, axis=1),
        "(2 R + 1) u ‖L V‖₂",
        bounds.norms(exact),
        "‖L V‖₂ of the channel",
        rows=True,
    )


@case("subnormals", "Numbers below float32's normal range", ("float32", "mixed"))
def subnormals(device: Device, size: Size) -> Iterator[Trial]:
    """Light of 1e-40, alone and beside ordinary light, through a transform."""
    levels = min(LEVELS, size.levels)
    alone = data.stored(1e-40 * data.light("lamps", levels))
    mixed = data.stored(np.where(np.arange(4**levels) % 2, alone, data.light("lamps", levels)))
    cost = _cost(device)
    for what, samples in (("light of 1e-40", alone), ("light of 1e-40 beside ordinary light", mixed)):
        own, exact = device.array(samples), reference.haar(samples)
        # Every result of every level is rounded to a multiple of 2⁻¹⁴⁹, or where they are flushed lost below 2⁻¹²⁶.
        last = 2.0**-149 if keeps_subnormals(device) else TINY
        yield Trial(
            what,
            lambda own=own: haar.forward(device, own).get(),  # type: ignore[misc]
            exact,
            bounds.haar(levels, bounds.STORED[device.precision] + OWN, samples)
            + 2 * levels * last * 2.0**levels,
            "2 R u ‖x‖₂ + 2 R 2⁻¹⁴⁹ √n; 2⁻¹²⁶ where the device flushes",
            bounds.norms(exact),
            "‖x‖₂",
            rows=True,
            note=cost,
        )


def keeps_subnormals(device: Device) -> bool:
    """Whether half of the smallest normal number survives a transform: what the device does, not what it says."""
    samples = np.zeros((1, 4))
    samples[0, 0] = TINY
    return bool(haar.forward(device, device.array(samples)).get()[0, 0] != 0)


def _cost(device: Device) -> str:
    """What the device does with them, and how long a transform of them takes, in words."""
    samples = data.light("lamps", LEVELS, 64)
    seconds = []
    for values in (samples, 1e-40 * samples):
        own = device.array(values)
        timing, _ = measure(device, lambda own=own: haar.forward(device, own))  # type: ignore[misc]
        seconds.append(median(timing.kernels))
    kept = "keeps" if keeps_subnormals(device) else "flushes"
    return (
        f"{device.precision}: this device {kept} subnormal numbers; a transform of them took "
        f"{seconds[1] / seconds[0]:.1f} times as long as one of others. The pipeline's unit keeps light "
        "away from them; a sample of them beside ordinary light is no part of any answer"
    )

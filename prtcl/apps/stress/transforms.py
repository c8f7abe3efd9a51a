"""The Haar transforms and parent sums of patterns that round most, or must not round at all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from prtcl import bounds, quadtree
from prtcl.apps.stress import data
from prtcl.apps.stress.oracle import OWN, Array, reference
from prtcl.apps.stress.registry import Size, Trial, case
from prtcl.compute.device import Device
from prtcl.wavelet import haar, triple

PATTERNS = ("constant", "checkerboard", "adversarial", "nearly constant", "lamps")
EXACT = ("constant", "checkerboard")
"""Sums of equal magnitudes are powers of two of them: float32 holds all of them."""


def pattern(kind: str, levels: int, precision: str) -> Array:
    """Samples (n, 4**levels) of one of `PATTERNS`."""
    if kind == "checkerboard":
        return data.checkerboard(levels)
    if kind == "adversarial":
        return data.adversarial(levels, 2 * bounds.STORED[precision])
    return data.light(kind, levels)


@case("haar", "Haar transforms of hard patterns")
def transforms(device: Device, size: Size) -> Iterator[Trial]:
    """Forward and inverse, every depth."""
    u = bounds.STORED[device.precision]
    for kind in PATTERNS:
        for way, job, exact in (
            ("forward", haar.forward, reference.haar),
            ("inverse", haar.inverse, reference.ihaar),
        ):
            for levels in range(1, size.levels + 1):
                given = pattern(kind, levels, device.precision)
                if way == "inverse":
                    given = reference.haar(given).astype(device.dtype).astype(np.float64)
                own = device.array(given)
                free = kind in EXACT
                yield Trial(
                    f"{kind}, {way}",
                    lambda job=job, own=own: job(device, own).get(),  # type: ignore[misc]
                    exact(given),
                    0.0 if free else bounds.haar(levels, u + OWN, given),
                    "2 R u ‖x‖₂ (0 for a constant and a checkerboard, which are exact)",
                    bounds.norms(given),
                    "‖x‖₂",
                    at=f"R = {levels}",
                    rows=True,
                )


def parent_magnitude(coefficients: Array) -> Array:
    """Σ |term| of every parent sum: (rows, n_squares(levels))."""
    levels = quadtree.levels_of(coefficients.shape[-1])
    here = 2.0**-levels * np.abs(coefficients[..., :1])
    out = [here]
    for r in range(levels - 1):
        details = np.abs(coefficients[..., 4**r : 4 ** (r + 1)]).reshape(*here.shape[:-1], 4**r, 3)
        here = np.repeat(here + 2.0 ** (r - levels) * details.sum(axis=-1), 4, axis=-1)
        out.append(here)
    return np.concatenate(out, axis=-1)


@case("parent_sums", "Parent sums, in which coefficients cancel")
def parent_sums(device: Device, size: Size) -> Iterator[Trial]:
    """Means of squares from coefficients: of a dark square beside a bright one all but nothing is left."""
    u = bounds.SUMMED[device.precision] + OWN
    for kind in ("random", "constant", "nearly constant", "lamps", *data.BRIGHT):
        for levels in range(1, size.levels + 1):
            given = reference.haar(data.light(kind, levels)).astype(device.dtype).astype(np.float64)
            own, exact = device.array(given), reference.parent_sums(given)
            yield Trial(
                kind,
                lambda own=own: triple.parent_sums(device, own).get(),  # type: ignore[misc]
                exact,
                # Two additions a level and a product for each term; the answer's own rounding in `reference`.
                (2 * levels + 1) * u * parent_magnitude(given),
                "(2 R + 1) u Σ |term|",
                np.abs(exact).max(axis=-1, keepdims=True),
                "the largest mean of the row",
                at=f"R = {levels}",
            )

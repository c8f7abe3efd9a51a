"""L ⊕ V in every form of the product, where what passes is little of the light, or much of it cancels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import bounds
from prtcl.apps.stress import data
from prtcl.apps.stress.oracle import OWN, Array, reference
from prtcl.apps.stress.registry import Size, Trial, case
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form
from prtcl.wavelet import haar, masked, triple

FORMS = ("pixel", "tree", "bits", "in place")
"""From samples; from both factors' coefficients, level by level; from coefficients and bits; the same, sparsely."""
KINDS = (
    ("random", "horizon"),
    ("constant", "horizon"),
    ("nearly constant", "horizon"),
    ("lamps", "horizon"),
    *((bright, "all but the bright one") for bright in data.BRIGHT),
)
FROM_COEFFICIENTS = (
    "coefficients hold the whole light, hidden or not, and errors are relative to it: with a light of 1e6 times the "
    "rest behind an occluder float32 keeps two to four digits of what is seen, with a sun of 1e9 one at best; mixed "
    "gains at most a digit, for it stores coefficients in float32 too. The remedy is the default, the pixel domain, "
    "which never adds a hidden light (`before` is the tree on the same data); else --precision float64"
)


def product(device: Device, form: str, samples: Any, bits: npt.NDArray[np.uint32], levels: int) -> Array:
    """L ⊕ V of samples (n, 1, 4**levels) on the device, by one of `FORMS`."""
    if form == "pixel":
        return np.asarray(masked.reduce_samples(device, samples, bits, levels, levels).get())
    coefficients = haar.forward(device, samples)
    if form == "tree":
        with triple.REDUCTION.trial(Form("tree")):
            seen = masked.visibility_coefficients(device, bits, levels)
            return np.asarray(triple.reduce(device, coefficients, seen).get())
    if form == "bits":
        return np.asarray(masked.reduce_coefficients(device, coefficients, bits, levels, levels).get())
    return np.asarray(masked.reduce_in_place(device, coefficients, bits).get())


def _rows(job: Callable[..., Array], *arguments: Any) -> Array:
    """A job's only channel."""
    return job(*arguments)[:, 0]


def product_bound(form: str, samples: Array, seen: data.Seen, levels: int, precision: str) -> Array:
    """‖error‖₂ of `product`, a row each: (n, 1).

    From samples, `bounds.masked_average`. From coefficients the transform's own error comes first, and passes the mask
    at most whole; then the tree's, or that of a transform down and up again, whichever the form does.
    """
    passed = samples * seen
    own = bounds.haar(levels, OWN, passed)
    if form == "pixel":
        return own + bounds.masked_average(passed, levels, levels, precision)
    u = bounds.STORED[precision] + OWN
    transform = bounds.haar(levels, u, samples)
    tree = bounds.norms(bounds.triple(reference.haar(samples), reference.haar(seen), precision))
    down_and_up = 2 * bounds.haar(levels, u, samples)
    rest = {"tree": tree, "in place": down_and_up}.get(form, np.maximum(tree, down_and_up))
    return np.asarray(own + transform + rest)


def trials(
    device: Device, kind: str, shadow: str, levels: int, forms: tuple[str, ...], at: str, note: str = ""
) -> Iterator[Trial]:
    """One light and one visibility in some forms."""
    samples, seen = data.light(kind, levels), data.visibility(shadow, levels)
    own, bits = device.array(samples[:, None]), data.packed(seen)
    exact = reference.haar(samples * seen)
    for form in forms:
        run: Callable[[], Array] = partial(product, device, form, own, bits, levels)
        name = kind if shadow in ("horizon", "all but the bright one") else f"{shadow} visible, {kind}"
        yield Trial(
            f"{name}: {form}",
            partial(_rows, run),
            exact,
            product_bound(form, samples, seen, levels, device.precision),
            "pixel: (2 R + 1) u ‖L V‖₂; from coefficients: (3 R + 6) u Σ |term| or 6 R u ‖L‖₂",
            bounds.norms(exact),
            "‖L V‖₂, what is seen",
            at=at,
            rows=True,
            note=note,
            before=partial(_rows, product, device, "tree", own, bits, levels)
            if form == "pixel" and kind in data.BRIGHT
            else None,
        )


@case("products", "Light times visibility: cancellation in parent sums and in G")
def products(device: Device, size: Size) -> Iterator[Trial]:
    """Every form at every depth; a sample of light is 1e6 or 1e9 times the others, and hidden."""
    for kind, shadow in KINDS:
        note = FROM_COEFFICIENTS if kind in data.BRIGHT else ""
        for levels in range(1, size.levels + 1):
            yield from trials(device, kind, shadow, levels, FORMS, f"R = {levels}", note)


@case("one_direction", "One visible direction, and all but one")
def one_direction(device: Device, size: Size) -> Iterator[Trial]:
    """Of 16384, where the size allows."""
    levels = min(7, size.levels)
    note = (
        "one direction of 16384 holds little of the light, and from coefficients the error is relative to all of it: "
        "take the pixel domain (the default) where that matters"
    )
    for kind in ("constant", "lamps"):
        for shadow in ("one", "all but one"):
            yield from trials(
                device, kind, shadow, levels, FORMS, f"R = {levels}", note if shadow == "one" else ""
            )


@case("two_factors", "a ⊕ b of two signed functions through the tree")
def two_factors(device: Device, size: Size) -> Iterator[Trial]:
    """Every coefficient on its own, against haar(ihaar(a) ihaar(b))."""
    for kind in ("random", "nearly constant", "lamps"):
        for levels in range(1, size.levels + 1):
            a = reference.haar(data.light(kind, levels)).astype(device.dtype).astype(np.float64)
            b = reference.haar(data.light("random", levels)[::-1]).astype(device.dtype).astype(np.float64)
            given = device.array(a[:, None]), device.array(b[:, None])
            exact = reference.triple(a, b)
            pixel = bounds.norms(reference.ihaar(a) * reference.ihaar(b))

            def run(given: Any = given) -> Array:
                with triple.REDUCTION.trial(Form("tree")):
                    return np.asarray(triple.reduce(device, *given).get()[:, 0])

            yield Trial(
                f"{kind} times random",
                run,
                exact,
                # The oracle goes through samples, whose products it transforms: 6 R u of float64 in norm.
                bounds.triple(a, b, device.precision) + 6 * levels * OWN * pixel,
                "(3 R + 6) u Σ |C_ijk a_j b_k|",
                bounds.norms(exact),
                "‖a ⊕ b‖₂",
                at=f"R = {levels}",
            )

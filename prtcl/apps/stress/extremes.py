"""Random extremes: no NaN and no infinity from finite input whose answer is finite."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from prtcl import bounds
from prtcl.apps.stress import data, oracle
from prtcl.apps.stress.oracle import OWN, Array, reference
from prtcl.apps.stress.products import FORMS, product, product_bound
from prtcl.apps.stress.reflectance import DARK, WHERE, given
from prtcl.apps.stress.registry import Size, Trial, case
from prtcl.compute.device import Device
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.transport import shade
from prtcl.wavelet import haar

MATERIALS, LEVELS, ROWS = 24, 4, 64
LOWEST, HIGHEST = -100, 110
"""Magnitudes of samples are 2 to these; 4**LEVELS of the highest stay below float32's largest."""


TINY_INDEX = (
    "an index of 0.001, which no substance has, reflects all beyond an angle of 0.001 rad: a cosine in float32 tells "
    "such angles apart to 3e-4 rad, and F is off by 1e-4 where it falls"
)


def _material(rng: np.random.Generator) -> Material:
    """A material at the ends of its ranges more often than not."""
    alpha = float(rng.choice([1e-3, 1.0, 10 ** rng.uniform(-3, 0)]))
    exponent = float(rng.choice([0.0, 1e5, 10 ** rng.uniform(-3, 5)]))
    f0 = float(rng.choice([0.0, 1.0, rng.uniform()]))
    eta = float(rng.choice([1e-3, 1.0, 100.0, 10 ** rng.uniform(-3, 2)]))
    k = float(rng.choice([0.0, 100.0, 10 ** rng.uniform(-6, 2)]))
    return Material.parse(
        str(
            rng.choice(
                [
                    f"ggx:alpha={alpha!r},f0={f0!r},kd={f0!r}",
                    f"ggx:alpha={alpha!r},eta={eta!r},k={k!r}",
                    f"blinn:exponent={exponent!r},ks={f0!r},kd={1 - f0!r}",
                ]
            )
        )
    )


def _tiny_index(m: Material) -> bool:
    """Whether a conductor's refractive index is below a hundredth."""
    return m.kind == "ggx-conductor" and max(m.numbers["eta"]) ** 2 + max(m.numbers["k"]) ** 2 < 1e-4


def _samples(rng: np.random.Generator) -> Array:
    """Rows of signs times powers of two far apart, between rows and within."""
    middle = rng.uniform(LOWEST, HIGHEST - 20, (ROWS, 1))
    power = np.clip(middle + rng.uniform(-20, 20, (ROWS, 4**LEVELS)), LOWEST, HIGHEST)
    return data.stored(rng.choice([-1.0, 0.0, 1.0], power.shape) * 2.0**power)


@case("extremes", "Random extremes: finite answers stay finite")
def extremes(device: Device, size: Size) -> Iterator[Trial]:
    """Seeded, so that a second run has the same."""
    rng = np.random.default_rng(20)
    u = bounds.STORED[device.precision]
    for number in range(MATERIALS):
        own = _material(rng)
        for where in WHERE:
            i, o = given(device, where, 199)
            exact, bound = oracle.brdf(own, i, o), oracle.brdf_bound(own, i, o, u)
            # F may be 0 where the lobe is not: errors count against the lobe, of which the bound is some 100 u.
            yield Trial(
                "f of random materials",
                lambda m=own, i=i, o=o: Materials(device, [m]).evaluate(0, i, o),  # type: ignore[misc]
                exact,
                bound,
                "that of f",
                np.maximum(np.maximum(exact, bound / (100 * u)), DARK),
                "the larger of f and its lobe with F = 1",
                at=f"material {number + 1}, {where}: {own.spec}",
                note=TINY_INDEX if _tiny_index(own) else "",
                limit=1e-3 * u / 2.0**-24 if _tiny_index(own) else None,
            )
    samples = _samples(rng)
    seen = rng.uniform(size=samples.shape) < 0.5
    rows, bits = device.array(samples), data.packed(seen)
    yield Trial(
        "Haar transform",
        lambda: haar.forward(device, rows).get(),
        reference.haar(samples),
        bounds.haar(LEVELS, u + OWN, samples),
        "2 R u ‖x‖₂",
        bounds.norms(samples),
        "‖x‖₂",
        rows=True,
    )
    for form in FORMS:
        yield Trial(
            f"L ⊕ V: {form}",
            lambda form=form: product(device, form, rows.reshape(ROWS, 1, -1), bits, LEVELS)[:, 0],  # type: ignore[misc]
            reference.haar(samples * seen),
            product_bound(form, samples, seen, LEVELS, device.precision),
            "as in the products",
            bounds.norms(samples),
            "‖L‖₂, hidden or not",
            rows=True,
        )
    f = data.stored(2.0 ** rng.uniform(-20, 10, (ROWS, 1, 4**LEVELS)))
    index, weight = np.arange(ROWS, dtype=np.int32)[:, None], np.ones((ROWS, 1))
    terms = 2 * np.pi / 4.0**LEVELS * samples * f[:, 0]
    total = terms.sum(axis=1)
    exact = np.stack([total, total, total, 0 * total], axis=1)
    yield Trial(
        "inner product",
        lambda: shade.soft_radiance(
            device, rows.reshape(ROWS, 1, -1), device.array(f), index, weight, LEVELS
        ).get(),
        exact,
        bounds.inner_product(terms, LEVELS, 4, 1, device.precision)[:, None] + 2.0**-126,
        "k u Σ |c_j f_j|",
        np.abs(terms).sum(axis=1)[:, None],
        "Σ |c_j f_j|",
    )

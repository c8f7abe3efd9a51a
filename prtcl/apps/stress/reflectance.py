"""Reflectance where it is sharpest and most grazing, and the albedo that its slices keep."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from prtcl import bounds
from prtcl.apps.stress import data, oracle
from prtcl.apps.stress.registry import Size, Trial, case
from prtcl.compute.device import Device
from prtcl.factors import material
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials

SPECS = (
    "ggx:alpha=0.001,eta=0.2,k=3",
    "ggx:alpha=0.001,f0=1",
    "ggx:alpha=0.3,eta=0.2,k=3",
    "blinn:exponent=100000,ks=1",
    "blinn:exponent=200,ks=0.5,kd=0.1",
)
NARROW = "a table of nodes 1e-3 rad apart"
WHERE = ("near the mirror", "grazing", "grazing mirror", "at the horizon")
DARK = 1e-30
"""f below this counts in full: the tails of a sharp Blinn lobe underflow, and should."""


TABLE = (
    "its angles come from sines on the device and from cosines in the float64 reference, which a table of nodes 1e-3 "
    "rad apart shows: arccos near 1 turns 2⁻⁵³ into 1.5e-8 rad, so about 1e-4 of f is the reference's own"
)
BLINN = (
    "cos^n of a direction stored with a relative error of u is off by n tan²θ_h u: where cos^n has fallen to e⁻ᵏ that "
    "is 2 k u, so in float32 a lobe of exponent 1e5 is right to some 2e-5 down to 1e-30 of its peak"
)


def narrow_table() -> Material:
    """A lobe of 10⁻³ rad as a table: nodes 10⁻³ apart at the peak, then farther and farther."""
    theta_h = np.concatenate([np.arange(8) * 1e-3, np.geomspace(0.01, np.pi / 2, 24)])
    theta_d = np.linspace(0.0, np.pi / 2, 9)
    lobe = 1e4 / (1 + (theta_h[:, None] / 1e-3) ** 2) ** 2 + 0.1
    return material.from_table(np.repeat((lobe + 0 * theta_d)[..., None], 3, axis=2), theta_h, theta_d)


def given(device: Device, where: str, count: int = 997) -> tuple[oracle.Array, oracle.Array]:
    """`data.pairs` as the device holds them: unit vectors but for the rounding of their components."""
    first, second = data.pairs(where, count)
    return first.astype(device.dtype).astype(np.float64), second.astype(device.dtype).astype(np.float64)


@case("lobes", "Near-mirror lobes and grazing angles: f itself")
def lobes(device: Device, size: Size) -> Iterator[Trial]:
    """α = 0.001, exponent 10⁵, a narrow table; views and lights down to the horizon."""
    for name, own in [*((spec, Material.parse(spec)) for spec in SPECS), (NARROW, narrow_table())]:
        for where in WHERE:
            i, o = given(device, where)
            materials, exact = Materials(device, [own]), oracle.brdf(own, i, o)
            table = own.table is not None
            sharp = own.kind == "blinn"
            yield Trial(
                name,
                lambda m=materials, i=i, o=o: m.evaluate(0, i, o),  # type: ignore[misc]
                exact,
                oracle.brdf_bound(own, i, o, bounds.STORED[device.precision]),
                "GGX: 96 u f; Blinn: (48 + 8 n tan²θ_h) u f; a table: slope times 2⁻²² of a right angle",
                np.where(np.abs(exact) > DARK, np.abs(exact), np.abs(exact).max()),
                "f",
                at=where,
                note=TABLE if table else BLINN if sharp else "",
            )


@case("albedo", "The albedo that slices of the sharpest lobe keep")
def albedo(device: Device, size: Size) -> Iterator[Trial]:
    """GGX α = 0.001 with f0 = 1 reflects all but nothing away: what 4**7 cells of it add up to."""
    levels = min(7, size.levels)
    if levels < 7:
        return
    theta = np.radians([0.0, 0.05, 20.0, 37.3, 60.0, 75.0])
    views = data.sphere(np.cos(theta), 0.3)
    materials = Materials(device, [Material.parse("ggx:alpha=0.001,f0=1")])
    exact = np.array([oracle.ggx_albedo(0.001, view) for view in views])
    yield Trial(
        "ggx:alpha=0.001,f0=1, views to 75 degrees",
        lambda: materials.slices(views, levels).get()[0, :, 0, 0].astype(np.float64) / 2**levels * 2 * np.pi,
        exact,
        0.01 * exact,
        "1 %, the grid's, not the arithmetic's",
        exact,
        "the albedo",
        at=f"R = {levels}",
        note="a lobe a tenth of a cell wide is averaged over 4^13 directions about its peak (prtcl/factors/slices.py)",
        before=lambda: (
            materials.slices(views, levels, sub=4).get()[0, :, 0, 0].astype(np.float64)
            / 2**levels
            * 2
            * np.pi
        ),
    )

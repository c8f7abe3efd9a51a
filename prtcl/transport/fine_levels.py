"""Levels of the product at which f_v has no energy: smooth lobes need few, however finely light and visibility go."""

from __future__ import annotations

import numpy as np

from prtcl.compute.device import Device
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials

COST = 1e-3
"""Relative error that the levels left out may cost, by default: none of the settings that
`prtcl.transport.settings.choose` chooses has such levels (tests/test_leave_out.py)."""
WIDE = 0.25
"""GGX alpha below which none is left out: settings are chosen by the lobe there, and slices are dear."""
VIEWS = 6


def needed(device: Device, material: Material, keep: int, cost: float = COST) -> tuple[int, float]:
    """How many of `keep` levels a material needs, and the relative error that the others would have made good.

    With e_r the energy of f_v's details of level r over the square of its mean, and a product whose details have as
    much energy at each level as its mean and signs of their own, the levels from K on contribute
    √(Σ_{r ≥ K} e_r / (3 · 4^r)).
    """
    if material.roughness < WIDE:
        return keep, 0.0
    theta = np.linspace(0.0, 1.5, VIEWS)
    views = np.stack([np.sin(theta), np.zeros(VIEWS), np.cos(theta)], axis=1)
    slices = Materials(device, [material]).slices(views, keep).get()[0].astype(np.float64)
    mean = (slices[..., 0] ** 2).sum()
    share = np.array([(slices[..., 4**r : 4 ** (r + 1)] ** 2).sum() / max(mean, 1e-300) for r in range(keep)])
    lost = np.sqrt(np.cumsum((share / (3.0 * 4.0 ** np.arange(keep)))[::-1])[::-1])
    fine = np.flatnonzero(lost > cost)
    least = max(1, int(fine[-1]) + 1) if fine.size else 1
    return least, float(lost[least]) if least < keep else 0.0

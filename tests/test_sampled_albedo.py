"""Directional albedos against closed forms and the float64 reference's grid."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl import reference
from prtcl.factors.sampled_albedo import sampled_albedo

Array = NDArray[np.float64]
THETA = np.radians([0.0, 30.0, 60.0, 80.0])


def test_lambert_reflects_its_albedo() -> None:
    got = sampled_albedo(lambda i, o: np.full(i.shape, [0.5, 0.25, 1.0]) / np.pi, THETA)
    np.testing.assert_allclose(got, np.broadcast_to([0.5, 0.25, 1.0], (4, 3)), rtol=1e-3)


def test_a_power_of_the_cosine_in_closed_form() -> None:
    """f = cosⁿ θ_i: ∫ cosⁿ⁺¹ = 2π/(n + 2)."""
    for n in (1, 5, 20):
        got = sampled_albedo(lambda i, o, n=n: np.repeat(i[:, 2:] ** n, 3, axis=1), THETA)
        np.testing.assert_allclose(got, 2 * np.pi / (n + 2), rtol=2e-3)


@pytest.mark.parametrize("alpha", [0.5, 0.05])
def test_a_lobe_against_a_fine_grid(alpha: float) -> None:
    material = {"kind": "ggx", "alpha": alpha, "f0": 1.0}
    got = sampled_albedo(lambda i, o: reference.brdf(material, i, o), THETA[:3])
    for angle, own in zip(THETA[:3], got, strict=True):
        view = np.array([np.sin(angle), 0.0, np.cos(angle)])
        wanted = reference.slice_samples(material, view, 4, 5).mean(axis=0) * 2 * np.pi
        np.testing.assert_allclose(own, wanted, rtol=1e-3)


def test_a_lobe_too_narrow_for_any_grid_keeps_its_energy() -> None:
    """GGX α = 0.001 with F = 1 loses next to nothing at 30 degrees."""
    material = {"kind": "ggx", "alpha": 0.001, "f0": 1.0}
    got = sampled_albedo(lambda i, o: reference.brdf(material, i, o), THETA[:2], samples=192)
    np.testing.assert_allclose(got, 1.0, atol=0.01)

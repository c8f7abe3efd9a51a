"""Directional albedo of tables, against Lambert's, against sums over the hemisphere, and against finer rules."""

from __future__ import annotations

import math

import numpy as np
import pytest

from prtcl import reference
from prtcl.errors import InputError
from prtcl.factors import albedo as own
from prtcl.factors.albedo import INCIDENCES, albedo, columns, energy
from prtcl.factors.bivariate import Bivariate, merl_nodes
from prtcl.factors.material import Material
from prtcl.factors.table_edit import conserve, scale
from prtcl.factors.tabulate import tabulate

COSINES = np.cos(np.radians([0.0, 35.0, 70.0, 85.0]))


def summed(material: dict[str, object], cosine: float, levels: int = 10) -> np.ndarray:
    """The reference's sum over 4**levels equal parts of the hemisphere."""
    view = np.array([math.sqrt(1 - cosine**2), 0.0, cosine])
    incident = reference.directions(levels)
    f = reference.brdf(material, incident, view) * incident[:, 2:]
    return np.asarray(f.sum(axis=0) * 2 * np.pi / 4**levels)


@pytest.mark.parametrize("nodes", [1, 2, 90])
def test_lamberts_albedo_is_its_own(nodes: int) -> None:
    h, d = (x[:nodes] for x in merl_nodes())
    values = np.full((nodes, nodes, 3), [0.2, 0.5, 1.0]) / np.pi
    found = albedo(Bivariate.make(values, h, d), [*COSINES, 0.01])
    # The rule alone errs, where its range over φ_h has a corner: by 1e-7, and 9e-7 at half a degree of the horizon.
    np.testing.assert_allclose(found, np.broadcast_to([0.2, 0.5, 1.0], found.shape), rtol=1e-6)


@pytest.mark.parametrize("alpha", [0.15, 0.5, 1.0])
def test_it_is_the_sum_over_the_hemisphere(alpha: float) -> None:
    """A million directions resolve lobes of α ≥ 0.15 to a few 1e-4; the table is the same on both sides."""
    table = tabulate(f"ggx:alpha={alpha},f0=0.9/0.5/0.1,kd=0.1")
    for cosine, found in zip(COSINES, albedo(table, COSINES), strict=True):
        np.testing.assert_allclose(found, summed(table.material().reference(), cosine), rtol=5e-4)


@pytest.mark.parametrize(
    "spec",
    ["ggx:alpha=0.15,f0=0.9/0.5/0.1", "ggx:alpha=0.6,eta=0.2,k=3.0", "blinn:exponent=60,ks=0.5,kd=0.2"],
)
def test_a_tabulated_material_keeps_its_albedo(spec: str) -> None:
    """Averaging over φ_d moves energy: by 2.2 % at 70 degrees for the sharpest, where masking sets in."""
    table = tabulate(spec)
    for cosine, found in zip(COSINES[:3], albedo(table, COSINES[:3]), strict=True):
        np.testing.assert_allclose(found, summed(Material.parse(spec).reference(), cosine), rtol=0.025)


@pytest.mark.parametrize("alpha", [0.02, 0.1, 0.4, 1.0])
def test_a_finer_rule_changes_nothing(alpha: float, monkeypatch: pytest.MonkeyPatch) -> None:
    table = tabulate(f"ggx:alpha={alpha},f0=0.9")
    found = albedo(table, INCIDENCES)
    own._weights.cache_clear()
    coarse = own.half_rule
    monkeypatch.setattr(own, "half_rule", lambda nodes, cosine: coarse(nodes, cosine, 8, 96))
    finer = albedo(table, INCIDENCES)
    own._weights.cache_clear()
    assert (found != finer).any()
    worst = np.abs(found / finer - 1).max()
    print(f"alpha {alpha}: {worst:.1e}")
    assert worst < 1e-4


def test_a_sharp_lobe_loses_nothing() -> None:
    """White GGX of α = 0.02 reflects all but what its masking takes: 1 − O(α²) near the normal."""
    found = albedo(tabulate("ggx:alpha=0.02,f0=1.0"), [1.0, math.cos(math.radians(45.0))])
    np.testing.assert_allclose(found, 1.0, atol=3e-3)


def test_columns_add_up_to_the_albedo() -> None:
    table = tabulate("ggx:alpha=0.3,f0=0.9")
    np.testing.assert_allclose(columns(table, INCIDENCES).sum(axis=1), albedo(table, INCIDENCES), rtol=1e-12)


def test_energy_finds_the_most_and_conserve_takes_it_down_to_one() -> None:
    table = tabulate("ggx:alpha=0.3,f0=0.04/0.9/0.5,kd=0.1")
    most, cosine, channel = energy(table)
    assert channel == 1 and cosine in INCIDENCES
    assert most == pytest.approx(albedo(table, [cosine])[0, 1], rel=1e-12)
    assert conserve(table) is table
    bright = scale(table, 3.0)
    assert energy(bright)[0] == pytest.approx(3 * most, rel=1e-12)
    down = conserve(bright)
    assert energy(down)[0] == pytest.approx(1.0, rel=1e-12) and "conserve" in down.notes[-1]
    np.testing.assert_allclose(
        down.values / table.values.max(), table.values / most / table.values.max(), rtol=1e-12
    )


@pytest.mark.parametrize("wrong", [[0.0], [-0.5], [1.5], [math.nan], [[0.5]]])
def test_a_cosine_out_of_range_is_named(wrong: list[float]) -> None:
    with pytest.raises(InputError, match="cosines: expected"):
        albedo(Bivariate.make([[1.0]], [0.0], [0.0]), wrong)

"""Edits of bivariate tables: exact laws first, then energy, then against formulas of their own."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import prtcl
from prtcl.errors import InputError
from prtcl.factors import table_parts
from prtcl.factors.albedo import INCIDENCES, albedo, energy
from prtcl.factors.bivariate import Bivariate, merl_nodes
from prtcl.factors.table import Table
from prtcl.factors.table_edit import (
    blend,
    conserve,
    marginal_h,
    paint,
    replace_theta_h,
    resample,
    scale,
    tint,
)
from prtcl.factors.table_parts import balance, fresnel, marginal_d, replace_fresnel, sharpen, split
from prtcl.factors.tabulate import tabulate

PLASTIC, GOLD, CHALK = (
    "ggx:alpha=0.2,f0=0.04,kd=0.5/0.2/0.05",
    "ggx:alpha=0.1,f0=1.0/0.77/0.34",
    "lambert:albedo=0.4",
)


def measured(seed: int = 2) -> Bivariate:
    """What a reader gives: MERL's nodes, noise, a mask."""
    rng = np.random.default_rng(seed)
    smooth = tabulate("ggx:alpha=0.15,f0=0.3/0.2/0.1,kd=0.3/0.2/0.1", *merl_nodes())
    noisy = smooth.values * rng.lognormal(0.0, 0.05, smooth.values.shape)
    return Bivariate.make(noisy, smooth.theta_h, smooth.theta_d, rng.random(smooth.shape) > 0.1, name="noisy")


EDITS: dict[str, Callable[[Bivariate], Bivariate]] = {
    "scale": lambda t: scale(t, 0.5),
    "tint": lambda t: tint(t, (1.0, 0.5, 0.0)),
    "sharpen": lambda t: sharpen(t, 1.7),
    "widen": lambda t: sharpen(t, 0.6),
    "to specular": lambda t: balance(t, 0.4),
    "to diffuse": lambda t: balance(t, -1.0),
    "fresnel": lambda t: fresnel(t, 2.0),
    "no fresnel": lambda t: fresnel(t, 0.0),
    "theta_h": lambda t: replace_theta_h(t, np.exp(-t.theta_h)),
    "fresnel curve": lambda t: replace_fresnel(t, lambda d: 1 + d),
    "paint": lambda t: paint(t, (0.1, 0.3), (0.5, 1.0), factor=(0.0, 2.0, 1.0)),
    "paint a value": lambda t: paint(t, (0.0, 0.1), (0.0, np.pi / 2), value=0.2, softness=0.0),
    "blend": lambda t: blend(t, scale(t, 2.0), 0.3),
}


@pytest.mark.parametrize("name", EDITS)
def test_every_edit_keeps_nodes_mask_and_name_and_is_noted(name: str) -> None:
    table = measured()
    before = table.values.copy()
    after = EDITS[name](table)
    np.testing.assert_array_equal(table.values, before, "the table given is left alone")
    assert (after.values != before).any()
    assert np.isfinite(after.values).all() and after.values.min() >= 0.0
    for key in ("theta_h", "theta_d", "valid"):
        np.testing.assert_array_equal(getattr(after, key), getattr(table, key))
    assert after.name == "noisy" and len(after.notes) == len(table.notes) + 1
    assert after.notes[-1].startswith("noisy: ")
    assert energy(after)[0] > 0


@pytest.mark.parametrize(
    "edit",
    [
        lambda t: scale(t, 1.0),
        lambda t: tint(t, (1.0, 1.0, 1.0)),
        lambda t: sharpen(t, 1.0),
        lambda t: balance(t, 0.0),
        lambda t: fresnel(t, 1.0),
        lambda t: blend(t, tabulate(CHALK), 0.0),
        lambda t: blend(tabulate(CHALK), t, 1.0),
        lambda t: paint(t, (0.1, 0.3), (0.5, 1.0), factor=1.0, softness=0.0),
    ],
)
def test_the_edit_that_does_nothing_is_exact(edit: Callable[[Bivariate], Bivariate]) -> None:
    table = measured()
    np.testing.assert_array_equal(edit(table).values, table.values)


def test_scale_and_tint_are_products() -> None:
    table = measured()
    np.testing.assert_array_equal(scale(table, 0.25).values, table.values / 4)
    np.testing.assert_array_equal(tint(table, (2.0, 0.5, 0.0)).values, table.values * [2.0, 0.5, 0.0])


# --- mixing -------------------------------------------------------------------------------------------------


def test_a_mix_is_linear_between_the_nodes_of_both() -> None:
    a, b = tabulate(PLASTIC), measured()
    rng = np.random.default_rng(1)
    h, d = rng.random((2, 1000)) * np.pi / 2
    mixed = blend(a, b, 0.3)
    np.testing.assert_allclose(
        mixed.evaluate(h, d), 0.7 * a.evaluate(h, d) + 0.3 * b.evaluate(h, d), rtol=1e-11
    )
    assert "0.3 of noisy" in mixed.notes[-1]
    np.testing.assert_array_equal(blend(b, a, 0.7).valid, mixed.valid)
    lost = 1 - mixed.valid.mean()
    assert 0.05 < lost < 0.15, "a tenth of b is not measured"
    np.testing.assert_allclose(
        albedo(mixed, INCIDENCES), 0.7 * albedo(a, INCIDENCES) + 0.3 * albedo(b, INCIDENCES), rtol=1e-4
    )


def test_a_mix_of_many_nodes_takes_the_finer() -> None:
    few, many = (tabulate("blinn:exponent=50,ks=0.5", np.linspace(0, 1.57, n), [0.0, 1.0]) for n in (7, 510))
    assert blend(few, many, 0.5).shape == blend(many, few, 0.5).shape == (510, 2)


def test_resampling_keeps_the_mask_of_the_nearest_node() -> None:
    table = Bivariate.make(np.ones((2, 2)), [0.0, 1.0], [0.0, 1.0], [[True, False], [True, True]])
    fine = resample(table, np.array([0.0, 0.4, 0.6, 1.0]), np.array([0.0, 0.9]))
    assert fine.valid.tolist() == [[True, False], [True, False], [True, True], [True, True]]
    assert resample(table, table.theta_h, table.theta_d) is table


# --- painting -----------------------------------------------------------------------------------------------


def test_paint_is_hard_inside_soft_at_the_edge_and_nothing_beyond() -> None:
    h, d = np.linspace(0, 1, 101) ** 2 * np.pi / 2, np.linspace(0, np.pi / 2, 101)
    table = Bivariate.make(np.ones((101, 101, 3)), h, d)
    at = np.arange(101) / 100  # both on the picture's axes
    low, high = (0.3**2 * np.pi / 2, 0.5**2 * np.pi / 2), (0.6 * np.pi / 2, 0.8 * np.pi / 2)
    values = paint(table, low, high, factor=(3.0, 1.0, 0.0), softness=0.1).values
    np.testing.assert_allclose(values[30:51, 60:81], np.broadcast_to([3.0, 1.0, 0.0], (21, 21, 3)), atol=1e-9)
    for outside in (at < 0.2 - 1e-9, at > 0.6 + 1e-9):
        np.testing.assert_array_equal(values[outside], 1.0)
    assert values[25, 70, 0] == pytest.approx(2.0) and values[40, 85, 2] == pytest.approx(0.5), "half way"
    assert (np.diff(values[:, 70, 0])[20:30] > -1e-12).all()
    hard = paint(table, low, high, value=0.25, softness=0.0).values
    assert set(np.unique(hard)) == {0.25, 1.0}


# --- curves -------------------------------------------------------------------------------------------------


def test_a_replaced_lobe_has_the_curve_and_keeps_the_rest() -> None:
    table = measured()
    curve = 0.2 + np.exp(-((table.theta_h / 0.2) ** 2))
    after = replace_theta_h(table, curve)
    np.testing.assert_allclose(marginal_h(after), curve, rtol=1e-12)
    np.testing.assert_allclose(
        after.values / table.values, (curve / marginal_h(table))[:, None, None] + 0 * table.values
    )
    np.testing.assert_allclose(replace_theta_h(table, marginal_h(table)).values, table.values, rtol=1e-12)
    black = replace_theta_h(scale(table, 0.0), curve)
    np.testing.assert_array_equal(black.values, np.broadcast_to(curve[:, None, None], black.values.shape))


def test_the_marginal_of_a_product_is_its_factor() -> None:
    h, d = merl_nodes()
    lobe, edge = np.exp(-5 * h), 1 + d**2
    table = Bivariate.make(lobe[:, None] * edge, h, d)
    np.testing.assert_allclose(marginal_h(table) / marginal_h(table)[0], lobe / lobe[0], rtol=1e-12)


def test_a_replaced_fresnel_curve_is_the_specular_parts() -> None:
    table = tabulate(PLASTIC)
    diffuse, before = split(table)
    curve = 1 + 4 * np.sin(table.theta_d) ** 2
    after = replace_fresnel(table, curve)
    specular = after.values - diffuse.values
    own = np.einsum("hdc->d", before.values * np.gradient(np.sin(table.theta_h) ** 2)[:, None, None])
    new = np.einsum("hdc->d", specular * np.gradient(np.sin(table.theta_h) ** 2)[:, None, None])
    # Exact at each θ_d where one number multiplies it; `marginal_d`'s weights are not these.
    np.testing.assert_allclose(new / own, curve * marginal_d(table)[0] / marginal_d(table), rtol=1e-9)
    np.testing.assert_allclose(after.values[:, 0], table.values[:, 0], rtol=1e-12)


def test_fresnel_strength_turns_one_schlick_curve_into_another() -> None:
    """Blinn's lobe has no Fresnel term and ks its albedo at normal incidence: strength 2 gives Schlick's ratio."""
    table = tabulate("blinn:exponent=2000,ks=0.3")
    stronger = fresnel(table, 2.0)
    f0 = albedo(split(table)[1], [1.0])[0, 0]
    assert f0 == pytest.approx(0.3, rel=0.01)
    rise = 0.7 * (1 - np.cos(table.theta_d)) ** 5
    np.testing.assert_allclose(
        stronger.values[0, :, 0] / table.values[0, :, 0], (0.3 + 2 * rise) / (0.3 + rise), rtol=0.01
    )
    flat = fresnel(tabulate("ggx:alpha=0.1,f0=0.1"), 0.0)
    constant = tabulate("ggx:alpha=0.1,f0=0.1").values[0, :, 0] / (
        1 + 9 * (1 - np.cos(np.minimum(table.theta_d, np.pi / 2))) ** 5
    )
    np.testing.assert_allclose(flat.values[0, :-1, 0] / constant[:-1], 1.0, atol=0.05)


# --- parts --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", [PLASTIC, GOLD, CHALK, "blinn:exponent=80,ks=0.2,kd=0.4/0.3/0.2"])
def test_the_parts_add_up_and_the_diffuse_one_is_the_base(spec: str) -> None:
    table = tabulate(spec)
    diffuse, specular = split(table)
    assert diffuse.values.min() >= 0 and specular.values.min() >= 0
    np.testing.assert_allclose(diffuse.values + specular.values, table.values, rtol=1e-15)
    if spec.startswith("blinn"):
        np.testing.assert_allclose(albedo(diffuse, [0.9])[0], [0.4, 0.3, 0.2], rtol=1e-3)
    if spec is CHALK:
        np.testing.assert_allclose(specular.values, 0.0, atol=1e-15)
    if spec is GOLD:
        assert (albedo(diffuse, [0.9]) < 0.05).all()


def test_values_that_are_not_measured_do_not_decide_the_floor() -> None:
    table = tabulate(CHALK)
    values, valid = table.values.copy(), np.ones(table.shape, np.bool_)
    values[60:, 20], valid[60:, 20] = 0.0, False
    diffuse = split(Bivariate.make(values, table.theta_h, table.theta_d, valid))[0]
    np.testing.assert_allclose(diffuse.values[:60], table.values[:60], rtol=1e-15)


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.5, 3.0])
@pytest.mark.parametrize("spec", [PLASTIC, GOLD])
def test_sharpening_keeps_the_energy_and_changes_the_width(spec: str, factor: float) -> None:
    table = tabulate(spec)
    for cosine in (1.0, table_parts.INCIDENCE, 0.3):
        after = sharpen(table, factor, cosine)
        np.testing.assert_allclose(albedo(after, [cosine]), albedo(table, [cosine]), rtol=1e-9)
    ratio = albedo(after, INCIDENCES) / albedo(table, INCIDENCES)
    print(f"{spec} × {factor}: {ratio.min():.4f} to {ratio.max():.4f}")
    assert ratio.min() > 0.985 and ratio.max() < 1.015, "nearly so at the other incidences"
    width = after.material().roughness / table.material().roughness
    assert width == pytest.approx(1 / factor, rel=0.15)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_sharpened_beckmann_lobe_is_one_of_scaled_slopes(factor: float) -> None:
    """exp(−tan² θ_h / m²) / cos⁴ θ_h over a floor that it leaves alone: m becomes m / factor."""
    h, d = np.linspace(0.0, 1.0, 401) ** 2 * np.pi / 2, merl_nodes()[1]

    def beckmann(m: float) -> np.ndarray:
        slope = np.tan(np.minimum(h, 1.57))
        return np.asarray(np.exp(-((slope / m) ** 2)) * (1 + slope**2) ** 2)

    floor = 0.05
    table = Bivariate.make(np.repeat((floor + beckmann(0.2))[:, None], d.size, axis=1), h, d)
    lobe = sharpen(table, factor).values[..., 0] - floor
    shape = lobe / lobe[0]  # each θ_d has its own level
    # Interpolated between 401 nodes: h² f'' / 8 of the peak.
    np.testing.assert_allclose(shape, np.repeat(beckmann(0.2 / factor)[:, None], d.size, axis=1), atol=1e-3)


def test_a_lobe_of_few_nodes_gets_more() -> None:
    table = tabulate("ggx:alpha=0.05,f0=0.9", np.linspace(0.0, 1.0, 25) ** 2 * np.pi / 2)
    after = sharpen(table, 4.0)
    assert after.shape[0] > table.shape[0] and after.shape[1] == table.shape[1]
    assert set(table.theta_h) <= set(after.theta_h)
    np.testing.assert_allclose(albedo(after, [0.8]), albedo(table, [0.8]), rtol=0.01)


@pytest.mark.parametrize("amount", [-1.0, -0.3, 0.3, 1.0])
def test_balance_moves_energy_between_the_parts(amount: float) -> None:
    table = tabulate(PLASTIC)
    after = balance(table, amount)
    np.testing.assert_allclose(
        albedo(after, [table_parts.INCIDENCE]), albedo(table, [table_parts.INCIDENCE]), rtol=1e-9
    )
    ratio = albedo(after, INCIDENCES) / albedo(table, INCIDENCES)
    print(f"{amount}: {ratio.min():.4f} to {ratio.max():.4f}")
    assert ratio.min() > 0.94 and ratio.max() < 1.06
    before, now = ([albedo(part, [0.8])[0, 0] for part in split(t)] for t in (table, after))
    giver = 0 if amount > 0 else 1
    assert now[giver] == pytest.approx((1 - abs(amount)) * before[giver], abs=0.02 * sum(before))


def test_what_has_no_specular_part_keeps_its_energy() -> None:
    table = tabulate(CHALK)
    np.testing.assert_allclose(balance(table, 0.5).values, table.values, rtol=1e-12)
    np.testing.assert_allclose(sharpen(table, 2.0).values, table.values, rtol=1e-12)
    one = Bivariate.make([[0.1]], [0.0], [0.0])
    for edit in EDITS.values():
        assert np.isfinite(edit(one).values).all()


# --- in scripts ---------------------------------------------------------------------------------------------


def test_a_table_is_edited_in_a_chain_and_saved(tmp_path: Path) -> None:
    gold = prtcl.Table.of(GOLD)
    made = gold.sharpened(0.5).tinted(0.9, 1.0, 1.0).blended(PLASTIC, 0.25).with_fresnel(1.2).conserved()
    assert made.energy <= 1.0 + 1e-12 and len(made.notes) >= len(gold.notes) + 4
    assert isinstance(made, Table) and (made.albedo([1.0])[0] > 0).all()
    made.save(tmp_path / "made.npz")
    back = Table.load(tmp_path / "made.npz")
    np.testing.assert_array_equal(back.bivariate.values, made.bivariate.values)
    assert Table.of(made) is made and Table.of(back.material()).bivariate.shape == made.bivariate.shape
    spot = gold.painted((0, 5), (60, 90), factor=0.0, softness=0.0).bivariate
    assert (spot.evaluate(np.radians([0.0, 3.0]), np.radians(75.0)) == 0).all()
    np.testing.assert_array_equal(spot.evaluate(0.5, 0.5), gold.bivariate.evaluate(0.5, 0.5))
    same = (
        gold.with_lobe(marginal_h(gold.bivariate)).with_fresnel_curve(marginal_d(gold.bivariate)).scaled(2.0)
    )
    np.testing.assert_allclose(same.balanced(0.0).bivariate.values, 2 * gold.bivariate.values, rtol=1e-9)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda t: scale(t, -1.0), "factor: expected a finite number of 0 or more, got -1"),
        (lambda t: scale(t, 1e308), "not finite any more"),
        (lambda t: tint(t, (1.0, math.nan, 1.0)), "rgb: expected three"),
        (lambda t: tint(t, (1.0, 1.0)), "rgb: expected three"),
        (lambda t: sharpen(t, 0.0), "factor: expected a number above 0"),
        (lambda t: balance(t, 1.5), "amount: expected from -1 to 1"),
        (lambda t: fresnel(t, -0.1), "strength: expected"),
        (lambda t: blend(t, t, math.nan), "t: expected from 0 to 1"),
        (lambda t: paint(t, (0, 1), (0, 1)), "either a factor or a value"),
        (lambda t: paint(t, (0, 1), (0, 1), factor=1, value=1), "either a factor or a value"),
        (lambda t: paint(t, (0, 1), (0, 1), value=(1, 2)), "one or three"),
        (lambda t: paint(t, (1, 0.5), (0, 1), factor=0), "theta_h: expected ascending"),
        (lambda t: paint(t, (0, 1), (0, 3), factor=0), "theta_d: expected ascending"),
        (lambda t: replace_theta_h(t, [1.0]), "curve: expected 91"),
        (lambda t: replace_fresnel(t, lambda d: d), "more than 0 at the smallest"),
        (lambda t: Table(t).painted((0, 1, 2), (0, 1), factor=0), "theta_h: expected two angles"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(edit: Callable[[Bivariate], Bivariate], message: str) -> None:
    with pytest.raises(InputError, match=message):
        edit(scale(tabulate(GOLD), 1e3))


def test_a_table_a_little_too_bright_is_scaled_to_an_energy_of_one() -> None:
    own = scale(tabulate("lambert:albedo=1"), 1.2)
    assert energy(own)[0] == pytest.approx(1.2, rel=1e-3)
    assert energy(conserve(own))[0] == pytest.approx(1.0, rel=1e-12)
    half = scale(own, 0.5)
    assert conserve(half) is half

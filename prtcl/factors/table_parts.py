"""A table's diffuse and specular part, and edits that know them apart: sharpen, balance, Fresnel.

`sharpen` and `balance` keep the energy: what a part must be multiplied by is solved for from albedos before and after
(`prtcl.factors.albedo`), for each channel, as a smooth curve over θ_d: with one number a narrowed metal would reflect
twice what it receives at grazing angles. At one stated incidence the albedo is kept to rounding, at the others nearly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors.albedo import INCIDENCES, albedo, columns
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.table_edit import Curve, at_nodes, edited, positive, projected, resample

FLOOR = 0.2
"""Share of the half vectors whose values lie below the diffuse floor: a minimum that noise does not decide, nor the
last degrees before grazing, where measured tables fall to 0. Of Spectralon's light 86 % then counts as diffuse, with a
quarter of this share 30 % (bench/table_parts.py)."""
INCIDENCE = math.cos(math.radians(30.0))
"""Cosine of the incidence at which the albedo is kept, where nothing else is said."""
STEPS = 60
"""Of the iteration that keeps the energy."""
ACROSS = 8
"""Fewest nodes between a lobe's peak and half of it after `sharpen`."""

Array = npt.NDArray[np.float64]


def split(table: Bivariate) -> tuple[Bivariate, Bivariate]:
    """The diffuse and the specular part; they add up to the table, and both are 0 or more.

    At each θ_d and in each channel the diffuse part is a floor: the value below which `FLOOR` of what is valid lies,
    weighed by sin θ_h cos θ_h dθ_h as half vectors are, or the value itself where that is less. A wide lobe's tail
    counts as diffuse; a Lambert table has no specular part. A θ_d with no valid node takes all that was filled in.
    """
    widths = projected(table.theta_h)
    floor = np.empty((1, *table.values.shape[1:]))
    for column in range(table.theta_d.size):
        valid = (
            table.valid[:, column] if table.valid[:, column].any() else np.ones(table.theta_h.size, np.bool_)
        )
        for channel in range(3):
            own = table.values[valid, column, channel]
            order = np.argsort(own, kind="stable")
            below = np.cumsum(widths[valid][order])
            floor[0, column, channel] = own[order][np.searchsorted(below, FLOOR * below[-1])]
    diffuse = np.minimum(table.values, floor)
    return edited(table, diffuse, "diffuse part"), edited(table, table.values - diffuse, "specular part")


def sharpen(table: Bivariate, factor: float, cosine: float = INCIDENCE) -> Bivariate:
    """The specular lobe made narrower (factor above 1) or wider (below), its albedo at one incidence kept.

    The slopes of the microfacets that the lobe tells of are divided by the factor k: tan θ' = k tan θ_h, near the peak
    the stretch of θ_h by k, and π/2 stays where it is. With the density of slopes P(tan θ) = D cos⁴ θ of a microfacet
    distribution (Walter et al. 2007, section 5), which keeps GGX a GGX, of α / k,

        s'(θ_h, θ_d) = g(θ_d) s(θ', θ_d) (cos θ' / cos θ_h)⁴,     cos θ_h / cos θ' = √(cos² θ_h + k² sin² θ_h)

    and g for each channel from the albedos before and after (`gain`). The nodes stay while `ACROSS` of them lie within
    half the lobe; else as many again are put into it.

    Parameters
    ----------
    factor : above 0; 1 changes nothing
    cosine : of the angle of incidence at which the albedo is kept

    Raises
    ------
    InputError
        If the factor is out of range.
    """
    if positive("factor", factor) == 0.0:
        raise InputError("factor: expected a number above 0, got 0")
    if factor == 1.0:
        return table
    table = _refined(table, factor)
    diffuse, specular = split(table)
    sine, cosine_h = factor * np.sin(table.theta_h), np.cos(table.theta_h)
    values = specular.evaluate(np.arctan2(sine, cosine_h)[:, None], table.theta_d[None, :])
    values /= ((cosine_h**2 + sine**2) ** 2)[:, None, None]
    narrowed = replace(specular, values=values)
    values = values * gain(narrowed, partial(albedo, specular), cosine)
    return edited(table, diffuse.values + values, f"lobe {factor:.4g} times as sharp")


def balance(table: Bivariate, amount: float, cosine: float = INCIDENCE) -> Bivariate:
    """Energy moved from the diffuse to the specular part (amount above 0) or back (below), the albedo kept.

    Parameters
    ----------
    amount : from −1 to 1, the share of the giving part's energy; the part that takes is scaled, so a channel of a table
        without that part stays as it is
    cosine : of the angle of incidence at which the albedo is kept
    """
    if not -1.0 <= amount <= 1.0:
        raise InputError(f"amount: expected from -1 to 1, got {amount}")
    if amount == 0.0:
        return table
    diffuse, specular = split(table)
    giver, taker = (diffuse, specular) if amount > 0.0 else (specular, diffuse)
    share = abs(amount)
    # A part of less than a ten-thousandth of the other is noise and rounding, and can take nothing.
    able = albedo(taker, cosine)[0] > 1e-4 * albedo(giver, cosine)[0]

    def wanted(cosines: npt.ArrayLike) -> Array:
        return np.where(able, albedo(taker, cosines) + share * albedo(giver, cosines), albedo(taker, cosines))

    values = giver.values * np.where(able, 1.0 - share, 1.0) + taker.values * gain(taker, wanted, cosine)
    where = "diffuse to specular" if amount > 0.0 else "specular to diffuse"
    return edited(table, values, f"{share:.4g} of the energy from {where}")


def gain(part: Bivariate, wanted: Callable[[npt.ArrayLike], Array], cosine: float) -> Array:
    """What a part must be multiplied by at each θ_d to have the albedo wanted: (nd, 3).

    A curve with knots at `INCIDENCES`, piecewise linear between them, for which the albedos there are nearest to those
    wanted; found by the multiplicative steps of Richardson and Lucy, which keep it above 0. What is then left at the
    stated incidence is taken off by one number.

    Parameters
    ----------
    wanted : (n,) cosines of incidence to (n, 3) albedos
    cosine : of the stated incidence
    """
    knots = np.arccos(INCIDENCES)
    hats = np.stack([np.interp(part.theta_d, knots, row) for row in np.eye(knots.size)])
    own = np.einsum("kd,ndc->nkc", hats, columns(part, INCIDENCES))
    target, curve = wanted(INCIDENCES), np.ones((knots.size, 3))
    for _ in range(STEPS):
        ratio = _over(target, (own * curve).sum(axis=1))
        curve *= _over(np.einsum("nkc,nc->kc", own, ratio), own.sum(axis=0))
    out = hats.T @ curve
    left = replace(part, values=part.values * out)
    return np.asarray(out * _over(wanted([cosine])[0], albedo(left, cosine)[0]))


def marginal_d(table: Bivariate) -> Array:
    """f_d(θ_d) of the specular part: its grey mean over θ_h of what is valid, 1/sr: (nd,).

    Weighed by sin θ_h cos θ_h dθ_h, as half vectors are in a microfacet distribution's norm.
    """
    specular = split(table)[1]
    weight = projected(table.theta_h)[:, None] * table.valid
    weight = np.where(weight.sum(axis=0) > 0.0, weight, projected(table.theta_h)[:, None])
    return np.asarray((weight * specular.values.mean(axis=2)).sum(axis=0) / weight.sum(axis=0))


def replace_fresnel(table: Bivariate, curve: Curve) -> Bivariate:
    """Another curve over θ_d for the specular part, its level at the smallest θ_d kept.

    The specular part is multiplied by c(θ_d) / c(θ_d,0) over f_d(θ_d) / f_d(θ_d,0), so that its marginal follows the
    curve. A reflectance's marginal also holds masking and 1 / cos² θ_d: f_d is F G / cos² θ_d for a microfacet lobe.

    Parameters
    ----------
    curve : (nd,) at the nodes, 0 or more and above 0 at the first; or a function of θ_d in radians

    Raises
    ------
    InputError
        If the curve is 0 at the first node or not of the nodes' length.
    """
    wanted, own = at_nodes("curve", curve, table.theta_d), marginal_d(table)
    if wanted[0] <= 0.0:
        raise InputError(f"curve: expected more than 0 at the smallest theta_d, got {wanted[0]:g}")
    ratio = _over(wanted / wanted[0] * own[0], own)
    return _specular_times(table, ratio[:, None], "Fresnel curve replaced")


def fresnel(table: Bivariate, strength: float) -> Bivariate:
    """The rise towards grazing angles strengthened or weakened: 1 changes nothing, 0 takes it away, 2 doubles it.

    The specular part is multiplied by (F0 + s (1 − F0)(1 − cos θ_d)⁵) / (F0 + (1 − F0)(1 − cos θ_d)⁵), Schlick's curve
    with F0 its albedo at normal incidence, at least 0.02 and at most 1, for each channel.

    Parameters
    ----------
    strength : s, 0 or more
    """
    if positive("strength", strength) == 1.0:
        return table
    f0 = np.clip(albedo(split(table)[1], 1.0)[0], 0.02, 1.0)
    rise = (1.0 - f0) * ((1.0 - np.cos(table.theta_d)) ** 5)[:, None]
    return _specular_times(table, (f0 + strength * rise) / (f0 + rise), f"Fresnel rise times {strength:.4g}")


def _specular_times(table: Bivariate, factor: Array, note: str) -> Bivariate:
    diffuse, specular = split(table)
    return edited(table, diffuse.values + specular.values * factor, note)


def _over(a: Array, b: Array) -> Array:
    """a / b, and 1 where b is nothing."""
    return np.divide(a, b, out=np.ones_like(b), where=b > 1e-300)


def _refined(table: Bivariate, factor: float) -> Bivariate:
    """The table on nodes that will have `ACROSS` within half the sharpened lobe, if there are that many now or not."""
    profile = table.values.mean(axis=(1, 2))
    fallen = np.flatnonzero(profile < 0.5 * profile[0])
    if not fallen.size or factor < 1.0:
        return table
    inside = table.theta_h <= table.theta_h[fallen[0]]
    if int((factor * table.theta_h <= table.theta_h[fallen[0]]).sum()) >= ACROSS:
        return table
    return resample(table, np.union1d(table.theta_h, table.theta_h[inside] / factor), table.theta_d)

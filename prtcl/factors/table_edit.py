"""Edits of bivariate tables that keep them whole: scale, tint, mix, paint, replace a curve.

Each takes a table and gives another: values stay 0 or more, the mask is kept, and a note says what was done. What an
edit does to the energy is told by `prtcl.factors.albedo`. Edits that know a diffuse and a specular part are in
`prtcl.factors.table_parts`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors.albedo import energy
from prtcl.factors.bivariate import Bivariate, interval

MOST = 512
"""Nodes of an axis that a mix of two tables may have; beyond them it takes the finer one's."""
SOFTNESS = 0.05

Array = npt.NDArray[np.float64]
Curve = npt.ArrayLike | Callable[[Array], npt.ArrayLike]
"""Values at a table's nodes, or a function of angles in radians."""


def edited(table: Bivariate, values: Array, note: str) -> Bivariate:
    """The table with other values on its nodes, and a note of what was done.

    Raises
    ------
    InputError
        If a value is no longer finite.
    """
    if not np.isfinite(values).all():
        raise InputError(f"{table.name}: {note}: values are not finite any more; change it by less")
    return replace(table, values=np.maximum(values, 0.0), notes=(*table.notes, f"{table.name}: {note}"))


def scale(table: Bivariate, factor: float) -> Bivariate:
    """All values times a factor, 0 or more."""
    with np.errstate(over="ignore"):  # `edited` tells
        values = table.values * positive("factor", factor)
    return edited(table, values, f"scaled by {factor:.4g}")


def tint(table: Bivariate, rgb: npt.ArrayLike) -> Bivariate:
    """Each channel times a factor of its own: three numbers, linear, 0 or more."""
    colour = np.asarray(rgb, np.float64)
    if colour.shape != (3,) or not np.isfinite(colour).all() or colour.min() < 0.0:
        raise InputError(f"rgb: expected three finite numbers of 0 or more, got {colour.tolist()}")
    return edited(table, table.values * colour, "tinted " + "/".join(f"{c:.4g}" for c in colour))


def conserve(table: Bivariate) -> Bivariate:
    """Scaled down to reflect no more than it receives, at any of the incidences of `energy`; itself where it does."""
    most = energy(table)[0]
    if most <= 1.0:
        return table
    return edited(table, table.values / most, f"scaled by {1 / most:.4g} to conserve energy")


def resample(table: Bivariate, theta_h: Array, theta_d: Array) -> Bivariate:
    """The same function on other nodes: exact where they hold all of its own. Valid where the nearest one is."""
    if np.array_equal(theta_h, table.theta_h) and np.array_equal(theta_d, table.theta_d):
        return table
    near = [
        low + (weight > 0.5)
        for low, weight in (interval(table.theta_h, theta_h), interval(table.theta_d, theta_d))
    ]
    values = table.evaluate(theta_h[:, None], theta_d[None, :])
    return replace(
        table,
        values=values,
        theta_h=theta_h,
        theta_d=theta_d,
        valid=table.valid[near[0][:, None], near[1][None, :]],
    )


def blend(a: Bivariate, b: Bivariate, t: float) -> Bivariate:
    """(1 − t) a + t b, on the nodes of both; valid where both are. a itself for t = 0, b for t = 1.

    Parameters
    ----------
    t : from 0 to 1

    Notes
    -----
    Bilinear interpolation on the nodes of both gives each back exactly, unless an axis would have more than `MOST`
    nodes: then the finer one's are taken, and the other is read there.
    """
    if not 0.0 <= t <= 1.0:
        raise InputError(f"t: expected from 0 to 1, got {t}")
    if t in (0.0, 1.0):
        return b if t else a
    h, d = _union(a.theta_h, b.theta_h), _union(a.theta_d, b.theta_d)
    first, second = resample(a, h, d), resample(b, h, d)
    mixed = replace(first, valid=first.valid & second.valid)
    return edited(mixed, (1 - t) * first.values + t * second.values, f"mixed with {t:.4g} of {b.name}")


def paint(
    table: Bivariate,
    theta_h: tuple[float, float],
    theta_d: tuple[float, float],
    *,
    factor: npt.ArrayLike | None = None,
    value: npt.ArrayLike | None = None,
    softness: float = SOFTNESS,
) -> Bivariate:
    """A rectangle of the table multiplied by a factor or set to a value, with a soft edge around it.

    Parameters
    ----------
    theta_h, theta_d : from and to, radians
    factor, value : one number or RGB, 0 or more (a value in 1/sr); one of the two
    softness : width of the edge, outside the rectangle, as a share of the axes √(θ_h / 90°) and θ_d / 90°

    Raises
    ------
    InputError
        If neither or both of factor and value are given, or a number is out of range.
    """
    if (factor is None) == (value is None):
        raise InputError("paint: expected either a factor or a value")
    colour = np.asarray(factor if value is None else value, np.float64)
    if colour.shape not in ((), (3,)) or not np.isfinite(colour).all() or colour.min() < 0.0:
        raise InputError(f"paint: expected one or three finite numbers of 0 or more, got {colour.tolist()}")
    soft = positive("softness", softness)
    for key, (low, high) in (("theta_h", theta_h), ("theta_d", theta_d)):
        if not 0.0 <= low <= high <= np.pi / 2 + 1e-6:
            raise InputError(
                f"{key}: expected ascending angles from 0 to pi/2 radians, got {low:g} and {high:g}"
            )
    axes = (_warped(table.theta_h), np.sqrt(np.divide(theta_h, np.pi / 2))), (
        table.theta_d / (np.pi / 2), np.divide(theta_d, np.pi / 2)
    )  # fmt: skip
    rows, columns = (_window(at, float(ends[0]), float(ends[1]), soft) for at, ends in axes)
    weight = (rows[:, None] * columns)[..., None]
    target = table.values * colour if value is None else np.broadcast_to(colour, table.values.shape)
    ranges = " and ".join(f"{np.degrees(low):.3g}-{np.degrees(high):.3g}" for low, high in (theta_h, theta_d))
    what = f"{'times' if value is None else 'set to'} {colour.tolist()}"
    return edited(table, table.values * (1 - weight) + target * weight, f"painted {ranges} degrees {what}")


def marginal_h(table: Bivariate) -> Array:
    """f_h(θ_h): the grey mean over θ_d of what is valid, 1/sr: (nh,).

    Weighed by sin θ_d cos θ_d dθ_d, as directions about a half vector are by the cosine to it.
    """
    weight = projected(table.theta_d) * table.valid
    # A row without a valid node is as good as it is filled in.
    weight = np.where(weight.sum(axis=1, keepdims=True) > 0.0, weight, projected(table.theta_d))
    return np.asarray((weight * table.values.mean(axis=2)).sum(axis=1) / weight.sum(axis=1))


def replace_theta_h(table: Bivariate, curve: Curve) -> Bivariate:
    """The table with another curve over θ_h: f̃ times curve / f_h, after which `marginal_h` is the curve.

    A table is about f_h(θ_h) f_d(θ_d); what it is besides, and its colour, stays. Where f_h is 0 there is nothing to
    multiply, and the values become the curve's.

    Parameters
    ----------
    curve : (nh,) grey values at the nodes, 1/sr, 0 or more; or a function of θ_h in radians
    """
    own, wanted = marginal_h(table), at_nodes("curve", curve, table.theta_h)
    gain = np.divide(wanted, own, out=np.zeros_like(own), where=own > 0.0)[:, None, None]
    values = np.where((own > 0.0)[:, None, None], table.values * gain, wanted[:, None, None])
    return edited(table, values, "θ_h curve replaced")


def at_nodes(name: str, curve: Curve, nodes: Array) -> Array:
    """A curve's values (n,) at nodes, checked."""
    values = np.asarray(curve(nodes) if callable(curve) else curve, np.float64)
    if values.shape != nodes.shape or not np.isfinite(values).all() or values.min() < 0.0:
        raise InputError(
            f"{name}: expected {nodes.size} finite numbers of 0 or more, got shape {values.shape}"
        )
    return values


def positive(name: str, value: float) -> float:
    """A finite number of 0 or more."""
    if not (np.isfinite(value) and value >= 0.0):
        raise InputError(f"{name}: expected a finite number of 0 or more, got {value}")
    return float(value)


def _union(a: Array, b: Array) -> Array:
    both = np.union1d(a, b)
    return both if both.size <= MOST else max(a, b, key=len)


def _warped(theta_h: Array) -> Array:
    return np.asarray(np.sqrt(np.clip(theta_h / (np.pi / 2), 0.0, 1.0)))


def _window(at: Array, low: float, high: float, soft: float) -> Array:
    """1 from low to high, falling to 0 as 3 x² − 2 x³ over `soft` to either side."""
    outside = np.maximum(low - at, at - high)
    x = np.where(outside <= 0.0, 1.0, np.clip(1.0 - outside / max(soft, 1e-12), 0.0, 1.0))
    return np.asarray(x * x * (3 - 2 * x))


def projected(nodes: Array) -> Array:
    """sin θ cos θ dθ of each node's share of the axis, which is never 0."""
    if nodes.size == 1:
        return np.ones(1)
    edges = np.concatenate([[0.0], (nodes[1:] + nodes[:-1]) / 2, [np.pi / 2]])
    return np.maximum(np.diff(np.sin(edges) ** 2) / 2, 1e-12)

"""Directional albedo of a bivariate table, by a quadrature that is linear in the table's values.

For an incident direction i the reflected energy is an integral over the half vector h = (θ_h, φ_h), since
dω_o = 4 cos θ_d dω_h (Walter et al. 2007, equation 14 with both factors for reflection):

    A(θ_i) = ∫ f̃(θ_h, θ_d) cos θ_o 4 cos θ_d sin θ_h dθ_h dφ_h,
    cos θ_d = cos θ_i cos θ_h + sin θ_i sin θ_h cos φ_h,      cos θ_o = 2 cos θ_d cos θ_h − cos θ_i

over where cos θ_o > 0, which is |φ_h| below an angle known in closed form. A lobe sits at θ_h = 0 whatever θ_i is, so
Gauss's rule between the table's own nodes of θ_h sees the sharpest of them. f̃ is bilinear in its values, and A a sum
of them with weights that the nodes alone decide: these are kept, and an edit costs one inner product.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors.bivariate import Bivariate, interval

INCIDENCES = tuple(math.cos(math.radians(angle)) for angle in (0, 10, 20, 30, 40, 50, 60, 65, 70, 75, 80, 85))
"""Cosines at which `energy` looks for the most. Beyond 85 degrees a table's last interval of θ_d says little."""
COARSEST = math.radians(2.0)
"""The widest interval of θ_h that one rule takes."""
GAUSS_H, GAUSS_PHI = 4, 48
"""Points of Gauss's rule in each interval of θ_h, and over φ_h. Against rules of twice as many points in each, tables
of GGX with α from 0.02 to 1 change by 3e-5 of their albedo at most (tests/test_albedo.py)."""

Array = npt.NDArray[np.float64]


def albedo(table: Bivariate, cosines: npt.ArrayLike) -> Array:
    """Share of the light from given incidences that a table reflects: (n, 3) float64.

    Parameters
    ----------
    cosines : (n,) of the angle of incidence, above 0 and up to 1

    Raises
    ------
    InputError
        If a cosine is out of range.
    """
    wanted = np.atleast_1d(np.asarray(cosines, np.float64))
    if wanted.ndim != 1 or not ((wanted > 0.0) & (wanted <= 1.0)).all():
        raise InputError(f"cosines: expected a list of numbers above 0 and up to 1, got {wanted.tolist()}")
    rows = _weights(table.theta_h.tobytes(), table.theta_d.tobytes(), tuple(wanted.tolist()))
    return np.asarray(rows @ table.values.reshape(-1, 3))


def columns(table: Bivariate, cosines: tuple[float, ...]) -> Array:
    """What each θ_d adds to the albedo at given incidences: (n, nd, 3), whose sum over θ_d is `albedo`."""
    rows = _weights(table.theta_h.tobytes(), table.theta_d.tobytes(), cosines)
    return np.einsum("nhd,hdc->ndc", rows.reshape(-1, *table.shape), table.values)


def energy(table: Bivariate) -> tuple[float, float, int]:
    """The largest albedo over `INCIDENCES` and channels, with its cosine of incidence and its channel."""
    found = albedo(table, INCIDENCES)
    at, channel = np.unravel_index(int(found.argmax()), found.shape)
    return float(found[at, channel]), INCIDENCES[at], int(channel)


def half_rule(
    nodes: Array, cosine: float, gauss_h: int = GAUSS_H, gauss_phi: int = GAUSS_PHI
) -> tuple[Array, Array, Array]:
    """Points and weights of the integral above: θ_h (n, 1), cos φ_h (n, m), and weights (n, m), cosines included.

    Parameters
    ----------
    nodes : of θ_h, radians, where f may have kinks
    cosine : of the angle of incidence
    """
    theta_i = math.acos(cosine)
    # Where the outgoing direction meets the horizon in the plane of incidence: there the range of φ_h has kinks.
    kinks = [(math.pi / 2 - theta_i) / 2, (math.pi / 2 + theta_i) / 2]
    top = kinks[1]
    plain = np.linspace(0.0, top, math.ceil(top / COARSEST) + 1)
    edges = np.unique(np.concatenate([plain, kinks, nodes[nodes < top]]))
    edges = edges[np.append(True, np.diff(edges) > 1e-12)]
    at, weight = np.polynomial.legendre.leggauss(gauss_h)
    width = np.diff(edges)[:, None]
    h = (edges[:-1, None] + width * (at + 1) / 2).reshape(-1, 1)
    dh = (width * weight / 2).reshape(-1, 1)
    cos_h, sin_h, sine = np.cos(h), np.sin(h), math.sqrt(1.0 - cosine**2)
    with np.errstate(divide="ignore"):
        limit = np.arccos(np.clip(cosine * (0.5 / cos_h - cos_h) / (sine * sin_h), -1.0, 1.0))
    at, weight = np.polynomial.legendre.leggauss(gauss_phi)
    cos_phi = np.cos(limit * (at + 1) / 2)
    cos_d = cosine * cos_h + sine * sin_h * cos_phi
    cos_o = np.maximum(2 * cos_d * cos_h - cosine, 0.0)
    # Both signs of φ_h.
    return h, cos_phi, 2 * dh * sin_h * (limit * weight / 2) * cos_o * 4 * cos_d


@lru_cache(maxsize=32)
def _weights(theta_h: bytes, theta_d: bytes, cosines: tuple[float, ...]) -> Array:
    """What each of a table's values counts for at each incidence: (n, nh nd)."""
    h_nodes, d_nodes = np.frombuffer(theta_h), np.frombuffer(theta_d)
    return np.stack([_row(h_nodes, d_nodes, cosine) for cosine in cosines])


def _row(h_nodes: Array, d_nodes: Array, cosine: float) -> Array:
    h, cos_phi, weight = half_rule(h_nodes, cosine)
    sine = math.sqrt(1.0 - cosine**2)
    theta_d = np.arccos(np.clip(cosine * np.cos(h) + sine * np.sin(h) * cos_phi, -1.0, 1.0))
    (i, wi), (j, wj) = interval(h_nodes, h), interval(d_nodes, theta_d)
    i1, j1 = np.minimum(i + 1, h_nodes.size - 1), np.minimum(j + 1, d_nodes.size - 1)
    out = np.zeros(h_nodes.size * d_nodes.size)
    corners: tuple[tuple[Any, Any, Any], ...] = (
        (i, j, (1 - wi) * (1 - wj)), (i, j1, (1 - wi) * wj), (i1, j, wi * (1 - wj)), (i1, j1, wi * wj),
    )  # fmt: skip
    for row, column, share in corners:
        at = np.broadcast_to(row * d_nodes.size + column, weight.shape)
        out += np.bincount(at.ravel(), (share * weight).ravel(), out.size)
    return out

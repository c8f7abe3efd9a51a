"""Rounding errors that theory allows: every bound of the package, from precision, depth and norm.

u is the unit roundoff: 2⁻²⁴ in float32, 2⁻⁵³ in float64. `mixed` stores float32 and works in float64.
First-order terms only: k roundings one after another are counted as k u, the k² u² beside it is below a
thousandth of that.

A sum of products in which no term passes more than k roundings has |error| ≤ k u Σ |term| (Higham, Accuracy
and Stability of Numerical Algorithms, section 3.1): the bounds below count k for each algorithm, whatever its
order of summation within k, with or without fused multiply-adds.

The tests and `prtcl stress` hold the kernels to these.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl import quadtree

Array = npt.NDArray[np.float64]

STORED = {"float32": 2.0**-24, "mixed": 2.0**-24, "float64": 2.0**-53}
"""u of what buffers hold, by precision."""
SUMMED = {"float32": 2.0**-24, "mixed": 2.0**-53, "float64": 2.0**-53}
"""u of what sums and products are taken in, by precision."""


def norms(rows: npt.ArrayLike) -> Array:
    """2-norm of every row, kept as a last axis of 1."""
    return np.linalg.norm(np.asarray(rows, dtype=np.float64), axis=-1, keepdims=True)


def haar(levels: int, u: float, values: npt.ArrayLike) -> Array:
    """‖error‖₂ of the forward or the inverse transform: 2 levels u ‖x‖₂, for each row.

    A level is two orthogonal steps, columns then rows, each of which rounds every one of its results once: a
    relative error of u in every component, so u ‖x‖₂ in norm, and an orthogonal step passes errors on
    unchanged. The halves are exact.
    """
    return 2 * levels * u * norms(values)


def triple_magnitude(a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
    """Σ_jk |C_ijk| |a_j| |b_k| by the tree of kernels/triple.cl with every sign made +: (..., 4**levels)."""
    a, b = np.broadcast_arrays(np.abs(np.asarray(a, np.float64)), np.abs(np.asarray(b, np.float64)))
    levels = quadtree.levels_of(a.shape[-1])
    lead = a.shape[:-1]

    def level_of(x: Array, r: int) -> Array:
        return x[..., 4**r : 4 ** (r + 1)].reshape(*lead, 4**r, 3)

    def sums(x: Array) -> list[Array]:
        here = 2.0**-levels * x[..., :1]
        out = [here]
        for r in range(levels - 1):
            here = np.repeat(here + 2.0 ** (r - levels) * level_of(x, r).sum(axis=-1), 4, axis=-1)
            out.append(here)
        return out

    sums_a, sums_b = sums(a), sums(b)
    below = np.zeros((*lead, 4 ** max(0, levels - 1)))
    out = np.zeros(a.shape)
    for r in reversed(range(levels)):
        la, lb = level_of(a, r), level_of(b, r)
        own = 2.0 ** (r - levels)
        cross = sum(np.roll(la, -i, -1) * np.roll(lb, -j, -1) for i, j in ((1, 2), (2, 1)))
        row = own * (cross + below[..., None]) + la * sums_b[r][..., None] + lb * sums_a[r][..., None]
        out[..., 4**r : 4 ** (r + 1)] = row.reshape(*lead, -1)
        energy = (la * lb).sum(axis=-1) + below
        below = energy.reshape(*lead, -1, 4).sum(axis=-1) if r else energy
    out[..., 0] = 2.0**-levels * (a[..., 0] * b[..., 0] + below[..., 0])
    return out


def triple(a: npt.ArrayLike, b: npt.ArrayLike, precision: str) -> Array:
    """|error| of every coefficient of a ⊕ b through the tree, inputs taken as exact.

    A term reaches its coefficient either through the parent sums, two additions a level, or through the sums
    of E, three additions a level (two of the butterfly, one with the square's own). Its products and the last
    sum cost six more (two products, three additions, the store): k = 3 levels + 6. In `mixed` these round in
    float64 and only the store in float32: u |result| besides.
    """
    magnitude = triple_magnitude(a, b)
    levels = quadtree.levels_of(magnitude.shape[-1])
    stored = STORED[precision] if precision == "mixed" else 0.0
    return (stored + (3 * levels + 6) * SUMMED[precision]) * magnitude


def dot(terms: npt.ArrayLike, roundings: int, precision: str) -> Array:
    """|error| of sums over the last axis of `terms`, each of which passes k = `roundings`: k u Σ |term|.

    The scale, an argument in the stored precision, and the store add 2 u of that.
    """
    total = np.abs(np.asarray(terms, dtype=np.float64)).sum(axis=-1)
    return np.asarray((roundings * SUMMED[precision] + 2 * STORED[precision]) * total)


def inner_product(terms: npt.ArrayLike, keep: int, group: int, n_slices: int, precision: str) -> Array:
    """|error| of kernels/shade.cl: `terms` are scale · weight · c_j · f_j along the last axis, slices and j.

    A work-item adds 4**keep / group terms, the group a tree of log2(group); before that a slice sum of
    n_slices products, the product with c, and afterwards the scale (itself rounded), the store: + n_slices +
    5.
    """
    per_item = -(-(4**keep) // group)
    return dot(terms, per_item + int(np.log2(group)) + n_slices + 5, precision)


def inner_product_plain(terms: npt.ArrayLike, keep: int, n_slices: int, precision: str) -> Array:
    """|error| of the plain twin, which adds its n_slices · 4**keep terms one after another."""
    return dot(terms, n_slices * 4**keep + 5, precision)


def masked_average(samples: npt.ArrayLike, levels: int, keep: int, precision: str) -> Array:
    """‖error‖₂ of the pixel-domain product's coefficients: rows of 4**levels samples of light that pass.

    A cell's average adds 4**(levels − keep) terms of one sign's worth each: relative to the average of their
    magnitudes 4**(levels − keep) u_sum + u_store, hence the same of the norm of the magnitudes' averages,
    which is at most 2^(keep − levels) ‖x‖₂; scaled back by 2^(levels − keep). The transform adds 2 keep u.
    """
    run = 4 ** (levels - keep)
    own = (run if run > 1 else 0) * SUMMED[precision] + STORED[precision]
    return (own + 2 * keep * STORED[precision]) * norms(samples)


def brdf(
    kind: str, lobe: npt.ArrayLike, diffuse: npt.ArrayLike, u: float, amplification: npt.ArrayLike = 0.0
) -> Array:
    """|error| of f on the device, for directions that are the same numbers on both sides.

    Parameters
    ----------
    lobe : f's glossy part with F = 1 (for Blinn with ks = 1); diffuse : kd/π
    amplification : for Blinn n/2 tan²θ_h

    The half vector's components have a relative error of 4 u: a sum that is exact where it cancels
    (Sterbenz), a square root and a division. The denominator of D is a sum of positive squares: 12 u, squared
    24 u; two Smith terms of at most 8 u each; a2, 1/π, 1/4 and six products: 64 u holds them all. Fresnel's
    exact form loses at most 32 u of 1 to cancellation, so it counts absolutely, with F = 1: 96 u together.

    Blinn's (1 − s)^(n/2), s = sin²θ_h good to 10 u, moves by n/2 · 10 u s/(1 − s) = 10 u n/2 tan²θ_h;
    OpenCL's exp, exp2 and log1p are good to 3 ulp = 6 u, log1p of an exponent that is below that
    amplification too: 16 u of it.
    """
    glossy, base = np.asarray(lobe, dtype=np.float64), np.asarray(diffuse, dtype=np.float64)
    if kind == "lambert":
        return np.asarray(4 * u * base)
    if kind == "blinn":
        return np.asarray((48 + 16 * np.asarray(amplification, dtype=np.float64)) * u * glossy + 4 * u * base)
    return np.asarray(96 * u * glossy + 16 * u * base)


def table_lookup(
    values: npt.ArrayLike, theta_h: npt.ArrayLike, theta_d: npt.ArrayLike, u: float, cos_d: npt.ArrayLike
) -> Array:
    """|error| of a bivariate table's interpolation, for each pair: slopes times the angles' errors.

    The device's angles come from atan2 (6 ulp = 12 u) of sines and cosines good to 6 u: at most 20 u · π/2.
    The reference takes arccos of a cosine, which near 0 turns 2⁻⁵³ into √(2 · 2⁻⁵³) = 1.5e-8, twice that for
    a half vector's rounding. Directions stored in the device's precision are unit vectors to 2 u only, which
    atan2 does not see and arccos does: min(2 u cot θ_d, 2 √u). Nodes are rounded when stored: u · π/2. The
    interpolation itself rounds 8 times.
    """
    table = np.asarray(values, dtype=np.float64)
    cosine = np.asarray(cos_d, dtype=np.float64)
    sine = np.sqrt(np.maximum(1 - cosine**2, 1e-30))
    angle = 22 * u * np.pi / 2 + 4e-8
    lengths = np.minimum(2 * u * cosine / sine, 2 * np.sqrt(u))
    out = np.full(cosine.shape, 8 * u * float(np.abs(table).max()))
    for axis, nodes in enumerate((theta_h, theta_d)):
        nodes = np.asarray(nodes, dtype=np.float64)
        if nodes.size > 1:
            steps = np.diff(nodes).reshape([-1 if i == axis else 1 for i in range(table.ndim)])
            slope = float(np.abs(np.diff(table, axis=axis) / steps).max())
            out = out + slope * (angle + lengths * (axis == 1))
    return out


def measured_lookup(
    values: npt.ArrayLike,
    theta_h: npt.ArrayLike,
    theta_d: npt.ArrayLike,
    u: float,
    at: tuple[Array, Array],
    share: npt.ArrayLike,
) -> Array:
    """|error| of a three-angle table's interpolation, for each pair: what weights may move by, times f's range.

    Parameters
    ----------
    at : θ_h and θ_d of the pairs
    share : Σ w m, the part of the weights that is on measured samples; f divides by it

    On the device |i + o| and |i − o| are good to 6 u and atan2 to 6 ulp = 12 u, so θ_h and θ_d have a relative error
    of 24 u, √θ_h half of it and 6 u of its own root. The turn's two components are off by 10 u of their length, so
    φ_d by 10 u + 12 u π: 50 u. In the device's precision directions can be made unit vectors to 2 u only, so
    i − o and i + o are not quite at right angles: (|i|² − |o|²)/|i + o|, up to 4 u/cos θ_d, of i − o lies along the
    half vector. It moves θ_d by as much, and φ_d by that over i − o's part across the normal, 2 sin θ_h sin θ_d. A
    weight's change of ε changes f by no more than ε times its range. Nodes are rounded when stored, u π/2, as are the
    numbers: 12 u of the largest with the products and the sum.
    """
    table = np.asarray(values, dtype=np.float64)
    h, d = at
    roots, nodes = np.sqrt(np.asarray(theta_h, dtype=np.float64)), np.asarray(theta_d, dtype=np.float64)
    steps = [float(np.diff(n).min()) if n.size > 1 else np.inf for n in (roots, nodes)]
    along = 4 * u / np.maximum(np.cos(d), 1e-300)
    place_h, place_d = 20 * u * np.sqrt(np.pi / 2), 24 * u * np.pi / 2 + along
    across = np.maximum(2 * np.sin(h) * np.sin(d), 1e-300)
    turn = (50 * u + along / across) * table.shape[2] / np.pi
    spread = float(table.max() - table.min())
    moved = place_h / steps[0] + np.minimum(1.0, place_d / steps[1]) + np.minimum(1.0, turn)
    return (spread * moved + 12 * u * float(table.max())) / np.asarray(share)

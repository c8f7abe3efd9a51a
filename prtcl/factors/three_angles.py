"""Rusinkiewicz's three angles of a pair of directions, and the table over them as it is looked up.

The table is kept homogeneous, as four numbers a sample: m·f for the channels, and the weight m itself. Interpolating
all four linearly and dividing is interpolation with the weights renormalised over the samples that count:

    f = Σ w m f / Σ w m,   m = 1 for a measured sample, `FILLED` for one that was filled in

A filled sample counts for nothing beside a measured one (a millionth), yet where there is no other, f is neither black
nor 0/0, and f stays continuous.

Nodes are bin centres; below the first and beyond the last the thetas are clamped, as readers of MERL's data do. At
θ_d = 0, where the two directions are one and φ_d says nothing, and at θ_h = 0, where there is no tangent to count it
from, f is that of the first node at φ_d = 0 as `atan2` has it: one value of several, finite.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

FILLED = 2.0**-20
"""Weight of a sample that was filled in, beside 1 of a measured one. A power of two: exact in every precision."""

Array = npt.NDArray[np.float64]


def angles(incident: npt.ArrayLike, outgoing: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """θ_h, θ_d in [0, π/2] and φ_d in (−π, π] of pairs of unit directions, (..., 3) in the frame of the normal.

    With s = i + o and δ = i − o, which are at right angles::

        θ_d = atan2(|δ|, |s|)         θ_h = atan2(|s_xy|, s_z)
        φ_d = atan2(s_x δ_y − s_y δ_x, −|s| δ_z)

    δ is twice i's part across the half vector; its part along the tangent of increasing θ_h is −δ_z / sin θ_h. So no
    angle is taken from a rotated vector, and none loses figures where the directions nearly agree.
    """
    # Vectors of float32 are of unit length to 1e-7 only, and s and δ then not quite at right angles.
    given = (np.asarray(d, np.float64) for d in (incident, outgoing))
    i, o = np.broadcast_arrays(*(d / np.linalg.norm(d, axis=-1, keepdims=True) for d in given))
    total, across = i + o, i - o
    length = np.linalg.norm(total, axis=-1)
    theta_h = np.arctan2(np.hypot(total[..., 0], total[..., 1]), total[..., 2])
    theta_d = np.arctan2(np.linalg.norm(across, axis=-1), length)
    turn = total[..., 0] * across[..., 1] - total[..., 1] * across[..., 0]
    return theta_h, theta_d, np.arctan2(turn, -length * across[..., 2])


def entries(table: Mapping[str, npt.NDArray[np.float64]]) -> tuple[Array, Array, Array]:
    """The homogeneous table.

    Parameters
    ----------
    table : values (nh, nd, np, 3), valid (nh, nd, np) with 1 for a measured sample, theta_h (nh,), theta_d (nd,)

    Returns
    -------
    roots : (nh,) √θ_h of the nodes; nodes : (nd,) θ_d
    weighted : (nh, nd, np, 4) float64: m·f and m
    """
    weight = np.where(table["valid"] > 0, 1.0, FILLED)[..., None]
    weighted = np.concatenate([table["values"] * weight, weight], axis=-1)
    return np.sqrt(table["theta_h"]), table["theta_d"], weighted

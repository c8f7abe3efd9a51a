"""What float64 says: the only module of the stress cases that imports `prtcl.reference`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl import bounds, quadtree
from prtcl import reference as reference
from prtcl.factors.material import Material

Array = npt.NDArray[np.float64]

OWN = 2.0**-53
"""The unit roundoff of these answers themselves."""


def brdf(material: Material, incident: npt.ArrayLike, outgoing: npt.ArrayLike) -> Array:
    """f (n, 3) of pairs of local directions."""
    return np.asarray(
        reference.brdf(
            material.reference(),
            np.asarray(incident, dtype=np.float64),
            np.asarray(outgoing, dtype=np.float64),
        )
    )


def brdf_bound(m: Material, i: Array, o: Array, u: float) -> Array:
    """|error| of f on a device of unit roundoff `u` against `brdf`: `bounds.brdf`, and what float64 itself loses.

    Parameters
    ----------
    i, o : (n, 3) local directions, the same numbers on both sides

    Returns
    -------
    bound : broadcasts against (n, 3)
    """
    if m.table is not None:
        _, cos_d = reference.half_angles(i, o)
        return bounds.table_lookup(**m.table, u=u, cos_d=cos_d)[:, None]
    cos_h, _ = reference.half_angles(i, o)
    diffuse = np.broadcast_to(np.asarray(m.numbers.get("kd", m.numbers.get("albedo", 0.0))) / np.pi, (1, 3))
    if m.kind == "lambert":
        return bounds.brdf("lambert", 0.0, diffuse, u)
    if m.kind == "blinn":
        n = m.numbers["exponent"]
        lobe = reference.brdf({"kind": "blinn", "exponent": n, "ks": 1.0}, i, o)
        tan2 = (1 - cos_h**2) / np.maximum(cos_h, 1e-9) ** 2
        # cos^n moves by n u of the cosine in the reference.
        # An exponential below the smallest normal number may become 0.
        tiny = float(np.finfo(np.float32 if u > 1e-10 else np.float64).tiny) * (n + 6)
        return bounds.brdf("blinn", lobe, diffuse, u, (n / 2 * tan2)[:, None]) + 8 * n * OWN * lobe + tiny
    alpha = m.numbers["alpha"]
    lobe = reference.brdf({"kind": "ggx", "alpha": alpha, "f0": 1.0}, i, o)
    # The reference's sin² = 1 − cos² errs by 8 u of 1 (cos is good to 4 u), in a denominator that is squared.
    denominator = cos_h**2 * alpha**2 + (1 - cos_h**2)
    return bounds.brdf("ggx", lobe, diffuse, u) + lobe * (16 * OWN / denominator)[:, None]


def ggx_albedo(alpha: float, view: npt.ArrayLike) -> float:
    """∫ f cos of GGX with f0 = 1: over half-vectors, stratified by the density D cos, 400 × 256 of them.

    With dω_i = 4 (o·h) dω_h what is left of f cos is G1(i) G1(o) (o·h) / (cos_o cos_h), smooth however sharp the lobe.
    """
    own = np.asarray(view, dtype=np.float64)
    u, phi = (np.arange(400) + 0.5)[:, None] / 400, (np.arange(256) + 0.5) * 2 * np.pi / 256
    cos_h = 1 / np.sqrt(1 + alpha**2 * u / (1 - u))
    sin_h = np.sqrt(1 - cos_h**2)
    h = np.stack([sin_h * np.cos(phi), sin_h * np.sin(phi), cos_h + 0 * phi], axis=-1)
    along = h @ own
    incident = 2 * along * h[..., 2] - own[2]  # its cosine
    seen = (along > 0) & (incident > 0)
    shadowing = reference.smith_g1(np.where(seen, incident, 1.0), alpha) * reference.smith_g1(own[2], alpha)
    return float(np.where(seen, shadowing * along / (own[2] * cos_h), 0.0).mean())


def means(samples: npt.ArrayLike) -> Array:
    """Means over the squares of levels 0 … levels, coarse to fine: (..., n_squares(levels + 1))."""
    values = np.asarray(samples, dtype=np.float64)
    levels = quadtree.levels_of(values.shape[-1])
    return np.concatenate(
        [values.reshape(*values.shape[:-1], 4**r, -1).mean(axis=-1) for r in range(levels + 1)], -1
    )

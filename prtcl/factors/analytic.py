"""Any material's f in float64 on the host, where a table is made of it; pictures are made by kernels/brdf.clh.

The forms are those of kernels/brdf.clh (Walter et al. 2007 for GGX and Smith's masking, Schlick's and the exact
conductor's Fresnel terms, glTF 2.0's diffuse base, normalised Blinn). Sines come from the components, so that lobes of
α = 0.001 keep their shape.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl.factors.bivariate import Bivariate
from prtcl.factors.material import Material
from prtcl.factors.measured import Measured

Array = npt.NDArray[np.float64]


def evaluate(material: Material, incident: Array, outgoing: Array) -> Array:
    """f in 1/sr, RGB, without the cosine; 0 where either direction is at or below the horizon.

    Parameters
    ----------
    incident, outgoing : (..., 3) unit, in the frame of the normal, z up; they broadcast

    Returns
    -------
    f : (..., 3) float64
    """
    incident, outgoing = np.broadcast_arrays(incident, outgoing)
    above = (incident[..., 2] > 0.0) & (outgoing[..., 2] > 0.0)
    half = incident + outgoing
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-300)
    sin_h, cos_h = np.hypot(half[..., 0], half[..., 1]), np.minimum(half[..., 2], 1.0)
    cos_d = np.clip(np.sum(half * outgoing, axis=-1), 0.0, 1.0)
    numbers = material.numbers
    kd = np.asarray(numbers.get("kd", 0.0)) * np.ones(3)
    if material.kind == "lambert":
        f = np.asarray(numbers["albedo"]) / np.pi * np.ones((*above.shape, 1))
    elif material.kind == "table":
        sin_d = np.linalg.norm(np.cross(half, outgoing), axis=-1)
        assert material.table is not None
        own = Bivariate.make(*(material.table[key] for key in ("values", "theta_h", "theta_d")))
        f = own.evaluate(np.arctan2(sin_h, cos_h), np.arctan2(sin_d, cos_d))
    elif material.kind == "measured":
        f = Measured.of(material).evaluate(incident, outgoing)
    elif material.kind == "blinn":
        n = float(numbers["exponent"])
        norm = (n + 2) * (n + 4) / (8 * np.pi * (n + 2.0 ** (-n / 2)))
        # (n·h)^n as (1 − sin²)^(n/2) near the peak, where a large exponent magnifies the rounding of n·h.
        near = 0.5 * np.log1p(-np.minimum(sin_h**2, 0.5))
        log_cos = np.where(sin_h**2 < 0.5, near, np.log(np.maximum(cos_h, 1e-300)))
        f = (norm * np.exp(n * log_cos))[..., None] * np.asarray(numbers["ks"]) + kd / np.pi
    else:
        alpha = float(numbers["alpha"])
        lobe = alpha**2 / (4 * np.pi * (cos_h**2 * alpha**2 + sin_h**2) ** 2)
        for cosine in (incident[..., 2], outgoing[..., 2]):
            lobe = lobe * _smith_over_cosine(np.where(above, cosine, 1.0), alpha)
        grazing = (1.0 - cos_d[..., None]) ** 5
        if material.kind == "ggx-conductor":
            fresnel = _conductor(cos_d[..., None], np.asarray(numbers["eta"]), np.asarray(numbers["k"]))
        else:
            f0 = np.asarray(numbers["f0"])
            fresnel = f0 + (1.0 - f0) * grazing
        f = lobe[..., None] * fresnel + kd * (0.96 - 0.96 * grazing) / np.pi
    return np.asarray(np.where(above[..., None], f, 0.0))


def _smith_over_cosine(cosine: Array, alpha: float) -> Array:
    """G1(c) / c = 2 / (c + √(c² + α² s²)), finite at grazing angles."""
    return np.asarray(2.0 / (cosine + np.sqrt(cosine**2 + alpha**2 * (1.0 - cosine**2))))


def _conductor(cosine: Array, eta: Array, k: Array) -> Array:
    """Unpolarised reflectance of a conductor in real arithmetic, as kernels/brdf.clh has it."""
    c2 = cosine**2
    s2 = 1.0 - c2
    t = (eta - 1.0) * (eta + 1.0) - k**2 + c2
    modulus = np.sqrt(t**2 + 4 * eta**2 * k**2)
    a = np.sqrt(np.maximum(0.5 * (modulus + t), 0.0))
    rs = (modulus + c2 - 2 * a * cosine) / np.maximum(modulus + c2 + 2 * a * cosine, 1e-300)
    rp = (c2 * modulus + s2**2 - 2 * a * cosine * s2) / np.maximum(
        c2 * modulus + s2**2 + 2 * a * cosine * s2, 1e-300
    )
    return np.asarray(0.5 * rs * (1.0 + rp))

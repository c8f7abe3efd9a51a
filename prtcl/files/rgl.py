"""EPFL RGL's .bsdf: an isotropic BRDF in the adaptive parameterisation of Dupuy and Jakob (2018).

What the fields mean and how f follows from them: `prtcl.factors.adaptive`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.files.tensor_file import read_tensors

EXTENSION = ".bsdf"
Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AdaptiveTables:
    """The fields of an isotropic .bsdf.

    Attributes
    ----------
    theta_i : (t,) float64, radians, ascending
    ndf, sigma : (a, b) float64, over (φ, θ) of the half vector and of the incident direction, each on [0, 1]
    vndf : (f, t, c, d) float64, density of visible normals for each incident direction, over (φ, θ); f is 1 or 2
    spectra : (f, t, n, s, s) float64, what is left of f, over the warped square; n channels
    wavelengths : (n,) nm, or None where the channels are linear sRGB
    jacobian : whether spectra are to be multiplied by ndf / 4 sigma
    """

    theta_i: Array
    ndf: Array
    sigma: Array
    vndf: Array
    spectra: Array
    wavelengths: Array | None
    jacobian: bool


def read_rgl(path: str | os.PathLike[str]) -> AdaptiveTables:
    """Read and check a .bsdf; its `rgb` where it has them, else its `spectra`.

    Raises
    ------
    InputError
        If it is no such file, is damaged, lacks a field, or is anisotropic.
    """
    fields = ("theta_i", "phi_i", "ndf", "sigma", "vndf", "rgb", "spectra", "wavelengths", "jacobian")
    found = read_tensors(path, fields, (EXTENSION,), "an RGL BRDF")
    name = os.fspath(path)
    colours = "rgb" if "rgb" in found else "spectra"
    needed = (
        "theta_i",
        "phi_i",
        "ndf",
        "sigma",
        "vndf",
        colours,
        *(("wavelengths",) if colours != "rgb" else ()),
    )
    missing = [key for key in needed if key not in found]
    if missing:
        raise InputError(
            f"{name}: expected an RGL BRDF, but it has no field {', '.join(missing)}; copy it again"
        )
    own = {key: _finite(name, key, found[key]) for key in needed}
    theta, phi = own["theta_i"], own["phi_i"]
    if phi.ndim == 1 and phi.size > 2:
        raise InputError(
            f"{name}: is anisotropic ({phi.size} azimuths of incidence); only isotropic BRDFs are read"
        )
    if theta.ndim != 1 or phi.ndim != 1 or not theta.size or not phi.size or (np.diff(theta) <= 0).any():
        raise InputError(f"{name}: theta_i and phi_i expected lists of ascending angles; copy the file again")
    if not 0 <= theta[0] <= theta[-1] <= np.pi / 2 + 1e-3:
        raise InputError(f"{name}: theta_i expected from 0 to pi/2, got {theta[0]:g} to {theta[-1]:g}")
    lead, channels = (phi.size, theta.size), 3 if colours == "rgb" else own["wavelengths"].size
    shapes = {key: own[key].shape for key in ("ndf", "sigma", "vndf", colours)}
    if not (
        all(len(shapes[key]) == 2 for key in ("ndf", "sigma"))
        and len(shapes["vndf"]) == 4
        and shapes["vndf"][:2] == lead
        and len(shapes[colours]) == 5
        and shapes[colours][:3] == (*lead, channels)
        and all(min(shape[-2:]) >= 2 for shape in shapes.values())
    ):
        listed = ", ".join(f"{key} {shape}" for key, shape in shapes.items())
        raise InputError(
            f"{name}: fields do not fit phi_i[{phi.size}], theta_i[{theta.size}] and {channels} channels: {listed}; "
            "copy the file again"
        )
    if (
        any((own[key] < 0).any() for key in ("ndf", "sigma", "vndf"))
        or not (own["vndf"].sum(axis=(2, 3)) > 0).all()
    ):
        raise InputError(f"{name}: ndf, sigma and vndf expected densities, 0 or more; copy the file again")
    wavelengths = None if colours == "rgb" else own["wavelengths"]
    if wavelengths is not None and (
        wavelengths.ndim != 1 or wavelengths.size < 2 or (np.diff(wavelengths) <= 0).any()
    ):
        raise InputError(f"{name}: wavelengths expected ascending, in nm; copy the file again")
    jacobian = bool(np.ravel(found["jacobian"])[:1].any()) if "jacobian" in found else True
    return AdaptiveTables(theta, own["ndf"], own["sigma"], own["vndf"], own[colours], wavelengths, jacobian)


def _finite(name: str, key: str, values: npt.NDArray[np.generic]) -> Array:
    if values.dtype.kind not in "fiu":
        raise InputError(f"{name}: {key} expected numbers, got {values.dtype}; copy the file again")
    with np.errstate(invalid="ignore", over="ignore"):
        own = values.astype(np.float64)
        # Beyond float32, in which the format keeps them, sums of squares might overflow.
        if not (np.abs(own) < 1e38).all():
            raise InputError(f"{name}: {key} holds NaN, infinite or huge numbers; copy the file again")
    return own

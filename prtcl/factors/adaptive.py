"""Reflectance in the adaptive parameterisation of Dupuy and Jakob, "An adaptive parameterization for efficient material
acquisition and rendering" (2018): what EPFL RGL's .bsdf files hold.

With u(θ) = √(2θ/π) and u(φ) = (φ + π)/2π, every table lies on a unit square, bilinear between its corners. f of an
incident direction i and half vector m::

    f cos θ_o = S(w | θ_i) D(m) / 4 σ(i),   w = warp of m by the cumulative visible normals at θ_i

where w_φ is the marginal distribution of u(φ_m − φ_i) up to m's, and w_θ the conditional one of u(θ_m) along that row.
The warp spreads the lobe over the square, so a small table S holds it at any roughness. Between nodes of θ_i densities
and S are interpolated linearly. The tables hold f with the outgoing cosine, as a microfacet model's σ gives it
(σ = cos θ_i / G1): Mitsuba's `measured` returns them so, as all its BSDFs do, and pbrt-v4's divides by the cosine.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors.bivariate import interval
from prtcl.files.rgl import AdaptiveTables

Array = npt.NDArray[np.float64]

LEAST_COSINE = float(np.cos(np.radians(88)))
"""Of directions that are taken from such tables: nearer to the horizon, where nothing was measured, what the tables
hold is divided by a cosine that goes to 0."""


class Adaptive:
    """f of an AdaptiveTables in linear sRGB.

    Parameters
    ----------
    tables : spectra already in three channels (see `to_rgb`)
    """

    def __init__(self, tables: AdaptiveTables) -> None:
        self.tables = tables
        self._slices = [
            (_Warp(vndf), colours) for vndf, colours in zip(tables.vndf, tables.spectra, strict=True)
        ]

    def __call__(self, incident: Array, outgoing: Array) -> Array:
        """f of pairs of unit directions (n, 3) above the horizon: (n, 3), 1/sr; never below 0.

        It is not quite reciprocal: measurements are not, and incident is the direction the tables are over.
        """
        tables = self.tables
        half = incident + outgoing
        half = half / np.linalg.norm(half, axis=1, keepdims=True)
        theta_i, theta_m = _elevation(incident), _elevation(half)
        phi_i, phi_m = (np.arctan2(d[:, 1], d[:, 0]) for d in (incident, half))
        u_i = np.sqrt(theta_i * (2 / np.pi)), (phi_i + np.pi) / (2 * np.pi)
        u_m = np.sqrt(theta_m * (2 / np.pi)), (phi_m - phi_i + np.pi) / (2 * np.pi) % 1.0
        low, weight = interval(tables.theta_i, theta_i)
        high = np.minimum(low + 1, tables.theta_i.size - 1)
        f = np.zeros_like(incident)
        for warp, colours in self._slices:
            x, y = warp(u_m[0], u_m[1], low, high, weight)
            corners = _corners(x, y, colours.shape[2:])
            for node, by in ((low, 1 - weight), (high, weight)):
                for row, column, share in corners:
                    f += (by * share)[:, None] * colours[node, :, row, column]
        f /= len(self._slices)
        if tables.jacobian:
            f *= (_bilinear(tables.ndf, *u_m) / (4 * np.maximum(_bilinear(tables.sigma, *u_i), 1e-30)))[
                :, None
            ]
        return np.asarray(np.maximum(f, 0.0) / outgoing[:, 2:])


class _Warp:
    """Cumulative distributions of a density (t, h, w), a slice for each θ_i, each scaled to integrate to 1."""

    def __init__(self, density: Array) -> None:
        self.height, self.width = density.shape[1:]
        total = _cumulative(_cumulative(density, 2)[:, :, -1], 1)[:, -1]
        self.density = density / total[:, None, None]
        self.along = _cumulative(self.density, 2)
        """(t, h, w): ∫ along a row up to each column."""
        self.marginal = _cumulative(self.along[:, :, -1], 1)
        """(t, h): ∫ over the rows up to each."""

    def __call__(
        self, u: Array, v: Array, low: npt.NDArray[np.intp], high: npt.NDArray[np.intp], weight: Array
    ) -> tuple[Array, Array]:
        """Where the point (u along a row, v across rows) goes, the slices `low` and `high` mixed by `weight`."""
        column, x = _cell(u, self.width)
        row, y = _cell(v, self.height)

        def mixed(table: Array, *at: npt.NDArray[np.intp]) -> Array:
            return np.asarray(table[(low,) + at] * (1 - weight) + table[(high,) + at] * weight)

        left, right = (
            mixed(self.density, row, column + k) * (1 - y) + mixed(self.density, row + 1, column + k) * y
            for k in (0, 1)
        )
        upto, whole = (
            mixed(self.along, row, c) * (1 - y) + mixed(self.along, row + 1, c) * y
            for c in (column, np.full_like(column, self.width - 1))
        )
        # A density linear over a cell integrates to x (left + x/2 (right − left)) of it.
        upto = upto + x * (left + 0.5 * x * (right - left)) / (self.width - 1)
        last = np.full_like(column, self.width - 1)
        first, second = mixed(self.along, row, last), mixed(self.along, row + 1, last)
        across = mixed(self.marginal, row) + y * (first + 0.5 * y * (second - first)) / (self.height - 1)
        along = np.divide(upto, whole, out=np.zeros_like(upto), where=whole > 0)
        return np.clip(along, 0, 1), np.clip(across, 0, 1)


def to_rgb(tables: AdaptiveTables, name: str) -> AdaptiveTables:
    """Spectra as linear sRGB, as they look under D65, under which a spectrum of ones is white: (f, t, 3, s, s).

    Weights are the CIE 1931 2° observer times D65 at the file's wavelengths, integrated by trapezoids.

    Raises
    ------
    InputError
        If the wavelengths do not reach from 410 to 680 nm, or colour-science is not installed.
    """
    if tables.wavelengths is None:
        return tables
    nm = tables.wavelengths
    if nm[0] > 410 or nm[-1] < 680 or np.diff(nm[(nm > 400) & (nm < 700)]).max(initial=0) > 30:
        raise InputError(
            f"{name}: wavelengths expected from 410 to 680 nm, 30 nm apart at most, got {nm.size} from "
            f"{nm[0]:g} to {nm[-1]:g}"
        )
    try:
        import scipy  # noqa: F401 -- without it colour-science leaves a mock in its place, for everybody
        import colour  # isort: skip
    except ImportError as error:
        raise InputError(
            f"{name}: has spectra and no rgb; colours of spectra take colour-science: pip install prtcl[spectral]"
        ) from error
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    light = colour.SDS_ILLUMINANTS["D65"]
    seen = np.stack([np.interp(nm, observer.wavelengths, c, 0, 0) for c in np.asarray(observer.values).T])
    weights = seen * np.interp(nm, light.wavelengths, np.asarray(light.values), 0, 0)
    weights = weights * np.convolve(np.diff(nm), [0.5, 0.5])
    matrix = np.asarray(colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB) @ weights
    matrix /= matrix.sum(axis=1, keepdims=True)
    rgb = np.einsum("cw,ftwyx->ftcyx", matrix, tables.spectra)
    return replace(tables, spectra=rgb, wavelengths=None)


def _elevation(direction: Array) -> Array:
    """Angle from the normal, without cancellation near it."""
    chord = np.sqrt(direction[:, 0] ** 2 + direction[:, 1] ** 2 + (direction[:, 2] - 1) ** 2)
    return np.asarray(2 * np.arcsin(np.minimum(chord / 2, 1.0)))


def _cumulative(density: Array, axis: int) -> Array:
    """∫ along an axis of [0, 1] by trapezoids, from 0: the same shape."""
    own = np.moveaxis(density, axis, -1)
    steps = (own[..., 1:] + own[..., :-1]) / (2 * (own.shape[-1] - 1))
    out = np.concatenate([np.zeros((*own.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)
    return np.moveaxis(out, -1, axis)


def _cell(u: Array, count: int) -> tuple[npt.NDArray[np.intp], Array]:
    at = np.clip(u, 0.0, 1.0) * (count - 1)
    low = np.minimum(at.astype(np.intp), count - 2)
    return low, at - low


def _corners(
    x: Array, y: Array, shape: tuple[int, ...]
) -> list[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Array]]:
    """Row, column and bilinear weight of the four corners about each point."""
    (column, wx), (row, wy) = _cell(x, shape[1]), _cell(y, shape[0])
    return [
        (row + j, column + i, (wy if j else 1 - wy) * (wx if i else 1 - wx)) for j in (0, 1) for i in (0, 1)
    ]


def _bilinear(table: Array, x: Array, y: Array) -> Array:
    return np.asarray(sum(share * table[row, column] for row, column, share in _corners(x, y, table.shape)))

"""A clear daytime sky with its sun, as an environment map, from a published model.

Sky: A. J. Preetham, P. Shirley, B. Smits, "A Practical Analytic Model for Daylight", SIGGRAPH 1999. Its
luminance and chromaticity are Perez's five-parameter distribution (the paper's equation 3), whose parameters
and zenith values are functions of turbidity and solar angle (appendix A.2). Sun: the direct beam through the
atmosphere, by the transmittances of Rayleigh scattering, aerosol and ozone of the same paper's appendix A.1,
evaluated at one wavelength a channel. Ground: a Lambertian plane lit by both.

Radiance is in kcd/m² (cd/m² over a thousand): 0.2126 R + 0.7152 G + 0.0722 B of a texel is its luminance in
that unit. A clear sky has some 2 to 20, the sun's disk about 10⁶. Linear Rec.709, white point D65, no
chromatic adaptation.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from prtcl.errors import InputError

Array = NDArray[np.float64]

# Appendix A.2: Perez's A, B, C, D, E as slope * T + offset, for the luminance Y and the chromaticities x and
# y.
_PEREZ_Y = ((0.1787, -1.4630), (-0.3554, 0.4275), (-0.0227, 5.3251), (0.1206, -2.5771), (-0.0670, 0.3703))
_PEREZ_x = ((-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452))
_PEREZ_y = ((-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529))

# Appendix A.2: chromaticity at the zenith, [T² T 1] · matrix · [θs³ θs² θs 1].
_ZENITH_x = (
    (0.00166, -0.00375, 0.00209, 0.0),
    (-0.02903, 0.06377, -0.03202, 0.00394),
    (0.11693, -0.21196, 0.06052, 0.25886),
)
_ZENITH_y = (
    (0.00275, -0.00610, 0.00317, 0.0),
    (-0.04214, 0.08970, -0.04153, 0.00516),
    (0.15346, -0.26756, 0.06670, 0.26688),
)

# IEC 61966-2-1: CIE XYZ to linear Rec.709.
_XYZ_TO_RGB = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]], dtype=np.float64
)

# The dominant wavelengths of Rec.709's primaries, in µm, and ozone's absorption there, in 1/cm (appendix
# A.1).
_WAVELENGTHS = np.array([0.611, 0.549, 0.464])
_OZONE_ABSORPTION = np.array([0.120, 0.084, 0.008])
_OZONE_CM = 0.35

# Outside the atmosphere: the luminous solar constant in klx (Darula, Kittler, Gueymard, "Reference luminous
# solar constant and solar luminance for illuminance calculations", Solar Energy 79, 2005: 133.3) and the
# chromaticity of a black body of the sun's effective temperature, 5772 K.
_SOLAR_KLX = 133.0
_SOLAR_xy = (0.3265, 0.3358)

_STRIPS = 256  # a row's share of the disk is summed over this many strips


def sun_sky(
    height: int = 256,
    *,
    sun_elevation: float = 40.0,
    sun_azimuth: float = 135.0,
    turbidity: float = 3.0,
    sun_size: float = 0.53,
    ground_albedo: float | Sequence[float] = 0.2,
) -> NDArray[np.float32]:
    """The sky of Preetham, Shirley and Smits 1999 with the sun's disk, over a Lambertian ground.

    Returns an equirectangular map `(height, 2 * height, 3)` of float32 radiance in kcd/m², linear Rec.709.
    Row 0 is at the zenith, +y; texel (i, j) is centred at v = (i + 0.5) / height, u = (j + 0.5) / (2 *
    height), with u = atan2(x, -z) / 2π and v = acos(y) / π.

    `sun_elevation` is in degrees above the horizon, above 0 and up to 90. `sun_azimuth` is in degrees along
    u: 0 is -z, 90 is +x (a compass bearing with -z north), 180 the middle of the map. `turbidity` runs from 2
    (very clear) to 10 (hazy); 3 is a clear day, above 6 the model is a poor one. `sun_size` is the disk's
    angular diameter in degrees. A larger disk has softer shadows and a lower radiance, since the light that
    it sends stays the same. The disk is uniform: the sun's limb is not darkened. `ground_albedo` is one
    number or one a channel.

    A texel holds the fraction of its solid angle that the disk covers times the disk's radiance, so the sum
    of radiance times solid angle does not depend on `height`. Where texels are larger than the disk, that
    light sits at the centre of a texel, up to half a texel from the sun. A disk that meets the horizon loses
    what is below it.
    """
    if isinstance(height, bool) or not isinstance(height, (int, np.integer)) or height < 2:
        raise InputError(f"sun_sky: height is {height!r}; give a whole number of rows, 2 or more")
    azimuth = float(sun_azimuth)
    if not math.isfinite(azimuth):
        raise InputError(f"sun_sky: sun_azimuth is {sun_azimuth!r}; give a finite number of degrees")
    if not 0.0 < sun_size <= 90.0:
        raise InputError(
            f"sun_sky: sun_size is {sun_size!r}; give the disk's diameter in degrees, above 0 and up to 90 "
            "(the sun's is 0.53)"
        )
    albedo = np.broadcast_to(_albedo(ground_albedo), 3)
    _check(sun_elevation, turbidity)

    rows, width = int(height), 2 * int(height)
    zenith_angle = math.radians(90.0 - sun_elevation)
    # Columns from the sun's meridian, exactly symmetric about it wherever the meridian meets a column's edge
    # or centre.
    offset = np.arange(width) + 0.5 - width * (azimuth % 360.0) / 360.0
    column: Array = np.abs(offset - width * np.round(offset / width))
    theta = np.pi * (np.arange(rows) + 0.5) / rows

    # The share of each row that lies above the horizon: 0 or 1, but a half in the middle row of an odd
    # height.
    above = np.clip(rows / 2 - np.arange(rows), 0.0, 1.0)
    sky_rows = int(np.count_nonzero(above))
    sky = _sky(theta[:sky_rows, None], 2.0 * np.pi * column / width, zenith_angle, turbidity)

    radius = math.radians(sun_size) / 2
    coverage, flat = _disk(rows, column, zenith_angle, radius)
    beam = sun_irradiance(sun_elevation, turbidity)
    disk_radiance = beam / (2.0 * np.pi * (1.0 - math.cos(radius)))
    ground = albedo / np.pi * (_sky_irradiance(zenith_angle, turbidity) + disk_radiance * flat)

    image = np.broadcast_to((1.0 - above)[:, None, None] * ground, (rows, width, 3)).copy()
    image[:sky_rows] += above[:sky_rows, None, None] * sky
    image += coverage[:, :, None] * disk_radiance
    result: NDArray[np.float32] = image.astype(np.float32)
    return result


def sun_irradiance(sun_elevation: float = 40.0, turbidity: float = 3.0) -> Array:
    """What the sun's disk alone sends to a plane that faces it: three numbers, klx in the sense of `sun_sky`.

    The sun outside the atmosphere, times exp(-m (τ_Rayleigh + τ_aerosol + τ_ozone)) of appendix A.1 at 611,
    549 and 464 nm, the dominant wavelengths of the Rec.709 primaries, where m is Kasten's relative optical
    mass and the aerosol is Ångström's with α = 1.3 and β = 0.04608 T - 0.04586. Water vapour and the mixed
    gases, which absorb outside these three bands, are left out.
    """
    _check(sun_elevation, turbidity)
    zenith_degrees = 90.0 - sun_elevation
    mass = 1.0 / (math.cos(math.radians(zenith_degrees)) + 0.15 * (93.885 - zenith_degrees) ** -1.253)
    rayleigh = 0.008735 * _WAVELENGTHS**-4.08
    aerosol = (0.04608 * turbidity - 0.04586) * _WAVELENGTHS**-1.3
    ozone = _OZONE_ABSORPTION * _OZONE_CM
    outside = _rgb(np.float64(_SOLAR_xy[0]), np.float64(_SOLAR_xy[1]), np.float64(_SOLAR_KLX))
    beam: Array = outside * np.exp(-mass * (rayleigh + aerosol + ozone))
    return beam


def _check(sun_elevation: float, turbidity: float) -> None:
    if not 0.0 < sun_elevation <= 90.0:
        raise InputError(
            f"sun_sky: sun_elevation is {sun_elevation!r}; the model is one of daylight: give degrees "
            "above the horizon, above 0 and up to 90"
        )
    if not 2.0 <= turbidity <= 10.0:
        raise InputError(
            f"sun_sky: turbidity is {turbidity!r}; the model holds from 2 (very clear) to 10 (hazy): "
            "give a number between"
        )


def _albedo(ground_albedo: float | Sequence[float]) -> Array:
    albedo = np.asarray(ground_albedo, dtype=np.float64)
    if albedo.shape not in ((), (3,)) or not np.all((albedo >= 0.0) & (albedo <= 1.0)):
        raise InputError(
            f"sun_sky: ground_albedo is {ground_albedo!r}; give one number from 0 to 1, or three for R, G, B"
        )
    return albedo


def _perez(table: tuple[tuple[float, float], ...], turbidity: float, theta: Array, gamma: Array) -> Array:
    """Perez's F(θ, γ), equation 3: θ from the zenith, γ from the sun."""
    a, b, c, d, e = (slope * turbidity + offset for slope, offset in table)
    # B is negative, so the first factor goes to 1 at the horizon.
    horizon = np.exp(b / np.maximum(np.cos(theta), 1e-6))
    value: Array = (1.0 + a * horizon) * (1.0 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)
    return value


def _sky(theta: Array, delta: Array, zenith_angle: float, turbidity: float) -> Array:
    """The sky's RGB at the angle θ from the zenith and the azimuth δ from the sun's meridian."""
    cosine = np.cos(theta) * math.cos(zenith_angle) + np.sin(theta) * math.sin(zenith_angle) * np.cos(delta)
    gamma = np.arccos(np.clip(cosine, -1.0, 1.0))

    def distribution(table: tuple[tuple[float, float], ...]) -> Array:
        at_zenith = _perez(table, turbidity, np.float64(0.0), np.float64(zenith_angle))
        return _perez(table, turbidity, theta, gamma) / at_zenith

    # Appendix A.2: the zenith's luminance in kcd/m² and its chromaticity.
    chi = (4.0 / 9.0 - turbidity / 120.0) * (np.pi - 2.0 * zenith_angle)
    zenith_Y = (4.0453 * turbidity - 4.9710) * math.tan(chi) - 0.2155 * turbidity + 2.4192
    powers = np.array([zenith_angle**3, zenith_angle**2, zenith_angle, 1.0])
    turbidities = np.array([turbidity**2, turbidity, 1.0])
    zenith_x = turbidities @ np.array(_ZENITH_x) @ powers
    zenith_y = turbidities @ np.array(_ZENITH_y) @ powers
    return _rgb(
        zenith_x * distribution(_PEREZ_x),
        zenith_y * distribution(_PEREZ_y),
        np.maximum(zenith_Y * distribution(_PEREZ_Y), 0.0),
    )


def _rgb(x: Array, y: Array, luminance: Array) -> Array:
    """CIE xyY to linear Rec.709.

    The deepest blues lie outside the gamut. They are moved toward the grey of their own luminance until no
    channel is negative.
    """
    xyz = np.stack([x / y * luminance, luminance, (1.0 - x - y) / y * luminance], axis=-1)
    # Not a matrix product: BLAS may sum mirrored texels in different orders.
    rgb = sum(xyz[..., k, None] * _XYZ_TO_RGB[:, k] for k in range(3))
    grey = luminance[..., None]
    least = np.min(rgb, axis=-1, keepdims=True)
    outside = least < 0.0
    keep = np.where(outside, grey / np.where(outside, grey - least, 1.0), 1.0)
    inside: Array = np.maximum(grey + keep * (rgb - grey), 0.0)
    return inside


def _sky_irradiance(zenith_angle: float, turbidity: float, rows: int = 64) -> Array:
    """What the sky sends to the ground: the hemisphere's ∫ L cos θ dω on a grid of its own, so that no map's
    height shows in it."""
    theta = 0.5 * np.pi * (np.arange(rows) + 0.5) / rows
    delta = np.pi * (np.arange(rows) + 0.5) / rows
    weight = 2.0 * np.cos(theta) * np.sin(theta) * (0.5 * np.pi / rows) * (np.pi / rows)
    total: Array = np.sum(
        _sky(theta[:, None], delta, zenith_angle, turbidity) * weight[:, None, None], axis=(0, 1)
    )
    return total


def _disk(rows: int, column: Array, zenith_angle: float, radius: float) -> tuple[Array, float]:
    """The fraction of each texel that the disk covers, and the disk's ∫ cos θ dω, both above the horizon
    only.

    At the angle θ from the zenith the disk spans the azimuths within arccos((cos r - cos θ cos θs) / (sin θ
    sin θs)) of its meridian. Overlap with the columns is exact; along θ the disk is cut into strips.
    """
    width = 2 * rows

    def span(theta: Array) -> Array:
        above = math.cos(radius) - np.cos(theta) * math.cos(zenith_angle)
        below = np.maximum(np.sin(theta) * math.sin(zenith_angle), 1e-300)
        return np.arccos(np.clip(above / below, -1.0, 1.0))

    def strips(start: float, stop: float, count: int) -> tuple[Array, Array]:
        edges = np.linspace(start, stop, count + 1)
        return 0.5 * (edges[:-1] + edges[1:]), np.cos(edges[:-1]) - np.cos(edges[1:])

    start, stop = max(zenith_angle - radius, 0.0), zenith_angle + radius
    # The strips miss the disk's area by a hair, which this takes back.
    theta, depth = strips(start, stop, 16 * _STRIPS)
    correction = 2.0 * np.pi * (1.0 - math.cos(radius)) / float(np.sum(2.0 * span(theta) * depth))
    flat = correction * float(np.sum((2.0 * span(theta) * depth * np.cos(theta))[theta < 0.5 * np.pi]))

    coverage = np.zeros((rows, width))
    total = 0.0
    first, last = int(start / np.pi * rows), min(int(stop / np.pi * rows), rows - 1)
    for row in range(first, last + 1):
        top, bottom = np.pi * row / rows, np.pi * (row + 1) / rows
        theta, depth = strips(max(top, start), min(bottom, stop), _STRIPS)
        half = span(theta) * width / (2.0 * np.pi)
        total += float(np.sum(2.0 * span(theta) * depth))
        reach = half[:, None]
        overlap = np.clip(np.minimum(column + 0.5, reach) - np.maximum(column - 0.5, -reach), 0.0, 1.0)
        # The far end of the span, come round from the other side.
        overlap += np.clip(column + 0.5 - np.maximum(width - reach, column - 0.5), 0.0, 1.0)
        visible = np.where(theta < 0.5 * np.pi, depth, 0.0)
        # Strip by strip, so that mirrored columns are added in the same order.
        share = np.add.reduce(np.minimum(overlap, 1.0) * visible[:, None], axis=0)
        coverage[row] = share / (math.cos(top) - math.cos(bottom))
    coverage *= 2.0 * np.pi * (1.0 - math.cos(radius)) / total
    return coverage, flat

"""prtcl/factors/sky.py: where the sun is, how much light it and the sky send, and of what colour."""

import math

import numpy as np
import pytest

from prtcl.errors import InputError
from prtcl.factors.sky import sun_irradiance, sun_sky

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def solid_angles(height: int) -> np.ndarray:
    """Of an equirectangular map's texels, (height, 1), exact."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return ((edges[:-1] - edges[1:]) * np.pi / height)[:, None]


def directions(height: int) -> np.ndarray:
    """Texel centres as the convention has them: u = atan2(x, -z) / 2π, v = acos(y) / π."""
    phi = 2 * np.pi * (np.arange(2 * height) + 0.5) / (2 * height)
    theta = np.pi * (np.arange(height)[:, None] + 0.5) / height
    x, z = np.sin(theta) * np.sin(phi), -np.sin(theta) * np.cos(phi)
    return np.stack([x, np.cos(theta) + 0 * phi, z], axis=-1)


def toward(elevation: float, azimuth: float) -> np.ndarray:
    """A compass bearing with -z north and +x east."""
    e, a = math.radians(elevation), math.radians(azimuth)
    return np.array([math.cos(e) * math.sin(a), math.sin(e), -math.cos(e) * math.cos(a)])


def disk_alone(height: int, sun_elevation: float, *, sun_size: float = 0.53, **options: float) -> np.ndarray:
    """The map less a map of the same sky, which comes from a disk that lies in one texel, where its light is
    taken away again."""
    options = {"sun_elevation": sun_elevation, "ground_albedo": 0.0, **options}
    sky = sun_sky(height, sun_size=1e-3, **options).astype(float)
    row = np.argmax((sky @ LUMINANCE).max(axis=1))
    sky[row, np.argmax(sky[row] @ LUMINANCE)] -= sun_irradiance(sun_elevation) / solid_angles(height)[row]
    return sun_sky(height, sun_size=sun_size, **options) - sky


def test_shape_type_and_default() -> None:
    image = sun_sky()
    assert image.shape == (256, 512, 3)
    assert image.dtype == np.float32
    assert image.flags.c_contiguous


@pytest.mark.parametrize("azimuth", [0.0, 37.0, 90.0, 135.0, 200.0, 270.0, 359.9, -45.0, 725.0])
@pytest.mark.parametrize("elevation", [3.0, 40.0, 75.0])
def test_brightest_texel_is_the_suns(elevation: float, azimuth: float) -> None:
    height = 64
    luminance = sun_sky(height, sun_elevation=elevation, sun_azimuth=azimuth) @ LUMINANCE
    brightest = directions(height)[np.unravel_index(np.argmax(luminance), luminance.shape)]
    off = math.degrees(math.acos(min(1.0, float(brightest @ toward(elevation, azimuth)))))
    assert off < 0.75 * 180 / height * math.sqrt(2)


def test_axes() -> None:
    """An azimuth of 90 degrees is +x, in the columns about u = 1/4; of 180 degrees +z, in the middle."""
    for azimuth, column in ((0.0, 0), (90.0, 32), (180.0, 64), (270.0, 96)):
        luminance = sun_sky(64, sun_elevation=30.0, sun_azimuth=azimuth) @ LUMINANCE
        row, at = np.unravel_index(np.argmax(luminance), luminance.shape)
        assert (at - column) % 128 in (0, 127)
        assert row in (20, 21)  # 60 degrees from the zenith: 64 / 3 = 21.3


@pytest.mark.parametrize("elevation", [1.0, 12.0, 40.0, 89.9, 90.0])
def test_light_of_the_disk_is_the_same_at_every_height(elevation: float) -> None:
    beam = sun_irradiance(elevation)
    for height in (16, 63, 64, 256):
        added = disk_alone(height, elevation, sun_azimuth=33.3)
        light = np.sum(added * solid_angles(height)[:, :, None], axis=(0, 1))
        np.testing.assert_allclose(light, beam, rtol=1e-4)


def test_total_light_is_the_same_at_heights_64_and_1024() -> None:
    total = []
    for height in (64, 1024):
        image = sun_sky(height, sun_elevation=35.0).astype(float)
        total.append(np.sum(image * solid_angles(height)[:, :, None], axis=(0, 1)))
    np.testing.assert_allclose(total[0], total[1], rtol=1e-2)


def test_light_of_the_disk_at_heights_64_and_1024() -> None:
    coarse, fine = (
        np.sum(disk_alone(height, 40.0) * solid_angles(height)[:, :, None], axis=(0, 1))
        for height in (64, 1024)
    )
    np.testing.assert_allclose(coarse, fine, rtol=1e-4)


@pytest.mark.parametrize("size", [0.1, 0.53, 3.0, 12.0, 60.0])
def test_size_of_the_disk_changes_its_radiance_not_its_light(size: float) -> None:
    height, elevation = 256, 55.0
    added = disk_alone(height, elevation, sun_azimuth=135.3, sun_size=size)
    light = np.sum(added * solid_angles(height)[:, :, None], axis=(0, 1))
    np.testing.assert_allclose(light, sun_irradiance(elevation), rtol=1e-4)
    if size >= 3.0:  # whole texels
        inside = directions(height) @ toward(elevation, 135.3) > math.cos(math.radians(size / 2 - 0.55))
        radiance = sun_irradiance(elevation) / (2 * np.pi * (1 - math.cos(math.radians(size / 2))))
        assert np.count_nonzero(inside) > 3
        np.testing.assert_allclose(added[inside], np.broadcast_to(radiance, added[inside].shape), rtol=2e-3)


def test_edge_texels_hold_a_fraction() -> None:
    """Coverage against brute force: 100 x 100 points in each texel about the sun."""
    height, elevation, azimuth, size = 256, 38.7, 101.3, 2.5
    added = disk_alone(height, elevation, sun_azimuth=azimuth, sun_size=size)[..., 1]
    radiance = sun_irradiance(elevation)[1] / (2 * np.pi * (1 - math.cos(math.radians(size / 2))))
    rows, columns = slice(66, 82), slice(136, 153)
    grid = (np.arange(100) + 0.5) / 100
    theta = np.pi * (np.arange(66, 82)[:, None] + grid).reshape(-1, 1) / height
    phi = np.pi * (np.arange(136, 153)[:, None] + grid).reshape(1, -1) / height
    sun = toward(elevation, azimuth)
    cosine = np.sin(theta) * (np.sin(phi) * sun[0] - np.cos(phi) * sun[2]) + np.cos(theta) * sun[1]
    inside = (cosine > math.cos(math.radians(size / 2))) * np.sin(theta)
    brute = inside.reshape(16, 100, 17, 100).sum((1, 3))
    brute /= (np.sin(theta) + 0 * phi).reshape(16, 100, 17, 100).sum((1, 3))
    np.testing.assert_allclose(added[rows, columns] / radiance, brute, atol=3e-3)
    assert np.count_nonzero((brute > 0.02) & (brute < 0.98)) > 10
    outside = added.copy()
    outside[rows, columns] = 0.0
    assert np.abs(outside).max() < 1e-4 * radiance


def test_setting_disk_is_cut_by_the_horizon() -> None:
    """Its centre half a radius above the horizon: a circle's segment is missing."""
    missing = (math.acos(0.5) - 0.5 * math.sqrt(0.75)) / math.pi
    for height in (64, 65, 512):
        added = disk_alone(height, 1.0, sun_size=4.0)
        light = np.sum(added * solid_angles(height)[:, :, None], axis=(0, 1))
        np.testing.assert_allclose(light, (1.0 - missing) * sun_irradiance(1.0), rtol=2e-3)
        assert np.all(sun_sky(height, sun_elevation=1.0, ground_albedo=0.0)[(height + 1) // 2 :] == 0.0)


@pytest.mark.parametrize("turbidity", [2.0, 2.5, 3.0, 5.0, 10.0])
@pytest.mark.parametrize("elevation", [1e-6, 0.5, 5.0, 40.0, 90.0])
def test_finite_and_positive(elevation: float, turbidity: float) -> None:
    for height in (2, 3, 33, 64):
        image = sun_sky(height, sun_elevation=elevation, turbidity=turbidity)
        assert np.all(np.isfinite(image))
        assert image.min() >= 0.0
        assert (image @ LUMINANCE).min() > 0.0


@pytest.mark.parametrize("height", [50, 64, 65])
@pytest.mark.parametrize("azimuth", [0.0, 90.0, 180.0, 270.0])
def test_mirror_images_about_the_suns_meridian(azimuth: float, height: int) -> None:
    image = sun_sky(height, sun_azimuth=azimuth, sun_size=5.0)
    middle = round(2 * height * azimuth / 360 * 2)  # twice the column of the meridian
    mirrored = image[:, (middle - 1 - np.arange(2 * height)) % (2 * height)]
    np.testing.assert_array_equal(image, mirrored)


def test_turning_the_sun_turns_the_map() -> None:
    east = sun_sky(64, sun_azimuth=90.0)
    np.testing.assert_allclose(sun_sky(64, sun_azimuth=180.0), np.roll(east, 32, axis=1), rtol=1e-6)


def test_zenith_is_bluer_than_the_horizon() -> None:
    image = sun_sky(64, sun_elevation=45.0, turbidity=3.0).astype(float)
    blue = image[..., 2] / image[..., 0]
    zenith, horizon = blue[0].mean(), blue[31].mean()
    assert zenith > 1.5 * horizon
    assert zenith > 2.0


def test_low_sun_is_redder() -> None:
    ratios = [sun_irradiance(e)[0] / sun_irradiance(e)[2] for e in (90.0, 40.0, 15.0, 5.0, 2.0)]
    assert ratios == sorted(ratios)
    assert 1.0 < ratios[0] < 1.6
    assert ratios[-1] > 8.0
    beam = sun_irradiance(3.0)
    assert beam[0] > beam[1] > beam[2] > 0.0


def test_haze_dims_the_sun_and_whitens_the_zenith() -> None:
    clear, hazy = sun_irradiance(40.0, 2.0), sun_irradiance(40.0, 8.0)
    assert np.all(hazy < clear)
    zenith = [sun_sky(16, turbidity=t)[0].mean(axis=0) for t in (2.0, 8.0)]
    assert zenith[1][2] / zenith[1][0] < zenith[0][2] / zenith[0][0]


@pytest.mark.parametrize("elevation", [15.0, 30.0, 45.0, 60.0, 75.0])
def test_daylight_is_as_bright_as_published(elevation: float) -> None:
    """Against the IES clear-sky formulas: 127.5 exp(-0.21 / sin e) klx from the sun on a plane that faces it,
    and 0.8 + 15.5 sqrt(sin e) klx from the sky on the ground. Preetham's sky is known to be the brighter
    one."""
    sine = math.sin(math.radians(elevation))
    beam = sun_irradiance(elevation) @ LUMINANCE
    height = 128
    image = sun_sky(height, sun_elevation=elevation, ground_albedo=0.0).astype(float) @ LUMINANCE
    cosine = np.maximum(directions(height)[..., 1], 0.0)
    ground = float(np.sum(image * cosine * solid_angles(height)))
    sky = ground - beam * sine
    direct_ies, sky_ies = 127.5 * math.exp(-0.21 / sine), 0.8 + 15.5 * math.sqrt(sine)
    assert 0.6 * direct_ies < beam < 1.1 * direct_ies
    assert sky_ies < sky < 2.5 * sky_ies
    assert ground == pytest.approx(direct_ies * sine + sky_ies, rel=0.25)


def test_zenith_luminance_is_the_papers() -> None:
    """Appendix A.2 by hand, T = 3, the sun 50 degrees from the zenith: 6.52 kcd/m²."""
    image = sun_sky(1024, sun_elevation=40.0, turbidity=3.0)
    chi = (4 / 9 - 3 / 120) * (np.pi - 2 * math.radians(50.0))
    expected = (4.0453 * 3 - 4.9710) * math.tan(chi) - 0.2155 * 3 + 2.4192
    assert expected == pytest.approx(6.52, abs=0.01)
    assert (image[0] @ LUMINANCE).mean() == pytest.approx(expected, rel=2e-3)


def test_ground_is_lit_by_sky_and_sun() -> None:
    height, albedo = 256, np.array([0.1, 0.4, 0.7])
    image = sun_sky(height, sun_elevation=50.0, ground_albedo=list(albedo)).astype(float)
    assert np.all(image[height // 2 :] == image[-1, 0])
    # Of the disk's texels a coarse map would know the cosine badly: the sun is taken from its beam.
    upper = image[: height // 2] - disk_alone(height, 50.0)[: height // 2]
    cosine = directions(height)[: height // 2, :, 1:2]
    sky = np.sum(upper * cosine * solid_angles(height)[: height // 2, :, None], axis=(0, 1))
    expected = albedo / np.pi * (sky + sun_irradiance(50.0) * math.sin(math.radians(50.0)))
    np.testing.assert_allclose(image[-1, 0], expected, rtol=2e-3)
    black = sun_sky(height, ground_albedo=0.0)
    assert np.all(black[height // 2 :] == 0.0)


def test_ground_does_not_depend_on_the_height() -> None:
    np.testing.assert_array_equal(sun_sky(16)[-1], np.broadcast_to(sun_sky(250)[-1, 0], (32, 3)))


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"height": 1}, "height"),
        ({"height": 64.0}, "height"),
        ({"height": True}, "height"),
        ({"sun_elevation": 0.0}, "sun_elevation"),
        ({"sun_elevation": -10.0}, "sun_elevation"),
        ({"sun_elevation": 90.5}, "sun_elevation"),
        ({"sun_elevation": math.nan}, "sun_elevation"),
        ({"sun_azimuth": math.inf}, "sun_azimuth"),
        ({"turbidity": 1.9}, "turbidity"),
        ({"turbidity": 10.1}, "turbidity"),
        ({"turbidity": math.nan}, "turbidity"),
        ({"sun_size": 0.0}, "sun_size"),
        ({"sun_size": 91.0}, "sun_size"),
        ({"ground_albedo": -0.1}, "ground_albedo"),
        ({"ground_albedo": (0.1, 0.2)}, "ground_albedo"),
        ({"ground_albedo": (0.1, 0.2, 1.2)}, "ground_albedo"),
    ],
)
def test_wrong_arguments_are_named(options: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word):
        sun_sky(**options)  # type: ignore[arg-type]

"""What two angles cost: weights, errors, pictures of a sphere; and the published networks in MERL's layout."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from test_measured import NODES, pairs

from prtcl import reference
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.material import Material
from prtcl.factors.measured import Measured, merl_layout
from prtcl.factors.reduction import (
    cosine_weights,
    in_two_angles,
    radiance_change,
    reciprocity_error,
    reduction_error,
    relative_rmse,
    sphere_radiance,
)  # fmt: skip

Array = NDArray[np.float64]


def test_a_brdf_of_two_angles_loses_nothing() -> None:
    own = np.random.default_rng(1).random((6, 5, 1, 3))
    same = Measured.make(np.repeat(own, 8, axis=2), *NODES)
    assert reduction_error(same)[0] < 1e-15
    seen = same.above.any(axis=2)
    np.testing.assert_allclose(same.bivariate().values[seen], own[:, :, 0][seen], rtol=1e-12)


def test_weights_are_the_cosine_weighted_measure() -> None:
    """∫∫ g cos cos over pairs of directions, of g = (i·o + 1)/2: in closed form, π²(½ + ½ · 4/9)."""
    own = merl_layout(np.ones((90, 90, 180, 3)))
    weight = cosine_weights(own)
    assert weight.sum() == pytest.approx(1) and (weight >= 0).all()
    g = np.cos(own.theta_d)[:, None] ** 2
    # Means of the components of a direction under cos/π are (0, 0, 2/3).
    assert (weight * g).sum() == pytest.approx(0.5 + 0.5 * (2 / 3) ** 2, rel=2e-4)


def test_the_error_is_that_of_a_known_difference() -> None:
    """f = 1 ± a, half the bins each: ‖f̃ − f‖ = a, ‖f‖² = 1 + a² wherever both halves count alike."""
    a, nodes = 0.2, np.linspace(0.01, 0.3, 6)  # so near the normal every pair is above the horizon
    signs = np.where(np.arange(8) % 2 == 0, 1 + a, 1 - a)
    own = Measured.make(np.broadcast_to(signs[:, None], (6, 6, 8, 3)), nodes, nodes)
    share, rmse = reduction_error(own)
    assert own.above.all()
    # Bins of the two signs lie symmetrically about every axis of the cosines, so they weigh the same.
    assert rmse == pytest.approx(a, rel=1e-6) and share == pytest.approx(a / np.sqrt(1 + a * a), rel=1e-6)


# --- radiance -----------------------------------------------------------------------------------------------


def lambert(i: Array, o: Array) -> Array:
    return np.full(i.shape, [0.5 / np.pi, 0.25 / np.pi, 1 / np.pi])


def test_a_white_sky_shows_the_albedo() -> None:
    got = sphere_radiance((lambert,), np.ones((8, 16, 3)), points=12, samples=48)[0]
    np.testing.assert_allclose(got, np.broadcast_to([0.5, 0.25, 1.0], got.shape), rtol=0.01)


def test_a_sun_is_seen_at_its_strength() -> None:
    """One bright texel: E = L Ω cos, known for each normal by its share of a Lambert sphere."""
    image = np.zeros((64, 128, 3))
    image[12, 70] = 1000.0
    solid = (np.cos(np.pi * 12 / 64) - np.cos(np.pi * 13 / 64)) * 2 * np.pi / 128
    got = sphere_radiance((lambert,), image, points=40, samples=16)[0][:, 2]
    full = 1000 * solid / np.pi
    assert 0.5 * full < got.max() <= full * 1.001 and got.min() == 0.0


def test_a_lobe_is_that_of_the_reference() -> None:
    rng = np.random.default_rng(3)
    image = rng.uniform(0.2, 1, (16, 32, 3))
    material = Material.parse("ggx:alpha=0.3,f0=0.5").reference()

    def f(i: Array, o: Array) -> Array:
        return reference.brdf(material, i, o)

    own = sphere_radiance((f,), image, points=3, samples=128)[0]
    axis = np.array([0, 0.2, 1]) / np.linalg.norm([0, 0.2, 1])
    # The first point of the picture of three is 0.41 from its middle: its normal by hand.
    radius = np.sqrt(0.5 / 3)
    tangent = np.cross([1.0, 0, 0], axis)
    tangent /= np.linalg.norm(tangent)
    normal = radius * tangent + np.sqrt(1 - radius**2) * axis
    first = np.cross([1.0, 0, 0], normal)
    first /= np.linalg.norm(first)
    frame = np.stack([first, np.cross(normal, first), normal])
    texels = np.repeat(np.repeat(image, 8, axis=0), 8, axis=1)  # nearly constant over a texel
    wanted = reference.radiance(texels, material, frame, axis, levels=8)
    np.testing.assert_allclose(own[0], wanted, rtol=0.01)


def test_the_change_of_a_picture() -> None:
    assert relative_rmse([1.0, 3.0], [2.0, 2.0]) == 0.5
    flat = Measured.make(np.full((6, 5, 8, 3), 0.2), *NODES)
    sky = np.ones((8, 16, 3))
    assert radiance_change(flat, sky, points=4, samples=16) < 1e-12
    doubled = Bivariate.make(np.full((6, 5, 3), 0.4), *NODES)
    assert radiance_change(flat, sky, doubled, points=4, samples=16) == pytest.approx(1.0, rel=0.01)
    i, o = pairs()
    np.testing.assert_allclose(in_two_angles(doubled)(i, o), 0.4)
    assert (in_two_angles(doubled)(i, -o) == 0).all()


def test_reciprocity_error_finds_what_is_not_reciprocal() -> None:
    assert reciprocity_error(lambda i, o: np.ones_like(i)) == 0.0

    def lopsided(i: Array, o: Array) -> Array:
        return 1 + 0.1 * np.repeat(np.sign(i[:, 2:] - o[:, 2:]), 3, axis=1)

    assert reciprocity_error(lopsided) == pytest.approx(0.2, rel=1e-6)
    assert reciprocity_error(lambda i, o: 0 * i) == 0.0


# --- real measurements --------------------------------------------------------------------------------------


def test_published_networks_in_merls_layout(shared_data: Path) -> None:
    """Bench code against the published vectors, then a table in MERL's layout against the network between nodes."""
    if not (shared_data / "brdfs").is_dir():
        pytest.skip("no measured BRDFs in the shared data")
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))
    try:
        import networks
        from reduction import check_networks
    finally:
        sys.path.pop(0)
    assert check_networks() < 1e-10
    own, f = networks.measured("merl", "pink-felt"), networks.load("merl", "pink-felt")
    i, o = pairs(2000)
    i, o = (x[(i[:, 2] > 0.1) & (o[:, 2] > 0.1)] for x in (i, o))
    exact = (f(i, o) + f(o, i)) / 2
    assert relative_rmse(own.evaluate(i, o), exact) < 0.01
    share, rmse = reduction_error(own)
    assert 0.01 < share < 0.3 and 0.01 < rmse < 0.3

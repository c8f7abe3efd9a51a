"""The float64 estimator that plans are held against: closed forms, the grid reference, and its own densities."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl import reference
from prtcl.factors import hemisphere
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.sky import sun_sky
from prtcl.factors.visibility import Tracer
from prtcl.transport import truth
from prtcl.transport.pipeline import Points
from prtcl.transport.truth import Truth

Array = NDArray[np.float64]

FRAME = hemisphere.frames_from(np.array([[0.2, 0.9, 0.3]]) / np.linalg.norm([0.2, 0.9, 0.3]))[0]
VIEW = np.array([np.sin(0.9), 0.0, np.cos(0.9)])


def wall() -> Tracer:
    """A square that hides a part of the sky of the origin."""
    vertices = np.array([[0.5, -2.0, -2.0], [0.5, 0.6, -2.0], [0.5, 0.6, 2.0], [0.5, -2.0, 2.0]])
    return Tracer(vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))


def same_point(tracer: Tracer, count: int, view: Array = VIEW) -> Points:
    """The origin, many times: as many independent estimates."""
    origins = tracer.origins(np.zeros((count, 3)), np.tile(FRAME[2], (count, 1)))
    return Points(
        origins, np.tile(FRAME, (count, 1, 1)), np.tile(view.astype(np.float32), (count, 1)),
        np.zeros(count, np.int32), np.full(count, hemisphere.ALONE, np.int32), True,
    )  # fmt: skip


def assert_estimates(got: Array, wanted: Array, systematic: float) -> None:
    """The mean of independent estimates within five of its standard errors, and what `wanted` may itself err by."""
    mean, error = got.mean(axis=0), got.std(axis=0, ddof=1) / np.sqrt(len(got))
    assert (error > 0).all() and (error < 0.03 * wanted).all()
    assert (np.abs(mean - wanted) < 5 * error + systematic * wanted).all(), (
        mean / wanted - 1,
        error / wanted,
    )


@pytest.mark.parametrize(
    "spec", ["lambert:albedo=0.7/0.5/0.3", "ggx:alpha=0.3,f0=0.9/0.6/0.3", "ggx:alpha=0.05,f0=1"]
)
def test_without_occluders_constant_light_gives_the_albedo(spec: str) -> None:
    tracer = Tracer(np.array([[9.0, -9, 0], [9, -9, 1], [9, -8, 0]]), np.array([[0, 1, 2]], dtype=np.int32))
    material = Material.parse(spec)
    local = reference.directions(9)
    f = reference.brdf(material.reference(), local, VIEW) * local[:, 2:3]
    albedo = f.sum(axis=0) * (2 * np.pi / len(local))
    got = Truth(Environment.constant(2.0), tracer, [material]).radiance(
        same_point(tracer, 64), 1024, np.random.default_rng(1)
    )
    assert_estimates(got, 2.0 * albedo, 2e-3)


@pytest.mark.parametrize(
    "spec", ["lambert:albedo=0.5", "ggx:alpha=0.3,eta=0.2,k=3.0", "ggx:alpha=0.1,f0=0.04,kd=0.4"]
)
@pytest.mark.parametrize("rotate, up", [(0.0, "y"), (70.0, "z")])
def test_under_a_sun_beside_a_wall_it_is_the_grid_reference(spec: str, rotate: float, up: str) -> None:
    """Every factor is that of equation (1): light with a broad sun, a shadow's edge, a lobe."""
    image = sun_sky(32, sun_size=16.0)
    tracer, material = wall(), Material.parse(spec)
    environment = Environment(image, rotate, up)
    point = same_point(tracer, 128)
    world = VIEW @ FRAME.astype(np.float64)
    # The map's own axes: the reference knows no rotation.
    turn = environment.to_map
    wanted = reference.radiance(
        image, material.reference(), FRAME @ turn.T, turn @ world, levels=9, position=point.origins[0],
        occluded=lambda origins, towards: tracer.occluded(origins, (towards @ turn).astype(np.float32)),
    )  # fmt: skip
    got = Truth(environment, tracer, [material]).radiance(point, 1024, np.random.default_rng(2))
    assert_estimates(got, wanted, 4e-3)


def test_directions_are_drawn_with_the_density_that_is_told() -> None:
    """∫ g p dω for some smooth g: by drawing, and by quadrature; and ∫ p dω = 1."""
    image = np.random.default_rng(3).exponential(1.0, (8, 16, 3)).astype(np.float32) ** 2
    texels = truth._Texels(image.astype(np.float64), Environment(image).texel_solid_angles())
    drawn = texels.draw(64, 1024, np.random.default_rng(4)).reshape(-1, 3)
    assert np.allclose(np.linalg.norm(drawn, axis=1), 1.0)
    whole = np.concatenate([reference.directions(9), -reference.directions(9)])
    weight = 4 * np.pi / len(whole)
    assert abs(texels.density(whole).sum() * weight - 1.0) < 5e-3
    for axis in np.eye(3):
        wanted = (texels.density(whole) * (1 + whole @ axis) ** 2).sum() * weight
        values = (1 + drawn @ axis) ** 2
        assert abs(values.mean() - wanted) < 5 * values.std() / np.sqrt(len(values)) + 5e-3 * wanted


@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("theta", [0.0, 0.7, 1.5])
def test_lobes_are_drawn_with_the_density_that_is_told(alpha: float, theta: float) -> None:
    view = np.array([[[np.sin(theta), 0.0, np.cos(theta)]]])
    u, v = truth._jittered(1, 256, np.random.default_rng(5))
    drawn = truth._reflected(u, v, alpha, view)[0]
    assert np.allclose(np.linalg.norm(drawn, axis=1), 1.0)
    # Over both hemispheres: facets reflect below the horizon, too.
    whole = np.concatenate([reference.directions(9), -reference.directions(9)])
    density = truth._lobe_density(whole[None], alpha, view)[0]
    weight = 4 * np.pi / len(whole)
    upper = drawn[:, 2] > 0
    wanted = density[whole[:, 2] > 0].sum() * weight
    assert abs(upper.mean() - wanted) < 5 * np.sqrt(upper.mean() * (1 - upper.mean()) / len(upper)) + 0.01


def test_a_seed_gives_the_same_answer_whatever_the_threads() -> None:
    tracer = wall()
    truths = Truth(Environment(sun_sky(16)), tracer, [Material.parse("lambert:albedo=0.5")])
    first, second = (truths.radiance(same_point(tracer, 300), 256, np.random.default_rng(6)) for _ in (0, 1))
    assert (first == second).all()


def test_from_below_nothing_is_reflected() -> None:
    tracer = wall()
    below = same_point(tracer, 4, np.array([0.6, 0.0, -0.8]))
    got = Truth(Environment.constant(), tracer, [Material.parse("ggx:alpha=0.3,f0=1")])
    assert not got.radiance(below, 256, np.random.default_rng(7)).any()


def test_several_materials() -> None:
    """Each point by its own material: under constant light, without occluders, albedos in their order."""
    tracer = Tracer(np.array([[9.0, -9, 0], [9, -9, 1], [9, -8, 0]]), np.array([[0, 1, 2]], dtype=np.int32))
    point = same_point(tracer, 6)
    point.material[:] = [0, 1, 0, 1, 1, 0]
    materials = [Material.parse("lambert:albedo=0.2"), Material.parse("lambert:albedo=0.8")]
    got = Truth(Environment.constant(), tracer, materials).radiance(point, 4096, np.random.default_rng(8))
    assert np.abs(got[:, 0] - np.where(point.material == 1, 0.8, 0.2)).max() < 0.02

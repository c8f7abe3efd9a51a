"""Views under many environments, V ⊕ f_v: against float64, turned, alone and together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.sky import sun_sky
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.view_points import ViewPoints
from prtcl.transport.fixed_view import FixedView, grids_for, rays_for

CAMERA = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(240, 180))
EVERY = 301
"""Of its pixels one in so many is computed: pixels must be small against what they show."""
SPECS = ("lambert:albedo=0.6/0.5/0.4", "ggx:alpha=0.3,eta=0.2,k=3.0", "ggx:alpha=0.12,f0=0.04,kd=0.3/0.2/0.1")
THRESHOLD = 20.0
"""Of the mean radiance: what lies above it the reference sums texel by texel."""


@pytest.fixture(scope="module")
def tracer(mesh: Mesh) -> Tracer:
    return Tracer(mesh.vertices, mesh.faces)


@pytest.fixture(scope="module")
def view(mesh: Mesh, tracer: Tracer) -> ViewPoints:
    """About a hundred pixels that see the mesh, sixteen points each."""
    seen = ViewPoints.of(mesh, tracer, CAMERA, 4, one_material=True)
    keep = np.isin(seen.pixel, seen.seen[::EVERY])
    return replace(
        seen, points=seen.points[keep], pixel=seen.pixel[keep], seen=seen.seen[::EVERY],
        coverage=seen.coverage[::EVERY],
    )  # fmt: skip


@pytest.fixture(scope="module")
def fixed(device: Device, tracer: Tracer, view: ViewPoints) -> FixedView:
    return FixedView(device, tracer, view.points, view.pixel, rays=7)


def looks(*specs: str) -> list[list[Material]]:
    return [[Material.parse(spec)] for spec in specs or SPECS]


def soft_sky() -> Environment:
    """A sky without a sun, and a bright quarter: smooth, yet unlike itself when turned."""
    image = sun_sky(32, sun_elevation=40.0, sun_azimuth=130.0)
    return Environment(np.minimum(image, 4 * np.median(image)).astype(np.float32))


def relative_rmse(got: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(((got - truth) ** 2).mean()) / truth.mean())


def exact(view: ViewPoints, tracer: Tracer, light: Environment, material: Material, every: int) -> np.ndarray:
    """(pixels / every, 3) float64: equation (1) at every point over 32 × 32 random places and each texel of peaks."""
    solid = light.texel_solid_angles()[:, None]
    threshold = THRESHOLD * float((light.image.mean(axis=2) * solid).sum() / (4 * np.pi))
    peaks, irradiance = reference.peaks(light.image, threshold, 8)
    out = []
    for pixel in view.seen[::every]:
        total, own = np.zeros(3), np.flatnonzero(view.pixel == pixel)
        for p in own:
            rng = np.random.default_rng(int(p))
            axes, towards = view.points.frames[p].astype(np.float64), view.points.views[p].astype(np.float64)
            local = reference.directions(5, tuple(rng.random((2, 4**5))))
            soft = reference.environment_below(light.image, local @ axes @ light.to_map.T, threshold)
            world = peaks @ light.to_map
            above = world @ axes[2] > 0
            local = np.concatenate([local, world[above] @ axes.T])
            incoming = np.concatenate([soft * (2 * np.pi / 4**5), irradiance[above]])
            origins = np.repeat(view.points.origins[p : p + 1], len(local), axis=0)
            seen = ~tracer.occluded(origins, (local @ axes).astype(np.float32))
            f = reference.brdf(material.reference(), local[seen], towards)
            total += (incoming[seen] * local[seen, 2:3] * f).sum(axis=0)
        out.append(total / len(own))
    return np.array(out)


@pytest.mark.parametrize(("spec", "limit"), list(zip(SPECS, (0.015, 0.015, 0.02), strict=True)))
@pytest.mark.parametrize("sun", [False, True])
def test_pixels_are_those_of_the_reference(
    fixed: FixedView, view: ViewPoints, tracer: Tracer, sky: Environment, spec: str, limit: float, sun: bool
) -> None:
    """To the errors that bench/relight.py states, which here hold the reference's own noise as well."""
    light = replace(sky if sun else soft_sky(), rotate=50.0)
    truth = exact(view, tracer, light, Material.parse(spec), 2)
    got = fixed.radiance([light], looks(spec))[0, 0, ::2]
    error = relative_rmse(got, truth)
    print(f"relative RMSE {error:.4f}, bias {got.mean() / truth.mean() - 1:+.4f}")
    assert error < limit
    assert abs(got.mean() / truth.mean() - 1) < limit / 2


def test_a_white_furnace_without_a_wall_gives_the_albedo(device: Device) -> None:
    """A single triangle under constant light reflects its albedo, to the grid's sum of cosines."""
    mesh = Mesh.from_arrays(np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    tracer = Tracer(mesh.vertices, mesh.faces)
    seen = ViewPoints.of(mesh, tracer, Camera((0.3, 0.2, 4.0), (0, 0, 0), fov=20.0, size=(8, 8)), 2)
    engine = FixedView(device, tracer, seen.points, seen.pixel)
    got = engine.radiance([Environment.constant((1.0, 2.0, 4.0))], looks("lambert:albedo=0.5"))[0, 0]
    assert np.allclose(got, [0.5, 1.0, 2.0], rtol=2e-3)


def test_one_sided_surfaces_are_black_from_behind(device: Device) -> None:
    mesh = Mesh.from_arrays(np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    tracer, behind = (
        Tracer(mesh.vertices, mesh.faces),
        Camera((0.3, 0.2, -4.0), (0, 0, 0), fov=20.0, size=(8, 8)),
    )
    for two_sided, wanted in ((True, 0.5), (False, 0.0)):
        seen = ViewPoints.of(mesh, tracer, behind, 2, two_sided=two_sided)
        engine = FixedView(device, tracer, seen.points, seen.pixel)
        got = engine.radiance([Environment.constant()], looks("lambert:albedo=0.5"))
        assert np.allclose(got, wanted, rtol=2e-3, atol=0)


def test_an_environment_does_not_depend_on_the_others(fixed: FixedView, sky: Environment) -> None:
    """To the last bit, and twice the same: a job that is resumed may ask for what is missing alone."""
    lights = [replace(sky, rotate=float(r)) for r in (0, 40, 200)] + [soft_sky()] * 15
    together = fixed.radiance(lights, looks())
    assert together.dtype == np.float32
    assert (fixed.radiance(lights, looks()) == together).all()
    assert (fixed.radiance([lights[2]], looks())[:, 0] == together[:, 2]).all()
    assert (fixed.radiance(lights[::-1], looks(SPECS[1]))[0, ::-1] == together[1]).all()
    assert (together[:, 0] != together[:, 1]).mean() > 0.9


def test_a_pixel_does_not_depend_on_the_others(
    device: Device, tracer: Tracer, view: ViewPoints, fixed: FixedView, sky: Environment
) -> None:
    """Up to the order of sums: which cells a tile leaves out, for all its pixels are blind there, adds zeros."""
    some = np.isin(view.pixel, view.seen[5::7])
    alone = FixedView(device, tracer, view.points[some], view.pixel[some], rays=7).radiance([sky], looks())
    together = fixed.radiance([sky], looks())
    assert (alone[0, 0] == together[0, 0, 5::7]).all()


def test_radiance_scales_with_the_light(fixed: FixedView, sky: Environment) -> None:
    """By a power of two exactly; also where sums would leave float32's range."""
    got = fixed.radiance(
        [
            sky,
            replace(sky, image=sky.image * np.float32(4)),
            replace(sky, image=sky.image * np.float32(2.0**100)),
        ],
        looks(SPECS[0]),
    )[0]
    assert (got[1] == 4 * got[0]).all()
    # Stored in another unit, its split may round elsewhere.
    assert np.allclose(got[2] / np.float32(2.0**100), got[0], rtol=1e-4)


def test_turning_the_light_is_turning_the_scene_the_other_way(
    device: Device, mesh: Mesh, sky: Environment
) -> None:
    """The engine's grid stands still in the world: what differs is its error, not the picture."""
    angle = np.radians(110.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])

    def picture(turned: bool, light: Environment) -> np.ndarray:
        own, camera = mesh, replace(CAMERA, size=(60, 45))
        if turned:
            own = replace(
                mesh, vertices=mesh.vertices @ turn.T, normals=(mesh.normals @ turn.T).astype(np.float32)
            )
            camera = replace(camera, eye=tuple(turn @ CAMERA.eye), target=tuple(turn @ CAMERA.target))
        tracer = Tracer(own.vertices, own.faces)
        seen = ViewPoints.of(own, tracer, camera, 4, one_material=True)
        radiance = FixedView(device, tracer, seen.points, seen.pixel).radiance([light], looks())[:, 0]
        return np.stack([seen.image(one) for one in radiance])

    for light, limits in ((soft_sky(), (0.015, 0.02, 0.03)), (sky, (0.03, 0.04, 0.05))):
        still = picture(False, replace(light, rotate=30.0))
        moved = picture(True, replace(light, rotate=30.0 + 110.0))
        for one, other, limit in zip(still, moved, limits, strict=True):
            both = (one[..., 3] == 1) & (other[..., 3] == 1)
            assert both.mean() > 0.5
            error = relative_rmse(one[both][:, :3], other[both][:, :3])
            print(f"{error:.4f}")
            assert error < limit


def test_a_full_turn_is_none(fixed: FixedView, sky: Environment) -> None:
    once, again = fixed.radiance([sky, replace(sky, rotate=360.0)], looks())[:, 0:2].transpose(1, 0, 2, 3)
    assert relative_rmse(again, once) < 1e-5


def turning(fixed: FixedView, light: Environment) -> tuple[np.ndarray, np.ndarray]:
    """Flicker and change of each look in 24 frames a quarter of a degree apart, a quarter of a cell.

    Flicker is the RMS over pixels of the second difference of three neighbouring frames, which a steady change has none
    of; change is that of the first difference; both over the mean radiance. A cell or a coefficient that comes and goes
    would show as its jump.
    """
    frames = fixed.radiance([replace(light, rotate=0.25 * i) for i in range(24)], looks()).astype(np.float64)
    first = np.diff(frames, axis=1)
    second = np.diff(first, axis=1)
    mean = frames.mean(axis=(1, 2, 3))
    flicker, change = (np.sqrt((d**2).mean(axis=(1, 2, 3))) / mean for d in (second, first))
    print(f"flicker {flicker}, from frame to frame {change}")
    assert (change > 1e-5).all(), "MISTRUSTED: nothing moved"
    return flicker, change


def test_a_slow_turn_does_not_flicker(fixed: FixedView, sky: Environment) -> None:
    flicker, change = turning(fixed, soft_sky())
    assert (flicker < 2e-5).all() and (flicker < change / 30).all()
    # A sun's shadows do move by steps, sample by sample and point by point: by less than the picture's error.
    flicker, _ = turning(fixed, sky)
    assert (flicker < 5e-3).all()


def test_grids_follow_the_sharpest_material() -> None:
    matt, shiny, mirror = (Material.parse(f"ggx:alpha={a},f0=0.04") for a in (0.3, 0.1, 0.03))
    assert [grids_for([m], 6).light for m in (matt, shiny, mirror)] == [6, 7, 8]
    assert grids_for([matt, mirror], 6) == grids_for([mirror], 6)
    assert grids_for([matt], 7).fine == 7 and grids_for([matt], 5).fine == 6
    assert rays_for([matt]) == 6 and rays_for([matt, shiny]) == 7


def test_what_does_not_fit_is_refused(
    device: Device, tracer: Tracer, view: ViewPoints, fixed: FixedView
) -> None:
    with pytest.raises(InputError, match="sort the points"):
        FixedView(device, tracer, view.points, np.arange(len(view.points)) % 7)
    with pytest.raises(InputError, match="expected one for each"):
        FixedView(device, tracer, view.points[:-1], view.pixel)
    with pytest.raises(InputError, match="rays"):
        FixedView(device, tracer, view.points, view.pixel, rays=2)
    with pytest.raises(InputError, match="at least one"):
        fixed.radiance([], looks())
    with pytest.raises(InputError, match="1 materials"):
        fixed.radiance([Environment.constant()], [[]])


def test_an_image_has_the_coverage(view: ViewPoints) -> None:
    image = view.image(np.ones((len(view.seen), 3)))
    assert image.shape == (180, 240, 4)
    assert (image[..., 0] == image[..., 3]).all()
    assert (image[..., 3].ravel()[view.seen] == view.coverage.astype(np.float32)).all()
    assert image[..., 3].astype(np.float64).sum() == view.coverage.sum()

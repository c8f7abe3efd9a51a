"""What is left out changes no picture beyond what is said; each has its switch; the report counts what was left out."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.sky import sun_sky
from prtcl.factors.visibility import Tracer
from prtcl.scene.bake import Bake
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import vertex_points
from prtcl.scene.scene import Render, Scene
from prtcl.transport.fine_levels import needed
from prtcl.transport.leave_out import EVERYTHING, WHAT, parse
from prtcl.transport.pipeline import Pipeline

VIEW = Camera((2.0, 2.5, 4.0), (0.0, 0.3, 0.0), size=(32, 24))
EXACT = ("unseen", "unlit", "views", "horizon")
"""Nothing but work that has no effect: the same bits without it."""


@lru_cache
def still_life() -> Mesh:
    """A ball on a large flat ground of many triangles, and a closed box around another ball, dark inside."""
    ground = trimesh.creation.box((12.0, 0.2, 12.0)).subdivide().subdivide().subdivide()
    ground.apply_translation([0.0, -0.1, 0.0])
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    ball.apply_translation([0.0, 0.5, 0.0])
    hidden = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    hidden.apply_translation([2.0, 0.5, 0.0])
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    box.apply_translation([2.0, 0.5, 0.0])
    parts = [ground, ball, hidden, box]
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + offset for part, offset in zip(parts, offsets[:-1], strict=True)])
    return Mesh.from_arrays(vertices, faces, None, "still life")


@lru_cache
def grey_sky() -> Environment:
    image = sun_sky(32, sun_elevation=50.0, sun_azimuth=120.0).mean(axis=2, keepdims=True)
    return Environment(np.repeat(image, 3, axis=2))


def render(
    device: Device, leave_out: str, points: str = "pixel", spec: str = "lambert:albedo=0.5", **settings: Any
) -> Render:
    scene = Scene(still_life(), grey_sky(), spec, VIEW, device=device, leave_out=leave_out, **settings)
    return scene.render(points=points, samples=2)


@lru_cache
def without(device: Device, points: str, spec: str) -> NDArray[np.float32]:
    return render(device, "none", points, spec).image


def error(image: NDArray[np.float32], wanted: NDArray[np.float32]) -> float:
    seen = wanted[..., 3] > 0
    off = (image - wanted)[seen][:, :3].astype(np.float64)
    return float(np.sqrt((off**2).mean()) / wanted[seen][:, :3].mean())


def item(render: Render, name: str) -> dict[str, Any]:
    return next(own for own in render.report["left_out"] if own["name"] == name)


# --- pictures ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("points", ["pixel", "vertex"])
@pytest.mark.parametrize("spec", ["lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.5,kd=0.3"])
@pytest.mark.parametrize("name", [*WHAT, "all"])
def test_no_picture_changes_beyond_what_is_said(device: Device, points: str, spec: str, name: str) -> None:
    wanted = without(device, points, spec)
    image = render(device, name, points, spec).image
    if name in EXACT:
        assert (image == wanted).all()
    # Rays between neighbours that agree: 0.01 to 0.09 % of the bits are wrong (bench/visibility.py). Weights of rays of
    # points that see everything are noise that cancels. Others: sums of another order, or of another turn of the grid.
    bound = {"rays": 3e-3, "unshadowed": 5e-3, "normals": 2e-3, "all": 7e-3}.get(name, 1e-5)
    assert error(image, wanted) < bound


@pytest.mark.parametrize("spec", ["lambert:albedo=0.5", "ggx:alpha=0.5,f0=0.9"])
def test_levels_without_energy_change_a_picture_by_what_is_said(device: Device, spec: str) -> None:
    """Only a plan leaves them out; the same plan without that is what they are held against."""
    scene = Scene(still_life(), grey_sky(), spec, VIEW, device=device)
    plan = scene.render(error=0.05).plan
    assert plan is not None
    kept = tuple(replace(own, leave_out=own.leave_out - {"levels"}) for own in plan.settings)
    some, whole = scene.render(plan=plan), scene.render(plan=replace(plan, settings=kept))
    left = item(some, "levels")
    assert left["count"] > 0 and 0.0 < left["error"] <= 0.005
    assert "levels" not in {own["name"] for own in whole.report["left_out"]}
    assert 0.0 < error(some.image, whole.image) < left["error"]


def test_grey_light_gives_three_equal_channels(device: Device) -> None:
    image = render(device, "all").image
    assert (image[..., 0] == image[..., 1]).all() and (image[..., 1] == image[..., 2]).all()


def test_colour_is_not_left_out(device: Device, sky: Environment) -> None:
    found = Scene(still_life(), sky, "lambert:albedo=0.5", VIEW, device=device).render(samples=1)
    assert "grey" not in {own["name"] for own in found.report["left_out"]}
    assert np.abs(found.image[..., 0] - found.image[..., 2]).max() > 0


def test_of_a_flat_ground_one_point_serves_all(device: Device) -> None:
    """Every open point of the ground has one normal; all its pixels are alike, to the last bit."""
    plane = trimesh.creation.box((10.0, 0.2, 10.0))
    mesh = Mesh.from_arrays(plane.vertices, plane.faces, None, "plane")
    camera = Camera((0.0, 3.0, 0.1), (0.0, 0.0, 0.0), size=(16, 16))
    found, each, off = (
        Scene(mesh, grey_sky(), "lambert:albedo=0.5", camera, device=device, **own).render(samples=1)
        for own in ({}, {"leave_out": "no-normals"}, {"hard": "off"})
    )
    assert (found.image[..., 3] == 1).all() and np.ptp(found.image[..., 0]) < 1e-6 * found.image[..., 0].max()
    assert item(found, "normals")["count"] == 16 * 16 - 1
    assert error(found.image, each.image) < 1e-3
    # With the sun in the map a point's sum depends on how its grid is turned: nothing is shared.
    assert "normals" not in {own["name"] for own in off.report["left_out"]}


def test_normals_of_glossy_points_are_not_shared(device: Device) -> None:
    found = render(device, "all", spec="ggx:alpha=0.3,f0=0.5")
    assert "normals" not in {own["name"] for own in found.report["left_out"]}


def test_seen_from_behind_nothing_is_shared_with_what_is_seen(device: Device) -> None:
    """The same normals, once to the eye and once away from it: black stays black."""
    plane = trimesh.creation.box((4.0, 0.2, 4.0))
    mesh = Mesh.from_arrays(plane.vertices, plane.faces, None, "plane")
    inside = Mesh.from_arrays(plane.vertices, plane.faces[:, ::-1], None, "inside out")
    camera = Camera((0.0, 3.0, 0.1), (0.0, 0.0, 0.0), size=(8, 8))
    bright, black = (
        Scene(own, Environment.constant(), "lambert:albedo=0.5", camera, device=device, two_sided=False)
        .render(samples=1)
        .image
        for own in (mesh, inside)
    )
    assert bright[4, 4, 0] > 0.4 and not black[4, 4, :3].any()


def test_where_all_is_dark_nothing_is_undefined(device: Device) -> None:
    """No point is worth a product: nothing is launched."""
    mesh = still_life()
    scene = Scene(mesh, grey_sky(), "lambert:albedo=0.5", VIEW, device=device)
    points = vertex_points(mesh, scene.tracer, VIEW.eye, np.arange(50))
    made = Pipeline(device, grey_sky(), scene.materials, scene.settings[0][0])
    bits = np.zeros((50, quadtree.visibility_words(scene.settings[0][0].rays)), dtype=np.uint32)
    assert not made.soft(scene.tracer, points, bits).any()
    assert made.tally["unlit"] == (50, 50)


@pytest.mark.parametrize("leave_out", ["all", "none"])
def test_a_bake_renders_the_same(device: Device, leave_out: str) -> None:
    bake = Bake.trace(still_life(), 4)
    image = (
        Scene(bake, grey_sky(), "lambert:albedo=0.5", VIEW, device=device, leave_out=leave_out).render().image
    )
    plain = (
        Scene(bake, grey_sky(), "lambert:albedo=0.5", VIEW, device=device, leave_out="none").render().image
    )
    assert error(image, plain) < 2e-3


# --- rays, levels, terms -------------------------------------------------------------------------------------


def test_lights_below_the_horizon_are_traced_only_when_asked(mesh: Mesh) -> None:
    tracer = Tracer(mesh.vertices, mesh.faces)
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lights = rng.normal(size=(40, 3))
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    origins = rng.uniform(-1, 1, (200, 3)).astype(np.float32)
    counts, bits = [], []
    for horizon in (True, False):
        before = tracer.rays
        bits.append(tracer.light_visibility(origins, normals, lights, horizon=horizon))
        counts.append(tracer.rays - before)
    assert (bits[0] == bits[1]).all()
    assert counts == [int((normals @ lights.T > 0).sum()), 200 * 40]


def test_matt_lobes_need_few_levels(device: Device) -> None:
    matt = Material.parse("lambert:albedo=0.5")
    assert needed(device, matt, 5) == (5, 0.0)  # what is chosen by default is not too fine
    keep, lost = needed(device, matt, 7)
    assert keep < 7 and 0.0 < lost <= 1e-3
    assert needed(device, matt, 7, cost=0.01)[0] < keep
    assert needed(device, Material.parse("ggx:alpha=0.1,f0=1"), 7) == (7, 0.0)


def test_levels_are_left_out_of_a_plan_unless_kept_by_hand(device: Device) -> None:
    def planned(**settings: Any) -> Render:
        scene = Scene(still_life(), grey_sky(), "lambert:albedo=0.5", VIEW, device=device, **settings)
        return scene.render(error=0.1)

    found = planned()
    levels = item(found, "levels")
    assert levels["count"] >= 1 and levels["bytes"] > 0 and 0.0 < levels["error"] <= 0.01
    assert found.report["settings"][0]["keep"] < found.report["settings"][0]["levels"]
    for other in (planned(keep=5), planned(leave_out="no-levels")):
        assert other.report["settings"][0]["keep"] == 5
        assert "levels" not in {own["name"] for own in other.report["left_out"]}


# --- counts --------------------------------------------------------------------------------------------------


def test_what_was_left_out_is_counted(device: Device) -> None:
    found = render(device, "all", "vertex")
    shaded = found.report["points_shaded"]["vertex"]
    unseen = item(found, "unseen")
    assert unseen["count"] == len(still_life().vertices) - shaded and unseen["of"] == len(
        still_life().vertices
    )
    assert unseen["seconds"] > 0 and unseen["bytes"] > 0
    assert item(found, "grey") | {"seconds": 0, "bytes": 0} == {
        "name": "grey", "count": 2, "of": 3, "unit": "channels", "seconds": 0, "bytes": 0, "error": 0.0,
    }  # fmt: skip
    unshadowed = item(found, "unshadowed")
    assert 0 < unshadowed["count"] < unshadowed["of"] == shaded
    assert all(own["count"] <= own["of"] for own in found.report["left_out"])
    assert not render(device, "none").report["left_out"]


def test_rays_left_out_and_traced_are_all_rays(device: Device) -> None:
    found = render(device, "all", spec="ggx:alpha=0.3,f0=0.5")
    shaded = found.report["points_shaded"]
    every = shaded["soft"] * 4 ** found.report["settings"][0]["rays"]
    lights = found.report["light"]["hard_samples"] * shaded["hard"]
    rays, horizon = item(found, "rays"), item(found, "horizon")
    assert rays["of"] == every and horizon["of"] == lights
    assert found.report["rays"] == every - rays["count"] + lights - horizon["count"]


# --- names ---------------------------------------------------------------------------------------------------


def test_lists_of_names() -> None:
    assert parse("all") == EVERYTHING and parse("none") == frozenset()
    assert parse("grey, rays") == {"grey", "rays"}
    assert parse("no-grey") == EVERYTHING - {"grey"} == parse("all,no-grey")
    assert parse("none,rays") == {"rays"} and parse("grey,rays,no-rays") == {"grey"}
    for bad in ("colour", "no-colour", "", "grey,,rays"):
        with pytest.raises(InputError, match="is none; expected all, none, or names"):
            parse(bad)


def test_unknown_names_are_refused(device: Device) -> None:
    with pytest.raises(InputError, match="leave_out: colour is none"):
        Scene(still_life(), grey_sky(), device=device, leave_out=["colour"])

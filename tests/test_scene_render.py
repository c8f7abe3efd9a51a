"""Whole images: against float64 and closed forms, under rotation, by vertex, by bake, by part; and the report."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.files.image import read_image
from prtcl.scene.bake import Bake
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh, PartMaterial, read_mesh
from prtcl.scene.points import pixel_points, shoot
from prtcl.scene.scene import Render, Scene

Image = NDArray[np.float32]
Array = NDArray[np.float64]

GOLD = "ggx:alpha=0.3,f0=0.9/0.6/0.3"
MATT = "lambert:albedo=0.7/0.5/0.3"
VIEW = Camera((1.5, 2.5, 3.0), (0.0, 0.0, 0.0), size=(24, 20))


@lru_cache
def sphere(subdivisions: int = 3) -> Mesh:
    """Flat facets: convex, so nothing of it hides the sky of any of its points."""
    made = trimesh.creation.icosphere(subdivisions=subdivisions)
    return Mesh.from_arrays(made.vertices, made.faces, None, "sphere")


@lru_cache
def torus(normals: bool = True, sections: int = 24) -> Mesh:
    """It hides parts of its own sky."""
    made = trimesh.creation.torus(1.0, 0.45, major_sections=2 * sections, minor_sections=sections)
    return Mesh.from_arrays(made.vertices, made.faces, made.vertex_normals if normals else None, "torus")


@lru_cache
def smooth_map(height: int = 32) -> Image:
    """Second order in the direction, coloured, contrast about 2: any sampling of it is accurate."""
    theta = np.pi * (np.arange(height) + 0.5)[:, None] / height
    phi = 2 * np.pi * (np.arange(2 * height) + 0.5)[None] / (2 * height)
    x, y, z = np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi, -np.sin(theta) * np.cos(phi)
    return np.stack([3 + x + 0.5 * y, 3 + y * z + 0.5 * x, 3 - z + 0.5 * x * y], axis=-1).astype(np.float32)


def covered(image: Image) -> NDArray[np.bool_]:
    out: NDArray[np.bool_] = image[..., 3] == 1.0
    assert out.sum() > 50
    return out


def relative_rmse(actual: Any, expected: Any) -> float:
    error = float(np.sqrt(((np.asarray(actual, float) - expected) ** 2).mean()) / np.mean(expected))
    print(f"relative RMSE {error:.2e}")
    return error


# --- closed forms and the reference --------------------------------------------------------------------------


@pytest.mark.parametrize("points", ["pixel", "vertex"])
@pytest.mark.parametrize("method", ["pixel", "tree"])
def test_white_furnace(device: Device, points: str, method: str) -> None:
    """In constant light of 1 a convex Lambert body reflects its albedo, everywhere, on any grid."""
    scene = Scene(sphere(), Environment.constant(1.0), MATT, VIEW, device=device, method=method)
    image = scene.render(points=points, samples=1).image
    inside = covered(image)
    assert np.abs(image[inside][:, :3] - [0.7, 0.5, 0.3]).max() < 1e-4
    assert not image[image[..., 3] == 0].any()
    assert set(np.unique(image[..., 3])) == {0.0, 1.0}  # one point a pixel sees it or does not


def by_reference(scene: Scene, pixels: NDArray[np.int64], samples: int) -> Array:
    """The same pixels in float64: 4**7 directions, light, BRDF and rays exact in each, at the same points."""
    out = []
    sub = np.arange(samples**2)
    material = scene.materials[0].reference()
    for pixel in pixels:
        hits = shoot(scene.tracer, scene.camera, np.full_like(sub, pixel), sub)
        points = pixel_points(scene.mesh, scene.tracer, hits, sub[hits.ray])
        radiance = [
            reference.radiance(
                scene.environment.image, material, points.frames[i], hits.towards[i], levels=7,
                position=points.origins[i], occluded=scene.tracer.occluded,
            )
            for i in range(len(points))
        ]  # fmt: skip
        out.append(np.mean(radiance, axis=0))
    return np.array(out)


@pytest.mark.parametrize(
    "spec,normals,fixed",
    [
        (MATT, True, {}),
        (MATT, False, {}),
        # A lobe sees a part of the hemisphere only, and 4 × 4**4 rays leave 1.4 % of it: four times the rays.
        (GOLD, False, {"rays": 5}),
        (GOLD, True, {"rays": 5}),
        ("ggx:alpha=0.3,eta=0.2,k=3", True, {"rays": 5, "method": "tree"}),
    ],
)
def test_a_small_image_against_the_reference(
    device: Device, spec: str, normals: bool, fixed: dict[str, Any]
) -> None:
    """Below 1 %, which is what design.md promises at these levels.

    The smooth map leaves two errors: visibility, 4 points a pixel with 4**4 rays each over a horizon that
    crosses some 2 · 16 cells of 256, each right to a fraction of its share (measured 0.2 to 0.7 %), and f_v's
    bins (0.1 %). 20 pixels estimate the RMSE to about 15 %.
    """
    scene = Scene(torus(normals, 48), Environment(smooth_map()), spec, VIEW, device=device, **fixed)
    image = scene.render(samples=2).image
    inside = np.flatnonzero(covered(image).ravel())
    pixels = np.random.default_rng(4).choice(inside, 20, replace=False)
    expected = by_reference(scene, pixels, 2)
    assert relative_rmse(image.reshape(-1, 4)[pixels, :3], expected) < 0.01


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_samples_are_n_by_n_points(device: Device, samples: int) -> None:
    scene = Scene(sphere(), Environment(smooth_map()), MATT, VIEW, device=device)
    made = scene.render(samples=samples)
    count = samples**2
    assert made.report["points_per_pixel"] == [count]
    alpha = made.image[..., 3] * count
    assert np.abs(alpha - np.round(alpha)).max() < 1e-5
    tracer, pixels = scene.tracer, np.arange(24 * 20)
    hits = shoot(tracer, VIEW, np.repeat(pixels, count), np.tile(np.arange(count), len(pixels)))
    assert (np.round(alpha.ravel()) == np.bincount(hits.ray // count, minlength=len(pixels))).all()
    assert made.report["points_shaded"] == {"soft": len(hits.ray)}


# --- orientation ---------------------------------------------------------------------------------------------


def turned(mesh: Mesh, camera: Camera, rotation: Array) -> tuple[Mesh, Camera]:
    """Mesh and camera turned alike."""
    normals = None if mesh.normals is None else (mesh.normals @ rotation.T).astype(np.float32)
    eye, target, up = (tuple(rotation @ v) for v in (camera.eye, camera.target, camera.up))
    return (
        replace(mesh, vertices=mesh.vertices @ rotation.T, normals=normals),
        replace(camera, eye=eye, target=target, up=up),
    )


def assert_same_picture(actual: Image, expected: Image) -> None:
    """Turned vertices round differently, which moves hits and frames by some 1e-6 of the object, and light that
    turns with it is the same light in the frames: 1e-4 is ample. A ray that grazes a triangle's edge may fall
    to the other side of it: one in 256 of a pixel's, in some pixels.
    """
    assert (actual[..., 3] == expected[..., 3]).mean() > 0.99
    inside = covered(expected) & (actual[..., 3] == 1)
    error = np.abs(actual - expected)[inside].max(axis=1) / expected[inside, :3].mean()
    print(f"median {np.median(error):.1e}, 90 % {np.quantile(error, 0.9):.1e}, worst {error.max():.1e}")
    assert np.quantile(error, 0.9) < 1e-4 and error.max() < 2e-2


@pytest.mark.parametrize("degrees", [30.0, -135.0])
@pytest.mark.parametrize("spec", [MATT, GOLD])
def test_turning_everything_about_the_up_axis_changes_nothing(
    device: Device, degrees: float, spec: str
) -> None:
    """Counter-clockwise seen from above: +z goes to +x."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    mesh, camera = turned(torus(), VIEW, rotation)
    image = smooth_map()
    ours = Scene(torus(), Environment(image), spec, VIEW, device=device).render(samples=1).image
    environment = Environment(image, rotate=degrees)
    theirs = Scene(mesh, environment, spec, camera, device=device).render(samples=1).image
    assert_same_picture(theirs, ours)
    only_light = Scene(torus(), environment, spec, VIEW, device=device).render(samples=1).image
    assert relative_rmse(only_light[..., :3], ours[..., :3]) > 0.05


def test_a_z_up_scene_is_the_y_up_scene_turned(device: Device) -> None:
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # y up to z up, x stays
    mesh, camera = turned(torus(), VIEW, rotation)
    assert camera.up == (0.0, 0.0, 1.0)
    for rotate in (0.0, 70.0):
        ours = Scene(torus(), Environment(smooth_map(), rotate), MATT, VIEW, device=device)
        theirs = Scene(mesh, Environment(smooth_map(), rotate, up="z"), MATT, camera, device=device)
        assert_same_picture(theirs.render(samples=1).image, ours.render(samples=1).image)


def test_units_of_length_do_not_matter(device: Device) -> None:
    mesh = replace(torus(), vertices=torus().vertices * 1e3 + 5e3)
    camera = replace(VIEW, eye=tuple(1e3 * np.array(VIEW.eye) + 5e3), target=(5e3, 5e3, 5e3))
    ours = Scene(torus(), Environment(smooth_map()), GOLD, VIEW, device=device).render(samples=1).image
    theirs = Scene(mesh, Environment(smooth_map()), GOLD, camera, device=device).render(samples=1).image
    assert_same_picture(theirs, ours)


# --- hard light ----------------------------------------------------------------------------------------------

ELEVATION = 40.0


@lru_cache
def sun_map(height: int = 512) -> Image:
    """Half a degree of sun at 40 degrees in the −x direction, in texels of 0.35; black besides."""
    fine = 16
    towards = np.array([-np.cos(np.radians(ELEVATION)), np.sin(np.radians(ELEVATION)), 0.0])
    image = np.zeros((height, 2 * height, 3), dtype=np.float32)
    row, column = int((90 - ELEVATION) / 180 * height), int(0.75 * 2 * height)
    rows, columns = np.arange(row - 4, row + 5), np.arange(column - 4, column + 5)
    theta = np.pi * (np.repeat(rows, fine) + np.tile((np.arange(fine) + 0.5) / fine, 9)) / height
    phi = np.pi * (np.repeat(columns, fine) + np.tile((np.arange(fine) + 0.5) / fine, 9)) / height
    theta, phi = theta[:, None], phi[None]
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi, -np.sin(theta) * np.cos(phi)], -1)
    inside = (d @ towards > np.cos(np.radians(0.25))).astype(np.float64)
    share = inside.reshape(9, fine, 9, fine).mean(axis=(1, 3))
    image[row - 4 : row + 5, column - 4 : column + 5] = 2e4 * share[..., None] * np.array([1.0, 0.9, 0.7])
    return image


def irradiance_on_the_ground(image: Image) -> Array:
    """∫ L cos over the map, texel by texel."""
    height = image.shape[0]
    edges = np.pi * np.arange(height + 1) / height
    # ∫ cos θ sin θ dθ over a row, times a texel's width
    row = (np.sin(edges[1:]) ** 2 - np.sin(edges[:-1]) ** 2) / 2 * (np.pi / height)
    return np.einsum("ijc,i->c", image[: height // 2].astype(float), row[: height // 2])


def shadow(device: Device, **fixed: Any) -> tuple[Array, Array, Render]:
    """Places x on the ground, and the radiance there, across the shadow of a wall along z at x = 0, 1 high."""
    corners = [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9], [0, 0, -6], [0, 0, 6], [0, 1, 6], [0, 1, -6]]
    mesh = Mesh.from_arrays(corners, [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]])
    above = Camera((0.0, 8.0, 0.0), (0.0, 0.0, 0.0), up=(0.0, 0.0, -1.0), fov=30.0, size=(160, 1))
    scene = Scene(mesh, Environment(sun_map()), "lambert:albedo=0.6", above, device=device, **fixed)
    made = scene.render(samples=4)
    half = 8 * np.tan(np.radians(15))
    return ((np.arange(160) + 0.5) / 80 - 1) * half, made.image[0, :, :3].astype(float), made


def test_a_hard_sun_casts_its_shadow_where_it_should(device: Device) -> None:
    x, radiance, made = shadow(device)
    assert made.report["light"]["hard_share"] > 0.99
    expected = 0.6 / np.pi * irradiance_on_the_ground(sun_map())
    length = 1 / np.tan(np.radians(ELEVATION))
    penumbra = 1.0 / np.sin(np.radians(ELEVATION)) ** 2 * np.radians(0.5)
    pitch = x[1] - x[0]
    free = (x < -pitch) | (x > length + penumbra + pitch)
    dark = (x > pitch) & (x < length - penumbra - pitch)
    assert free.sum() > 80 and dark.sum() > 30
    assert (np.abs(radiance[free] / expected - 1) < 1e-3).all()
    assert (radiance[dark] < 1e-3 * expected).all()
    # A pixel's 16 points have 16 places in x: the missing light, in pixels, is the shadow's length.
    measured = (1 - radiance[x > 0, 1] / expected[1]).sum() * pitch
    print(f"shadow {measured:.4f}, expected {length:.4f}, pixel {pitch:.4f}")
    assert abs(measured - length) < pitch / 8


def test_without_hard_light_the_shadow_is_where_the_grid_puts_it(device: Device) -> None:
    """Why there is hard light: 4**4 directions of 9 degrees cannot say where a sun of half a degree is."""
    x, radiance, made = shadow(device, hard="off", levels=4)
    assert made.report["light"]["hard_samples"] == 0
    expected = 0.6 / np.pi * irradiance_on_the_ground(sun_map())
    length, pitch = 1 / np.tan(np.radians(ELEVATION)), x[1] - x[0]
    free = (x < -pitch) | (x > length + 1)
    assert np.abs(radiance[free] / expected - 1).max() > 0.01
    partial = (radiance[:, 1] > 0.05 * expected[1]) & (radiance[:, 1] < 0.95 * expected[1])
    assert partial.sum() > 8  # a penumbra of half a degree covers one or two pixels


# --- vertices and bakes --------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", [MATT, GOLD])
def test_vertices_of_a_fine_sphere_give_the_image_of_its_pixels(device: Device, spec: str) -> None:
    """Edges of 0.035 rad: linear interpolation of a smooth radiance is off by 1e-4 or so, slices' bins by 1e-3."""
    mesh = sphere(5).smooth()
    scene = Scene(mesh, Environment(smooth_map()), spec, VIEW, device=device)
    by_pixel, by_vertex = (scene.render(points=p, samples=1).image for p in ("pixel", "vertex"))
    assert (by_pixel[..., 3] == by_vertex[..., 3]).all()
    # At the rim a vertex may lie beyond the horizon, where nothing is reflected to the eye.
    towards = np.array(VIEW.eye) / np.linalg.norm(VIEW.eye)
    tracer, pixels = scene.tracer, np.arange(24 * 20)
    hits = shoot(tracer, VIEW, pixels, np.zeros_like(pixels))
    place = np.einsum("nc,ncx->nx", hits.barycentric, mesh.vertices[mesh.faces[hits.face]])
    facing = hits.ray[place @ towards > 0.35]
    assert len(facing) > 100
    first, second = (image.reshape(-1, 4)[facing, :3] for image in (by_pixel, by_vertex))
    assert relative_rmse(second, first) < 5e-3


def test_each_vertex_is_shaded_once(device: Device) -> None:
    made = Scene(sphere(1), Environment(smooth_map()), MATT, VIEW, device=device).render(points="vertex")
    assert made.report["points_shaded"]["vertex"] <= 42
    assert made.report["points"] == "vertex"


@pytest.mark.parametrize("spec,bound", [(MATT, 0.01), (GOLD, 0.03)])
def test_a_bake_gives_the_image_of_its_vertices(
    device: Device, tmp_path: Path, spec: str, bound: float
) -> None:
    """Its frames are turned otherwise about the normal, so other rays of the same number are traced.

    Each of two sets of 4**5 rays leaves visibility errors below 1 % for a Lambert surface (design.md's 4**5
    row with a hard sun: 0.7 %), and the images differ by √2 of that at most; a lobe sees a part of them, and a
    fixed frame's slices are bilinear between 128 × 128 views (0.1 %).
    """
    Bake.trace(torus(), rays=5).save(tmp_path / "torus.npz")
    environment = Environment(smooth_map())
    baked = Scene(tmp_path / "torus.npz", environment, spec, VIEW, device=device).render(samples=1)
    direct = Scene(torus(), environment, spec, VIEW, device=device, rays=5).render(points="vertex", samples=1)
    assert baked.report["points"] == "vertex" and baked.report["settings"][0]["rays"] == 5
    assert baked.report["seconds"].get("visibility_rays", 0.0) == 0.0
    inside = covered(direct.image)
    assert (baked.image[..., 3] == direct.image[..., 3]).all()
    assert 0 < relative_rmse(baked.image[inside, :3], direct.image[inside, :3]) < bound


def test_a_bake_keeps_what_it_was_made_of(tmp_path: Path) -> None:
    part = PartMaterial("red", (0.8, 0.1, 0.1), 0.0, 0.9)
    parts = (np.arange(len(sphere(1).faces)) % 2).astype(np.int32)
    mesh = replace(sphere(1), parts=parts, materials=(None, part))
    bake = Bake.trace(mesh, rays=2)
    bake.save(tmp_path / "a.npz")
    again = Bake.load(tmp_path / "a.npz")
    assert again.rays == 2 and again.mesh.name == "sphere" and again.mesh.normals is not None
    assert again.mesh.materials == (None, replace(part, name=""))
    for name in ("vertices", "faces", "normals", "parts"):
        assert (getattr(again.mesh, name) == getattr(bake.mesh, name)).all()
        assert getattr(again.mesh, name).dtype == getattr(bake.mesh, name).dtype
    assert (again.bits == bake.bits).all() and again.bits.any()


@pytest.mark.parametrize("rays", [0, 99])
def test_a_bake_of_impossible_size_is_refused(rays: int) -> None:
    with pytest.raises(InputError, match="rays: expected 1 to"):
        Bake.trace(sphere(1), rays=rays)


@pytest.mark.parametrize(
    "change,word",
    [
        ({"format": 2}, "format 2; this prtcl reads format 1"),
        ({"format": [1, 1]}, "format"),
        ({"rays": 3}, "bits expected"),
        ({"rays": 0}, "bits expected"),
        ({"rays": 1.5}, "rays expected"),
        ({"bits": np.zeros((42, 1), np.int64)}, "bits expected"),
        ({"bits": np.zeros((41, 1), np.uint32)}, "bits expected"),
        ({"vertices": np.zeros((42, 2))}, "vertices expected"),
        ({"vertices": np.full((42, 3), np.nan)}, "vertices are NaN"),
        ({"normals": np.full((42, 3), np.nan, np.float32)}, "normals are NaN"),
        ({"normals": np.zeros((41, 3), np.float32)}, "normals expected"),
        ({"faces": np.full((80, 3), 42, np.int32)}, "faces expected from 0 to 41"),
        ({"faces": np.full((80, 3), -1, np.int32)}, "faces expected from 0 to 41"),
        ({"faces": np.zeros((0, 3), np.int32), "parts": np.zeros(0, np.int32)}, "faces expected"),
        ({"parts": np.ones(80, np.int32)}, "parts expected from 0 to 0"),
        ({"parts": np.zeros(79, np.int32)}, "parts expected"),
        ({"materials": np.zeros((1, 4))}, "materials expected"),
        ({"bits": None}, "is no bake: bits missing"),
    ],
)
def test_a_bake_whose_arrays_do_not_fit_is_refused(tmp_path: Path, change: dict[str, Any], word: str) -> None:
    path = tmp_path / "a.npz"
    Bake.trace(sphere(1), rays=2).save(path)
    with np.load(path) as file:
        data = {**file, **change}
    np.savez(path, **{key: value for key, value in data.items() if value is not None})
    with pytest.raises(InputError) as caught:
        Bake.load(path)
    assert str(path) in str(caught.value) and word in str(caught.value)
    assert len(str(caught.value).splitlines()) <= 2


# --- materials -----------------------------------------------------------------------------------------------


def halves() -> Mesh:
    """The sphere in three parts along x; each a convex piece of one convex body."""
    mesh = sphere()
    centre = mesh.vertices[mesh.faces].mean(axis=1)[:, 0]
    return replace(mesh, parts=np.digitize(centre, [-0.3, 0.3]).astype(np.int32), materials=(None,) * 3)


def test_every_part_has_the_material_it_was_given(device: Device) -> None:
    """Two of them share their settings and so a pipeline, the third has one of its own."""
    specs = [MATT, "ggx:alpha=0.1,f0=0.5", "lambert:albedo=0.2/0.4/0.6"]
    mesh, environment = halves(), Environment(smooth_map())
    both = Scene(mesh, environment, specs, VIEW, device=device).render(samples=1).image.reshape(-1, 4)
    alone = [
        Scene(mesh, environment, spec, VIEW, device=device).render(samples=1).image.reshape(-1, 4)
        for spec in specs
    ]
    pixels = np.arange(24 * 20)
    scene = Scene(mesh, environment, MATT, VIEW, device=device)
    hits = shoot(scene.tracer, VIEW, pixels, np.zeros_like(pixels))
    part = mesh.parts[hits.face]
    for number in range(3):
        own = hits.ray[part == number]
        assert len(own) > 20
        # The same arithmetic but for one channel of light where three are grey: float32 rounding of sums.
        assert np.abs(both[own] / alone[number][own] - 1).max() < 1e-5
        assert np.abs(both[own, :3] / alone[(number + 1) % 3][own, :3] - 1).max() > 0.01


def test_the_meshs_own_materials_are_the_default(device: Device) -> None:
    part = PartMaterial("red", (0.8, 0.1, 0.1), 0.0, 0.9)
    mesh = replace(halves(), materials=(None, part, None))
    scene = Scene(mesh, Environment.constant(), None, VIEW, device=device)
    assert [m.kind for m in scene.materials] == ["lambert", "ggx-schlick", "lambert"]
    assert scene.materials[1].numbers == Material.from_metallic_roughness((0.8, 0.1, 0.1), 0.0, 0.9).numbers
    assert scene.materials[0].numbers == {"albedo": (0.5, 0.5, 0.5)}
    assert Scene(mesh, Environment.constant(), GOLD, VIEW, device=device).materials[0].spec == GOLD


@pytest.mark.parametrize("specs", [[], [MATT], [MATT] * 4])
def test_a_wrong_number_of_materials_is_refused(device: Device, specs: list[str]) -> None:
    with pytest.raises(InputError, match=f"expected one, or 3 for the mesh's parts, got {len(specs)}"):
        Scene(halves(), Environment.constant(), specs, VIEW, device=device)


def test_one_sided_surfaces_seen_from_behind_are_black(device: Device) -> None:
    mesh = Mesh.from_arrays(sphere().vertices, sphere().faces[:, ::-1])
    bright, black = (
        Scene(mesh, Environment.constant(), MATT, VIEW, device=device, two_sided=two).render(samples=1).image
        for two in (True, False)
    )
    inside = covered(bright)
    assert np.abs(bright[inside, :3] - [0.7, 0.5, 0.3]).max() < 1e-4
    assert (black[..., 3] == bright[..., 3]).all() and not black[..., :3].any()


# --- adaptive points -----------------------------------------------------------------------------------------


def test_adaptive_points_go_where_they_are_needed_and_suffice(device: Device) -> None:
    """Three plain parts with jagged seams, and a rim."""
    mesh, specs = halves(), ["lambert:albedo=0.1", "lambert:albedo=0.9", "lambert:albedo=0.4"]
    camera = replace(VIEW, size=(12, 9), fov=30.0)
    # Few rays: in constant light a convex body is exact with any.
    scene = Scene(mesh, Environment.constant(), specs, camera, device=device, rays=2)
    adaptive, exact = scene.render(), scene.render(samples=32).image
    mean = adaptive.report["points_per_pixel"][0]
    print(f"{mean:.1f} points, estimate {adaptive.report['pixel_error_estimate']:.4f}")
    assert 4 < mean < 600
    inside = adaptive.image[..., 3] > 0
    assert relative_rmse(adaptive.image[inside, :3], exact[inside, :3]) < 0.01
    assert adaptive.report["pixel_error_estimate"] <= 0.0071
    coarse = scene.render(samples=2)
    assert relative_rmse(coarse.image[inside, :3], exact[inside, :3]) > 0.02
    assert coarse.report["pixel_error_estimate"] > 0.02


def test_a_smooth_picture_takes_few_points(device: Device) -> None:
    """The sphere fills the image: no rim."""
    camera = replace(VIEW, fov=10.0, size=(12, 10))
    made = Scene(sphere(5).smooth(), Environment(smooth_map()), MATT, camera, device=device).render()
    assert made.report["points_per_pixel"] == [4.0]
    assert (made.image[..., 3] == 1).all()


# --- silhouettes ---------------------------------------------------------------------------------------------


def lamp_map(height: int = 64) -> Image:
    """Constant light of 1 and a lamp at 50 degrees that holds about as much again."""
    image = np.ones((height, 2 * height, 3), dtype=np.float32)
    image[14:16, 10:12] = 1000.0
    return image


@pytest.mark.parametrize("samples", [None, 2, 3])
def test_colour_and_coverage_belong_together(device: Device, samples: int | None) -> None:
    """A flat body has one radiance all over, up to its rim: colour over alpha is the interior's in every pixel.

    Soft and hard light take other numbers of points at a rim. The soft light of two points differs by where their rays
    go, by a thousandth or so: nothing hides any of it.
    """
    corners = [[-1.0, 0.1, -0.9], [1.1, 0.0, -1.0], [0.9, 0.1, 1.0], [-1.0, 0.2, 1.1]]
    flat = Mesh.from_arrays(corners, [[0, 2, 1], [0, 3, 2]], np.tile([[0.0, 1.0, 0.0]], (4, 1)))
    scene = Scene(flat, Environment(lamp_map()), MATT, replace(VIEW, size=(40, 32)), device=device)
    made = scene.render(samples=samples)
    assert 0.2 < made.report["light"]["hard_share"] < 0.8
    colour, alpha = made.image[..., :3].astype(float), made.image[..., 3]
    rim, inside = (alpha > 0) & (alpha < 1), alpha == 1
    assert rim.sum() > 50 and inside.sum() > 100 and not colour[alpha == 0].any()
    expected = colour[inside].mean(axis=0)
    error = np.abs(colour[rim] / alpha[rim, None] / expected - 1)
    print(f"colour over alpha at the rim: worst {error.max():.2e}; inside {np.ptp(colour[inside], axis=0)}")
    assert error.max() < 5e-3
    if (
        samples is None
    ):  # what this is about: the layers' own coverages differ, and alpha is the better of the two
        soft, hard = made.report["points_per_pixel"]
        assert soft != hard
        exact = scene.render(samples=32).image[..., 3]
        assert np.abs(alpha - exact)[rim].max() < 0.07


@pytest.mark.parametrize("lamp", [1.0, 600.0])
def test_a_convex_body_in_constant_light_has_no_fringe(device: Device, lamp: float) -> None:
    """A sphere's rim is nowhere darker than its albedo, nor brighter than the sphere: constant light and a lamp add."""
    image = np.ones((64, 128, 3), dtype=np.float32)
    image[20, 30] = lamp
    scene = Scene(sphere(4), Environment(image), MATT, replace(VIEW, size=(40, 32)), device=device)
    made = scene.render()
    assert (made.report["light"]["hard_samples"] > 0) == (lamp > 1)
    alpha = made.image[..., 3]
    rim, inside = (alpha > 0) & (alpha < 1), alpha == 1
    assert rim.sum() > 30
    ratio = made.image[rim, :3] / alpha[rim, None] / np.float32([0.7, 0.5, 0.3])
    brightest = (made.image[inside, :3] / np.float32([0.7, 0.5, 0.3])).max()
    print(
        f"colour over alpha over albedo: {ratio.min():.4f} … {ratio.max():.4f}, inside up to {brightest:.4f}"
    )
    assert ratio.min() > 1 - 1e-3 and ratio.max() < brightest * (1 + 1e-3)


# --- arguments, repeatability, report ------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [0, -1, 65, 10**9])
def test_samples_out_of_range_are_refused(device: Device, samples: int) -> None:
    scene = Scene(sphere(), Environment.constant(), MATT, VIEW, device=device)
    with pytest.raises(InputError, match=f"samples: expected 1 to 64 .* got {samples}"):
        scene.render(samples=samples)


def test_unknown_points_are_refused(device: Device) -> None:
    scene = Scene(sphere(), Environment.constant(), MATT, VIEW, device=device)
    with pytest.raises(InputError, match="points: expected pixel or vertex, got 'face'"):
        scene.render(points="face")


@pytest.mark.parametrize(
    "fixed,word",
    [
        ({"levels": 0}, "levels"),
        ({"levels": 99}, "levels"),
        ({"rays": 7, "levels": 5}, "rays and keep"),
        ({"keep": 6, "levels": 5}, "rays and keep"),
        ({"method": "fast"}, "method: expected one of auto, pixel, tree"),
        ({"hard": "on"}, "hard-light: expected one of auto, off"),
    ],
)
def test_settings_out_of_range_are_refused(device: Device, fixed: dict[str, Any], word: str) -> None:
    with pytest.raises(InputError, match=word):
        Scene(sphere(), Environment.constant(), MATT, VIEW, device=device, **fixed)


def test_a_camera_inside_or_beside_is_refused_before_anything_is_traced(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    def traced(*_: Any, **__: Any) -> None:
        raise AssertionError("a hemisphere was traced")

    monkeypatch.setattr("prtcl.factors.visibility.Tracer.visibility", traced)
    for eye, target, word in (((0, 0, 0.1), (0, 0, 0), "inside"), ((0, 0, 5), (9, 0, 5), "sees nothing")):
        scene = Scene(sphere(), Environment.constant(), MATT, Camera(eye, target, size=(8, 6)), device=device)
        with pytest.raises(InputError, match=word):
            scene.render()


@pytest.mark.parametrize("points", ["pixel", "vertex"])
def test_the_same_scene_gives_the_same_bits(device: Device, points: str) -> None:
    """Adaptive sampling, threads and all; by the same `Scene`, and by another one, whatever the device did between."""
    image = sun_map(128) + smooth_map(128)
    camera = replace(VIEW, size=(9, 7))
    scenes = [Scene(torus(), Environment(image), GOLD, camera, device=device) for _ in range(2)]
    first = scenes[0].render(points=points)
    assert first.error is not None
    assert len(scenes[0].render(points=points).report["points_per_pixel"]) == (2 if points == "pixel" else 1)
    Scene(torus(), Environment.constant(2.0), MATT, camera, device=device).render(samples=1)
    for scene in scenes:
        again = scene.render(points=points)
        assert again.image.tobytes() == first.image.tobytes()
        assert again.error is not None and again.error.tobytes() == first.error.tobytes()


def test_the_report_says_what_was_done(device: Device, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    light = Environment(sun_map(128) + smooth_map(128))
    scene = Scene(torus(), light, GOLD, VIEW, device=device, visibility="every")
    made = scene.render(samples=1, progress=lambda done, known: seen.append((done, known)))
    report = json.loads(json.dumps(made.report))
    assert report.keys() == {
        "device", "device_reason", "precision", "mesh", "materials", "settings", "light", "points",
        "points_shaded", "rays", "points_per_pixel", "pixel_error_estimate", "seconds", "points_per_second",
        "bytes_per_point", "left_out", "notes",
    }  # fmt: skip
    assert report["device"] == device.name and report["precision"] == "float32"
    assert report["mesh"] == {"name": "torus", "vertices": 1152, "faces": 2304}
    assert report["materials"] == [GOLD] and report["points"] == "pixel" and report["notes"] == []
    count = report["points_shaded"]["soft"]
    assert count == report["points_shaded"]["hard"] == int((made.image[..., 3] > 0).sum())
    settings = report["settings"][0]
    assert settings.keys() >= {"levels", "rays", "keep", "views", "method", "hard", "why"}
    assert report["light"]["hard_samples"] > 0 and 0 < report["light"]["hard_share"] < 1
    # Hard samples below a point's horizon are not traced: some, but not all.
    hard = report["rays"] - count * 4 ** settings["rays"]
    assert 0 < hard < count * report["light"]["hard_samples"]
    fewer = Scene(torus(), light, GOLD, VIEW, device=device).render(samples=1)
    assert fewer.report["rays"] < 0.7 * report["rays"]
    assert relative_rmse(fewer.image, made.image) < 0.003
    seconds = report["seconds"]
    assert seconds["total"] > 0 and all(0 <= value <= seconds["total"] for value in seconds.values())
    assert {"visibility_rays", "hard_light_rays", "inner_product"} <= seconds.keys()
    assert {"visibility_rays", "hard_light_rays", "inner_product"} <= report["points_per_second"].keys()
    assert all(value > 0 for value in report["points_per_second"].values())
    assert all(isinstance(value, int) and value >= 0 for value in report["bytes_per_point"].values())
    assert report["bytes_per_point"]["visibility_bits"] == 4 ** settings["rays"] // 8
    # Every point is counted twice, by the soft and the hard light; the bar ends full.
    assert max(done for done, _ in seen) == 2 * count == seen[-1][1]


def test_the_report_of_mixed_materials(device: Device) -> None:
    """Rays as each material's points take them, and the bytes of the hungriest pipeline, whichever comes last."""
    specs = ["ggx:alpha=0.1,f0=0.5", "lambert:albedo=0.9", "lambert:albedo=0.4"]
    scene = Scene(halves(), Environment.constant(), specs, VIEW, device=device, visibility="every")
    sharp, matt = (own for own, _ in dict(scene.settings).items())
    assert sharp.rays > matt.rays and sharp.keep > matt.keep
    report = scene.render(samples=1).report
    count = report["points_shaded"]["soft"]
    pixels = np.arange(24 * 20)
    part = scene.mesh.parts[shoot(scene.tracer, VIEW, pixels, np.zeros_like(pixels)).face]
    assert len(part) == count and 0 < (part == 0).sum() < count
    assert report["rays"] == 4**sharp.rays * (part == 0).sum() + 4**matt.rays * (part != 0).sum()
    assert report["bytes_per_point"]["visibility_bits"] == 4**sharp.rays // 8
    assert report["bytes_per_point"]["reduced_coefficients"] == 4 * 4**sharp.keep
    assert report["rays"] == scene.render(samples=1).report["rays"]
    for stage, rate in report["points_per_second"].items():
        seconds = report["seconds"][stage]
        assert seconds < 1e-3 or rate == pytest.approx(count / seconds, rel=0.06), stage


def test_an_image_is_saved_as_it_is(device: Device, tmp_path: Path) -> None:
    made = Scene(sphere(), Environment(smooth_map()), MATT, VIEW, device=device).render(samples=2)
    made.save(tmp_path / "a.exr", png=tmp_path / "a.png")
    assert (read_image(tmp_path / "a.exr") == made.image).all()
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_files_arrays_and_objects_are_the_same_scene(device: Device, tmp_path: Path) -> None:
    from prtcl.files.image import write_exr

    image = smooth_map()
    write_exr(tmp_path / "sky.exr", np.dstack([image, np.ones(image.shape[:2], np.float32)]))
    made = trimesh.creation.icosphere(subdivisions=2)
    made.export(tmp_path / "ball.ply")
    from_files = Scene(tmp_path / "ball.ply", tmp_path / "sky.exr", MATT, VIEW, device=device)
    from_objects = Scene(read_mesh(tmp_path / "ball.ply"), image, MATT, VIEW, device=device)
    assert (from_files.render(samples=1).image == from_objects.render(samples=1).image).all()
    framed = Scene(tmp_path / "ball.ply", image, MATT, device=device)
    assert framed.camera == Camera.framing(framed.mesh.bounds)


@pytest.mark.parametrize("method", ["pixel", "tree"])
@pytest.mark.parametrize("radiance", [1e-38, 1e37])
def test_light_at_the_ends_of_float32(device: Device, radiance: float, method: str) -> None:
    """Sums on the device are of the light divided by a power of two: they neither overflow nor vanish."""
    scene = Scene(sphere(), Environment.constant(radiance), MATT, VIEW, device=device, method=method)
    image = scene.render(samples=1).image
    inside = covered(image)
    assert np.allclose(image[inside][:, :3].astype(np.float64) / radiance, [0.7, 0.5, 0.3], rtol=1e-4)


def test_a_huge_tilted_ground_keeps_the_shadow_of_what_stands_on_it(device: Device) -> None:
    """Its corners lie 10⁴ objects away; rays leave the ball by the ball's own rounding, not by the ground's."""
    ball, faces = sphere(3), np.array([[0, 1, 2], [0, 2, 3]])
    slope = np.array([0.3, -1.0, 0.0]) / np.hypot(0.3, 1.0)
    images = []
    for far in (500.0, 1e4):
        x = np.array([[-far, -far], [-far, far], [far, far], [far, -far]]) @ [
            [1.0, 0.3, 0.0],
            [0.0, 0.0, 1.0],
        ]
        both = Mesh.from_arrays(
            np.vstack([ball.vertices, x + 1.2 * slope]), np.vstack([ball.faces, faces + len(ball.vertices)])
        )
        images.append(
            Scene(both, Environment(smooth_map()), MATT, VIEW, device=device).render(samples=1).image
        )
    alone = Scene(ball, Environment(smooth_map()), MATT, VIEW, device=device).render(samples=1).image
    on_ball = covered(alone)
    assert relative_rmse(images[1][on_ball][:, :3], images[0][on_ball][:, :3]) < 0.01
    assert relative_rmse(images[0][on_ball][:, :3], alone[on_ball][:, :3]) > 0.05, "MISTRUSTED: no shadow"

"""Materials that the mesh's own colour multiplies, in scenes and sessions; materials by vertex."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import DEMO_CAMERA

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh, PartMaterial
from prtcl.scene.scene import Scene, own_materials
from prtcl.scene.session import Session
from prtcl.scene.texture import Texture

CAMERA = DEMO_CAMERA
COLOUR = (0.8, 0.4, 0.1)
PAIRS = [
    ("lambert:albedo=mesh", "lambert:albedo=0.8/0.4/0.1"),
    ("lambert:albedo=0.5*mesh", "lambert:albedo=0.4/0.2/0.05"),
    ("ggx:alpha=0.3,f0=0.04,kd=mesh", "ggx:alpha=0.3,f0=0.04,kd=0.8/0.4/0.1"),
    ("gltf:base=mesh,roughness=0.6,metallic=1", "gltf:base=0.8/0.4/0.1,roughness=0.6,metallic=1"),
    ("gltf:base=mesh,roughness=0.6,metallic=0.4", "gltf:base=0.8/0.4/0.1,roughness=0.6,metallic=0.4"),
    ("blinn:exponent=20,ks=0.2*mesh,kd=0.5*mesh", "blinn:exponent=20,ks=0.16/0.08/0.02,kd=0.4/0.2/0.05"),
]


def painted(mesh: Mesh, colours: object = COLOUR) -> Mesh:
    everywhere = np.broadcast_to(np.asarray(colours, dtype=np.float32), mesh.vertices.shape)
    return replace(mesh, colours=everywhere.copy())


def close(a: np.ndarray, b: np.ndarray, tolerance: float) -> None:  # type: ignore[type-arg]
    assert np.abs(a.astype(np.float64) - b).max() <= tolerance * np.abs(b).max()


@pytest.mark.parametrize(("tinted", "plain"), PAIRS)
@pytest.mark.parametrize("points", ["pixel", "vertex"])
def test_a_painted_mesh_looks_as_if_the_material_had_the_colour(
    mesh: Mesh, sky: Environment, device: Device, tinted: str, plain: str, points: str
) -> None:
    options = {"device": device, "levels": 3, "rays": 3, "views": 32}
    # Two sub-pixel points, both the same: adaptive ones go by the colour.
    a = Scene(painted(mesh), sky, tinted, CAMERA, **options).render(points=points, samples=2).image
    b = Scene(mesh, sky, plain, CAMERA, **options).render(points=points, samples=2).image
    # Float32 sums of two renders, one of them taken off the other.
    close(a, b, 1e-5)
    white = Scene(mesh, sky, tinted, CAMERA, **options).render(points=points, samples=2).image
    assert np.abs(white - b).max() > 0.1 * b.max(), "colour matters"


@pytest.mark.parametrize(("tinted", "plain"), PAIRS)
def test_a_session_paints_too(mesh: Mesh, sky: Environment, device: Device, tinted: str, plain: str) -> None:
    options = {"camera": CAMERA, "device": device, "levels": 4, "error": 0.0}
    own = Session(painted(mesh), sky, tinted, **options)
    want = Session(mesh, sky, plain, **options)
    close(own.view().image, want.view().image, 1e-5)
    close(own.radiance(CAMERA.eye), want.radiance(CAMERA.eye), 1e-5)
    own.material = plain
    assert (own.view().image == want.view().image).all()
    own.undo()
    close(own.view().image, want.view().image, 1e-5)


def test_parts_with_and_without(mesh: Mesh, sky: Environment, device: Device) -> None:
    """Of five parts one is tinted with something left, one wholly, the others not."""
    tinted, plain = ["lambert:albedo=0.3"] * 5, ["lambert:albedo=0.3"] * 5
    (tinted[1], plain[1]), (tinted[2], plain[2]) = PAIRS[2], PAIRS[0]
    options = {"camera": CAMERA, "device": device, "levels": 4, "error": 0.0}
    session = [
        Session(m, sky, s, **options).view().image for m, s in ((painted(mesh), tinted), (mesh, plain))
    ]
    close(session[0], session[1], 1e-5)
    scene = [
        Scene(m, sky, s, CAMERA, device=device, levels=3, rays=3, views=32).render(samples=2).image
        for m, s in ((painted(mesh), tinted), (mesh, plain))
    ]
    close(scene[0], scene[1], 1e-5)


def test_a_texture_is_as_sharp_as_the_picture(device: Device) -> None:
    """Two triangles, four vertices, a checker of 8 x 8: no vertex could hold it."""
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    checker = np.zeros((8, 8, 3), dtype=np.uint8)
    checker[np.indices((8, 8)).sum(axis=0) % 2 == 0] = 255
    board = replace(
        Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], np.tile([0.0, 0, 1], (4, 1))),
        uv=((corners[:, :2] * [1, -1] + 1) / 2).astype(np.float32),
        materials=(PartMaterial("board", (1.0, 1.0, 1.0), 0.0, 1.0, Texture(checker)),),
    )
    light = Environment(np.ones((16, 32, 3), dtype=np.float32))
    camera = Camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), fov=28.0, size=(64, 64))
    images = {
        "session": Session(board, light, "lambert:albedo=mesh", camera, device=device, levels=3).view().image,
        "scene": Scene(board, light, "lambert:albedo=mesh", camera, device=device).render(samples=1).image,
    }
    # The albedo of the texel near whose middle each of these pixels lies, row 0 at the top: a pixel is a seventh of it.
    for name, image in images.items():
        edge = np.flatnonzero(image[32, :, 3] > 0)
        place = edge[0] + (np.arange(8) + 0.5) / 8 * (edge[-1] + 1 - edge[0])
        got = image[np.ix_(place.astype(int), place.astype(int))][..., 0]
        assert np.abs(got - (checker[..., 0] / 255.0)).max() < 0.2, name


def test_the_meshs_own_materials_take_its_colours(mesh: Mesh) -> None:
    assert [m.spec for m in own_materials(mesh)] == ["lambert:albedo=0.5"] * 5
    some = np.ones((len(mesh.vertices), 3), dtype=np.float32)
    some[mesh.faces[mesh.parts == 2].ravel()] = COLOUR
    own = own_materials(replace(mesh, colours=some))
    assert [bool(m.tints) for m in own] == [False, False, True, False, False]
    factors = PartMaterial("gold", (1.0, 0.8, 0.3), 1.0, 0.4)
    metal = own_materials(replace(painted(mesh), materials=(factors,) * 5))
    assert metal[0].spec == "gltf:base=1/0.8/0.3*mesh,roughness=0.4,metallic=1"


def test_a_mesh_without_colours_is_white_and_says_so(mesh: Mesh, sky: Environment, device: Device) -> None:
    for own in (Scene(mesh, sky, "lambert:albedo=mesh", CAMERA, device=device),
                Session(mesh, sky, "lambert:albedo=mesh", CAMERA, device=device, levels=3)):  # fmt: skip
        assert any("has no colours of its own" in note for note in own.notes)


def test_materials_by_vertex(mesh: Mesh, sky: Environment, device: Device) -> None:
    specs = ["lambert:albedo=0.8/0.1/0.1", "ggx:alpha=0.3,f0=0.04,kd=0.1/0.4/0.2"]
    which = (mesh.vertices[:, 0] > 0).astype(int)
    options = {"camera": CAMERA, "device": device, "levels": 4}
    both = Session(mesh, sky, specs, assignment=which, **options)
    single = [Session(mesh, sky, spec, **options).radiance(CAMERA.eye) for spec in specs]
    assert (both.radiance(CAMERA.eye) == np.where(which[:, None] == 0, *single)).all()
    both.set_material(1, specs[0])
    assert (both.radiance(CAMERA.eye) == single[0]).all()
    with pytest.raises(InputError, match="part: expected 0 to 1, got 2"):
        both.set_material(2, specs[0])


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        (np.zeros(3, dtype=int), "expected .* integers, one a vertex"),
        (0.5, "expected .* integers, one a vertex"),
        ("beyond", "expected from 0 to 1 for the 2 materials listed, got 2"),
    ],
)
def test_a_wrong_assignment_is_named(
    mesh: Mesh, sky: Environment, device: Device, assignment: object, message: str
) -> None:
    given = np.full(len(mesh.vertices), 2) if isinstance(assignment, str) else assignment
    with pytest.raises(InputError, match=message):
        Session(mesh, sky, ["lambert:albedo=0.1"] * 2, assignment=given, device=device, levels=3)

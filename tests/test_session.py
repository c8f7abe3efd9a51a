"""An editing session: what each change recomputes, and that its images are those of a fresh one and of `Scene`."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from cases import DEMO_CAMERA
from PIL import Image

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.scene.bake import Bake
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.scene import Scene
from prtcl.scene.session import Session

GOLD, PLASTER = "ggx:alpha=0.3,eta=0.2/0.4/1.3,k=3.4/2.3/1.8", "lambert:albedo=0.6/0.5/0.4"
GLAZE = "ggx:alpha=0.1,f0=0.04,kd=0.1/0.4/0.2"
CAMERA = DEMO_CAMERA
SIZE = CAMERA.size


def session(mesh: Mesh, sky: Environment, device: Device, **options) -> Session:  # type: ignore[no-untyped-def]
    return Session(mesh, sky, PLASTER, CAMERA, device=device, levels=4, **options)


def relative_rmse(a, b) -> float:  # type: ignore[no-untyped-def]
    return float(np.sqrt(((a.astype(np.float64) - b) ** 2).mean()) / b.mean())


def test_a_change_recomputes_what_it_must_and_no_more(mesh: Mesh, sky: Environment, device: Device) -> None:
    own = session(mesh, sky, device)
    own.view()
    assert set(own.last.seconds) == {
        "light",
        "camera_rays",
        "visibility",
        "collapse",
        "cuts",
        "shade",
        "image",
    }
    own.view()
    assert set(own.last.seconds) == {"shade", "image"}
    own.material = GOLD
    own.view()
    assert set(own.last.seconds) == {"cuts", "shade", "image"}
    traced = own.last.points["shade"]
    own.view(eye=(3.0, 2.6, 5.4))
    assert "cuts" not in own.last.seconds
    assert 0 < own.last.points["visibility"] < traced, "only vertices that came into sight"
    own.rotate_light(25.0)
    own.view()
    assert set(own.last.seconds) == {"light", "collapse", "cuts", "shade", "image"}
    assert own.last.points["collapse"] == own.last.points["shade"] < len(mesh.vertices)


def test_edits_in_a_row_end_where_a_fresh_session_starts(
    mesh: Mesh, sky: Environment, device: Device
) -> None:
    """A thousand of them; what is kept for them stays bounded."""
    own, rng = session(mesh, sky, device), np.random.default_rng(0)
    specs = [PLASTER, GOLD, GLAZE, "blinn:exponent=30,ks=0.4,kd=0.2"]
    for step in range(1000):
        kind = rng.integers(0, 20)
        if kind == 0:
            own.rotate_light(float(rng.integers(0, 8) * 45))
        elif kind < 8:
            own.set_material(int(rng.integers(0, 5)), specs[rng.integers(0, 4)])
        elif kind < 10:
            own.undo() if kind == 8 else own.redo()
        else:
            eye = tuple(np.array(CAMERA.eye) + rng.uniform(-0.3, 0.3, 3))
            own.view(replace(CAMERA, eye=eye, size=(12, 9))) if step % 4 == 0 else None
    last = own.view(CAMERA).image
    fresh = Session(mesh, own.light, list(own.materials), CAMERA, device=device, levels=4)
    assert (fresh.view().image == last).all()
    assert len(own._viewfinder) <= 4
    assert len(own._relit._cuts) <= 8


@pytest.mark.parametrize("spec", [PLASTER, GOLD])
def test_its_images_are_those_of_a_scene(mesh: Mesh, sky: Environment, device: Device, spec: str) -> None:
    """The same vertices, frames, rays and light; a scene's f_v comes from slices, the session's from cuts."""
    bake = Bake.trace(mesh, 4)
    first = Scene(bake, sky, spec, CAMERA, device=device, levels=4, keep=4, views=128).render(samples=1).image
    # Vertices of a scene keep the side of their normals.
    own = Session(bake, sky, spec, CAMERA, device=device, levels=4, error=0.003, two_sided=False)
    second = own.view().image
    assert (first[..., 3] == second[..., 3]).all()
    inside = first[..., 3] > 0
    assert relative_rmse(second[inside][:, :3], first[inside][:, :3]) < 0.005
    own.error = 0.0
    assert relative_rmse(own.view().image[inside][:, :3], first[inside][:, :3]) < 0.005


def test_surfaces_are_shaded_on_the_side_that_is_seen(sky: Environment, device: Device) -> None:
    """An open bowl from above: its inside, whichever way normals and winding point. From below, its outside."""
    bowl = trimesh.creation.icosphere(subdivisions=3)
    bowl.update_faces(bowl.triangles_center[:, 1] < 0.0)
    outwards = np.asarray(bowl.vertices) / np.linalg.norm(bowl.vertices, axis=1, keepdims=True)
    above = Camera((0.3, 3.0, 0.4), (0, 0, 0), fov=50, size=SIZE)
    below = replace(above, eye=(0.3, -3.0, 0.4))
    images, traced = [], []
    for sign in (1.0, -1.0):
        for faces in (bowl.faces, bowl.faces[:, ::-1]):
            mesh = Mesh.from_arrays(bowl.vertices, faces, sign * outwards)
            own = Session(mesh, sky, PLASTER, above, device=device, levels=4, error=0.0)
            first = own.view().image
            under = own.view(below).image
            traced.append(own.last.points.get("visibility", 0))
            assert (own.view(above).image == first).all(), "turned there and back"
            images.append((first, under))
            one = Session(mesh, sky, PLASTER, above, device=device, levels=4, two_sided=False)
            assert (one.view().image[..., :3].max() > 0) == (sign < 0)
    assert min(traced) > 0
    for first, under in images[1:]:
        # Frames differ by a mirror, and with them where samples lie.
        assert relative_rmse(first, images[0][0]) < 0.02
        assert relative_rmse(under, images[0][1]) < 0.02
    assert images[0][0][..., :3].max() > 0


def test_cuts_err_by_what_they_say(mesh: Mesh, sky: Environment, device: Device) -> None:
    own = session(mesh, sky, device)
    own.material = GOLD
    own.error = 0.0
    exact = own.view().image[..., :3]
    leaves = []
    for error in (0.05, 0.02, 0.005):
        own.error = error
        made = own.view()
        assert made.report["expected_error"] <= error
        assert relative_rmse(made.image[..., :3], exact) < error
        leaves.append(len(own._outfit.full.cuts[0].leaves))
    assert leaves == sorted(leaves)
    assert leaves[0] < leaves[-1]


def test_sessions_and_renders_show_themselves(mesh: Mesh, sky: Environment, device: Device) -> None:
    """In notebooks: PNG bytes of the picture's size."""
    own = session(mesh, sky, device)
    for shown in (own, own.view(), Scene(mesh, sky, PLASTER, CAMERA, device=device, levels=3)):
        assert Image.open(io.BytesIO(shown._repr_png_())).size == SIZE


@pytest.mark.parametrize("sun", [0.0, 1e4])
@pytest.mark.parametrize(
    "spec", [PLASTER, "ggx:alpha=0.2,f0=0.9", "ggx:alpha=0.05,f0=0.9", "ggx:alpha=0.2,f0=0.04,kd=0.5",
             "blinn:exponent=500,ks=0.5", "ggx:alpha=0.053,f0=0.9", "ggx:alpha=0.4,eta=0.2/0.9/1.3,k=3.9/2.4/2"]
)  # fmt: skip
def test_cuts_hold_under_flat_light_too(device: Device, spec: str, sun: float) -> None:
    """A white furnace: no detail in the light, and f in a leaf's middle is not its mean. Lobes between two steps."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    mesh = Mesh.from_arrays(ball.vertices, ball.faces)
    light = np.ones((32, 64, 3), dtype=np.float32)
    light[8, 20] += sun
    own = Session(mesh, light, spec, device=device, levels=5, camera=replace(CAMERA, target=(0, 0, 0)))
    own.error = 0.0
    exact = own.view().image[..., :3]
    for error in (0.05, 0.01):
        own.error = error
        made = own.view()
        assert made.report["expected_error"] <= error
        # One view of a few hundred vertices may have it worse than five hundred views from everywhere.
        assert relative_rmse(made.image[..., :3], exact) < 2 * error


def test_undo_redo_and_snapshots(mesh: Mesh, sky: Environment, device: Device) -> None:
    own = session(mesh, sky, device)
    assert not own.undo()
    own.snapshot("first")
    own.material = GOLD
    own.set_material(2, GLAZE)
    assert own.undo()
    assert [m.spec for m in own.materials] == [GOLD] * 5
    assert own.redo()
    assert own.materials[2].spec == GLAZE
    assert not own.redo()
    own.restore("first")
    assert own.material.spec == PLASTER
    assert own.snapshots == ("first",)
    assert own.undo()
    assert own.materials[2].spec == GLAZE
    with pytest.raises(InputError, match="no 'second' was taken; there are: first"):
        own.restore("second")


def test_mistakes_are_named(mesh: Mesh, sky: Environment, device: Device) -> None:
    own = session(mesh, sky, device)
    with pytest.raises(InputError, match="part: expected 0 to 4, got 5"):
        own.set_material(5, GOLD)
    with pytest.raises(InputError, match="expected one, or 5"):
        own.material = [GOLD, GOLD]
    with pytest.raises(InputError, match="expected a text such as"):
        own.material = 5
    with pytest.raises(InputError, match="samples: expected 1 to 16"):
        own.view(samples=0)
    with pytest.raises(InputError, match="error: expected 0 or more and below 1"):
        own.error = -0.1
    with pytest.raises(InputError, match="vertices: expected indices"):
        own.radiance(CAMERA.eye, [len(mesh.vertices)])
    with pytest.raises(InputError, match="vertices: expected integers"):
        own.radiance(CAMERA.eye, [0.5])
    with pytest.raises(InputError, match="eye: expected three finite numbers"):
        own.radiance((np.nan, 0, 0))
    for wrong in ({"levels": 0}, {"levels": 4, "rays": 5}, {"levels": 4.5}):
        with pytest.raises(InputError, match=r"levels: expected 1 to|rays: expected 1 to 4, at most levels"):
            Session(mesh, sky, device=device, **wrong)
    assert isinstance(own.material, Material)
    with pytest.raises(InputError, match="rays: the bake has 2 levels, got 4"):
        Session(Bake.trace(mesh, 2), sky, device=device, rays=4)

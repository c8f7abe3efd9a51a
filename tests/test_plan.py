"""`--error`: what is predicted is what is found, plans are kept and reused, what cannot be met is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.files.image import read_image
from prtcl.scene.bake import Bake
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.pilot import Noise, Pilot, Squared, likely, told
from prtcl.scene.plan import Plan
from prtcl.scene.planner import confidence
from prtcl.scene.scene import Render, Scene
from prtcl.scene.session import Session
from prtcl.transport.settings import Settings

Image = NDArray[np.float32]

VIEW = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(64, 48))
GLOSSY = "ggx:alpha=0.3,f0=0.5/0.6/0.3,kd=0.3"


def scene(device: Device, mesh: Mesh, sky: Environment, spec: str = GLOSSY, **settings: Any) -> Scene:
    return Scene(mesh, sky, spec, VIEW, device=device, **settings)


@pytest.fixture(scope="module")
def fine(mesh: Mesh, sky: Environment) -> Image:
    """The picture at 64 points a pixel, whose rays together are finer than any plan's."""
    made = Scene(mesh, sky, GLOSSY, VIEW, levels=6, rays=4, keep=6)
    return made.render(samples=8).image


@pytest.fixture(scope="module")
def planned(mesh: Mesh, sky: Environment) -> Render:
    return Scene(mesh, sky, GLOSSY, VIEW).render(error=0.02)


def error_of(image: Image, fine: Image) -> float:
    seen = (image[..., 3] > 0) | (fine[..., 3] > 0)
    off = (image - fine)[seen][:, :3].astype(np.float64)
    return float(np.sqrt((off**2).mean()) / fine[seen][:, :3].mean())


# --- what is predicted ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("asked", [0.05, 0.02])
def test_predicted_and_true_error_agree(
    device: Device, mesh: Mesh, sky: Environment, fine: Image, asked: float
) -> None:
    render = scene(device, mesh, sky).render(error=asked)
    assert render.plan is not None
    true = error_of(render.image, fine)
    print(f"asked {asked} predicted {render.plan.predicted:.4f} true {true:.4f}")
    assert 1 / 1.5 < render.plan.predicted / true < 1.5
    assert render.plan.predicted <= asked
    assert 0.5 < render.plan.confidence <= 1.0


def test_less_error_takes_more_points(device: Device, mesh: Mesh, sky: Environment, planned: Render) -> None:
    rough = scene(device, mesh, sky).render(error=0.1)
    assert sum(rough.report["points_shaded"].values()) < 0.7 * sum(planned.report["points_shaded"].values())


def test_the_error_picture_adds_up(planned: Render, fine: Image) -> None:
    """Its root mean square is the predicted error; and the pixels it calls worst err more than the others."""
    assert planned.error is not None and planned.plan is not None
    assert planned.error.shape == planned.image.shape[:2] and planned.error.dtype == np.float32
    seen = planned.image[..., 3] > 0
    mean = planned.image[seen][:, :3].mean()
    found = np.sqrt((planned.error[seen].astype(np.float64) ** 2).mean()) / mean
    assert 0.5 < found / planned.plan.predicted < 2.0
    off = np.abs((planned.image - fine)[..., :3].mean(axis=2))[seen]
    worst = planned.error[seen] > np.median(planned.error[seen])
    assert np.sqrt((off[worst] ** 2).mean()) > 1.5 * np.sqrt((off[~worst] ** 2).mean())


def test_the_error_is_a_channel_of_the_file(planned: Render, tmp_path: Path) -> None:
    planned.save(tmp_path / "with.exr", error=True)
    planned.save(tmp_path / "without.exr")
    channels = OpenEXR.File(str(tmp_path / "with.exr"), separate_channels=True).channels()
    assert set(channels) == {"R", "G", "B", "A", "error"}
    assert (channels["error"].pixels == planned.error).all()
    assert "error" not in OpenEXR.File(str(tmp_path / "without.exr"), separate_channels=True).channels()
    assert (read_image(tmp_path / "with.exr") == read_image(tmp_path / "without.exr")).all()
    with pytest.raises(InputError, match="holds no estimate"):
        replace(planned, error=None).save(tmp_path / "none.exr", error=True)


def test_without_a_plan_the_error_is_on_the_safe_side(
    device: Device, mesh: Mesh, sky: Environment, fine: Image
) -> None:
    render = scene(device, mesh, sky).render(samples=4)
    assert render.plan is None and render.error is not None
    seen = render.image[..., 3] > 0
    assert np.sqrt((render.error[seen] ** 2).mean()) / render.image[seen][:, :3].mean() > error_of(
        render.image, fine
    )


def test_vertices_have_a_plan_of_their_own(device: Device, mesh: Mesh, sky: Environment) -> None:
    """Held against the same vertices at more directions and rays; interpolation is no error."""
    made = scene(device, mesh, sky)
    render = made.render(points="vertex", error=0.03)
    assert render.plan is not None and render.plan.points == "vertex"
    best = scene(device, mesh, sky, levels=7, rays=7, keep=7, views=256).render(points="vertex")
    true = error_of(render.image, best.image)
    print(f"predicted {render.plan.predicted:.4f} true {true:.4f}")
    assert true < 0.03 and 1 / 2 < render.plan.predicted / true < 2


def test_a_bake_has_its_rays_and_a_plan(device: Device, mesh: Mesh, sky: Environment) -> None:
    render = Scene(Bake.trace(mesh, 5), sky, GLOSSY, VIEW, device=device).render(error=0.1)
    assert render.plan is not None and render.plan.settings[0].rays == 5


def test_every_part_has_settings_of_its_own(device: Device, mesh: Mesh, sky: Environment) -> None:
    parts = len(mesh.materials)
    specs = ["lambert:albedo=0.5", "ggx:alpha=0.1,f0=0.9"] * parts
    render = Scene(mesh, sky, specs[:parts], VIEW, device=device).render(error=0.05)
    assert render.plan is not None and len(render.plan.settings) == parts
    assert len({own.levels for own in render.plan.settings}) == 2


def test_black_pictures_have_a_plan(device: Device, mesh: Mesh) -> None:
    render = scene(device, mesh, Environment.constant(0.0)).render(error=0.01)
    assert render.plan is not None and not render.image[..., :3].any()


def test_a_mesh_of_few_pixels_is_found(device: Device, mesh: Mesh, sky: Environment) -> None:
    """Of a large picture not all pixels are looked at, unless too few of those see the mesh."""
    far = replace(VIEW, eye=(310.0, 250.0, 540.0), size=(640, 400))
    pilot = Pilot(Scene(mesh, sky, GLOSSY, far, device=device))
    whole = Scene(mesh, sky, GLOSSY, far, device=device).render(samples=2).image[..., 3]
    assert 0 < pilot.covered == (whole > 0).sum() == len(pilot.pixels) < 128 and pilot.mean > 0.0


def test_points_are_audited_whatever_the_hard_light(device: Device, mesh: Mesh) -> None:
    """A light without peaks has one layer only."""
    render = scene(device, mesh, Environment.constant(1.0), "lambert:albedo=0.5").render(error=0.02)
    assert render.plan is not None and render.plan.predicted <= 0.02
    assert len(render.report["points_per_pixel"]) == 1


@pytest.mark.parametrize("asked", [0.05, 0.02])
def test_a_session_has_a_plan(device: Device, mesh: Mesh, sky: Environment, asked: float) -> None:
    """Its vertices against float64 at many more directions."""
    session = Session.planned(mesh, sky, GLOSSY, VIEW, error=asked, device=device)
    plan = session.plan
    assert plan is not None and plan.predicted <= asked and 0.0 < plan.error < asked
    fine = Session(mesh, sky, GLOSSY, VIEW, device=device, levels=7, error=0.0)
    true = error_of(session.view().image, fine.view().image)
    print(f"asked {asked}: 4^{plan.levels}, 4^{plan.rays}, predicted {plan.predicted:.4f} true {true:.4f}")
    assert true < asked and plan.predicted / true < 3.0


def test_what_is_fixed_of_a_session_stays(device: Device, mesh: Mesh, sky: Environment) -> None:
    plan = Session.planned(mesh, sky, GLOSSY, VIEW, error=0.1, device=device, levels=6, rays=4).plan
    assert plan is not None and (plan.levels, plan.rays) == (6, 4)
    plan = Session.planned(Bake.trace(mesh, 4), sky, GLOSSY, VIEW, error=0.1, device=device).plan
    assert plan is not None and plan.rays == 4


# --- what cannot be met, and what a user fixes --------------------------------------------------------------


def test_an_error_that_nothing_meets_is_refused(device: Device, mesh: Mesh, sky: Environment) -> None:
    made = scene(device, mesh, sky, "ggx:alpha=0.1,f0=0.9", levels=3, rays=3, keep=3, views=4)
    with pytest.raises(InputError, match=r"error 0.001: no setting that was tried meets it"):
        made.render(error=0.001)
    with pytest.raises(InputError, match=r"no setting that was tried meets it"):
        Session.planned(mesh, sky, GLOSSY, VIEW, error=0.001, device=device, levels=3, rays=2)
    vertices = scene(device, mesh, sky, rays=2)
    with pytest.raises(InputError, match=r"no setting that was tried meets it"):
        vertices.render(points="vertex", error=0.005)
    # Finer than the reference can tell, or than it has told the finest to be.
    with pytest.raises(
        InputError, match=r"what vertices err can be told to|no setting that was tried meets it"
    ):
        scene(device, mesh, sky, "lambert:albedo=0.5").render(points="vertex", error=0.00001)


@pytest.mark.parametrize("error", [0.0, -1.0, 1.0, float("nan"), float("inf")])
def test_errors_out_of_range_are_refused(device: Device, mesh: Mesh, sky: Environment, error: float) -> None:
    with pytest.raises(InputError, match="between 0 and 1"):
        scene(device, mesh, sky).render(error=error)


def test_points_are_fixed_or_sought(device: Device, mesh: Mesh, sky: Environment) -> None:
    with pytest.raises(InputError, match="samples and error"):
        scene(device, mesh, sky).render(samples=2, error=0.1)


def test_what_is_fixed_by_hand_stays(device: Device, mesh: Mesh, sky: Environment) -> None:
    made = scene(device, mesh, sky, rays=4, levels=6)
    plan = made.plan(0.05)
    assert {own.rays for own in plan.settings} == {4} and {own.levels for own in plan.settings} == {6}
    assert len(plan.trials) == 1


def test_what_cannot_be_told_from_nothing_counts_little() -> None:
    for own in (told, likely):
        assert [own(Squared(*known)) for known in ((4.0, 0.0), (-1.0, 2.0), (0.0, 0.0))] == [4.0, 0.0, 0.0]
    assert likely(Squared(1.0, 1.0)) == 0.5 and likely(Squared(1.0, 3.0)) == 0.1
    assert told(Squared(1.0, 0.4)) == 1.0 and told(Squared(1.0, 0.6)) == 0.0


@pytest.mark.parametrize("share", [1.0, 0.1, 0.01])
def test_points_go_where_the_noise_is(share: float) -> None:
    """Of pixels whose squared errors fall as 1 / N a share has all the noise: that share of the points is enough."""
    count = 200_000
    halves = np.zeros((2, count, 3))
    halves[0, : round(share * count)] = np.random.default_rng(0).normal(size=(round(share * count), 1))
    found = Noise(Squared(0.0, 0.0), 0.0, 0.0, halves).gathered(1.0)
    assert abs(found / share - 1.0) < 5 * 2.0 / np.sqrt(share * count)


def test_confidence_is_that_of_a_normal_error() -> None:
    assert confidence(0.01, 1e-4, 1e-5) == 0.5
    assert abs(confidence(0.01, 1e-4 - 1e-5, 1e-5) - 0.8413) < 1e-4
    assert confidence(0.01, 2e-4, 0.0) == 0.0 and confidence(0.01, 0.5e-4, 0.0) == 1.0


# --- plans kept ----------------------------------------------------------------------------------------------


def test_a_plan_reused_gives_the_same_bytes(
    device: Device, mesh: Mesh, sky: Environment, planned: Render
) -> None:
    """No pilot, no audit, nothing timed: settings alone."""
    assert planned.plan is not None and planned.plan.steered
    first, second = (scene(device, mesh, sky).render(plan=planned.plan) for _ in (0, 1))
    assert (first.image == second.image).all() and (first.error == second.error).all()
    assert first.report["plan"]["audits"] == 0


def test_a_plan_reused_errs_as_it_says(
    device: Device, mesh: Mesh, sky: Environment, planned: Render, fine: Image
) -> None:
    assert planned.plan is not None
    again = scene(device, mesh, sky).render(plan=planned.plan)
    assert 1 / 1.5 < planned.plan.predicted / error_of(again.image, fine) < 1.5


def test_a_plan_from_before_is_steered(device: Device, mesh: Mesh, sky: Environment) -> None:
    made = scene(device, mesh, sky)
    plan = made.plan(0.05)
    assert not plan.steered
    render = made.render(plan=plan)
    assert render.plan is not None and render.plan.steered and render.report["plan"]["audits"] > 0


def test_what_a_plan_says_is_doubted_elsewhere(
    device: Device, mesh: Mesh, sky: Environment, planned: Render
) -> None:
    """Another scene, or something fixed by hand in its place: what the picture errs is then not known."""
    plan = planned.plan
    assert plan is not None and planned.report["plan"]["doubt"] is None
    rays = plan.settings[0].rays

    def doubt(spec: str = GLOSSY, samples: int | None = None, **settings: Any) -> str | None:
        report = scene(device, mesh, sky, spec, **settings).render(plan=plan, samples=samples).report
        return report["plan"]["doubt"]

    assert doubt() is None and doubt(rays=rays) is None
    assert "for the materials" in (doubt("ggx:alpha=0.2,f0=0.5") or "")
    for by_hand in (doubt(samples=1), doubt(rays=rays - 1)):
        assert by_hand is not None and "by hand" in by_hand


def test_of_near_mirrors_no_error_is_promised(device: Device, mesh: Mesh, sky: Environment) -> None:
    """Under hard light; of an even one nothing is missed."""
    mirror = "ggx:alpha=0.02,f0=0.9"
    report = scene(device, mesh, sky, mirror).render(error=0.3).report
    assert "alpha 0.02 may fall between" in report["plan"]["doubt"]
    even = scene(device, mesh, Environment.constant(1.0), mirror).render(error=0.3).report
    assert even["plan"]["doubt"] is None


def test_a_plan_is_kept_in_a_file(planned: Render, tmp_path: Path) -> None:
    assert planned.plan is not None
    planned.plan.save(tmp_path / "plan.json")
    assert Plan.load(tmp_path / "plan.json") == planned.plan
    assert len(planned.plan.explain()) == 2 + len(planned.plan.trials)


def test_files_that_are_no_plans_are_refused(planned: Render, tmp_path: Path) -> None:
    assert planned.plan is not None
    path = tmp_path / "plan.json"
    planned.plan.save(path)
    whole = path.read_text()
    data = json.loads(whole)
    changes: list[dict[str, object]] = [
        {"format": 99}, {"settings": []}, {"settings": [{"levels": 99}]}, {"points": "voxel"}, {"surprise": 1},
        {"asked": 5}, {"asked": float("nan")}, {"predicted": -1.0}, {"predicted": "x"}, {"noise_ratio": -1.0},
        {"noise_ratio": True}, {"bias": None}, {"confidence": 2.0}, {"steered": 1}, {"scene": []}, {"scene": {"x": 1}},
        {"trials": [{**data["trials"][0], "noise": []}]},
    ]  # fmt: skip
    wrong = ({"levels": 5.0}, {"keep": True}, {"views": 0}, {"views": "many"}, {"pixel_error": float("inf")})
    changes += [{"settings": [{**data["settings"][0], **own}]} for own in wrong]
    broken = ["", "[]", "{}", whole[: len(whole) // 2], *(json.dumps({**data, **own}) for own in changes)]
    for text in broken:
        path.write_text(text)
        with pytest.raises(InputError, match=r"plan\.json|levels"):
            Plan.load(path)
    with pytest.raises(InputError, match="cannot be read"):
        Plan.load(tmp_path / "missing.json")


def test_a_plan_of_other_points_or_materials_is_refused(
    device: Device, mesh: Mesh, sky: Environment, planned: Render
) -> None:
    plan = planned.plan
    assert plan is not None
    with pytest.raises(InputError, match="plan: made for the pixel points of 1 materials, got vertex"):
        scene(device, mesh, sky).render(points="vertex", plan=plan)
    with pytest.raises(InputError, match="plan: made for the pixel points of 2 materials"):
        scene(device, mesh, sky).render(plan=replace(plan, settings=(Settings(), Settings())))

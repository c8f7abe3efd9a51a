"""Several materials from one collapse, and which factorization serves a batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.scene.view_points import ViewPoints
from prtcl.transport import collapse
from prtcl.transport.engine_choice import Choice, Cost, choose_engine, decide
from prtcl.transport.looks import Looks
from prtcl.transport.pipeline import Pipeline, Points
from prtcl.transport.settings import Settings

CAMERA = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(24, 18))
SETTINGS = Settings(levels=4, rays=3, keep=4, views=16)


@pytest.fixture(scope="module")
def tracer(mesh: Mesh) -> Tracer:
    return Tracer(mesh.vertices, mesh.faces)


@pytest.fixture(scope="module")
def view(mesh: Mesh, tracer: Tracer) -> ViewPoints:
    return ViewPoints.of(mesh, tracer, CAMERA, 2)


def looks() -> list[list[Material]]:
    """Two looks of the demo's five parts, all grey, so that one look alone takes the same kernels."""
    specs = ("lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.04", "lambert:albedo=0.2", "blinn:exponent=20,ks=0.4")
    return [
        [Material.parse(specs[part % len(specs)]) for part in range(5)],
        [Material.parse(specs[(part + 1) % len(specs)]) for part in range(5)],
    ]


@pytest.mark.parametrize("budget", [None, 1 << 20])
def test_every_look_is_what_its_own_pipeline_gives(
    device: Device, tracer: Tracer, view: ViewPoints, sky: Environment, budget: int | None
) -> None:
    together = Looks(device, sky, looks(), SETTINGS, budget=budget)
    assert len(together.pipeline.light.hard)
    got = together.radiance(tracer, view.points)
    assert got.shape == (2, len(view.points), 3) and (got[0] != got[1]).mean() > 0.5
    for look, own in zip(looks(), got, strict=True):
        alone = Pipeline(device, sky, look, SETTINGS)
        assert (alone.radiance(tracer, view.points) == own).all()


def test_the_collapse_is_done_once(
    device: Device, tracer: Tracer, view: ViewPoints, sky: Environment, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, real = [], collapse.reduced_coefficients

    def counted(*arguments: object, **options: object) -> object:
        calls.append(len(arguments[3]))  # type: ignore[arg-type]
        return real(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(collapse, "reduced_coefficients", counted)
    engine = Looks(device, sky, looks() * 3, SETTINGS)
    bits = engine.pipeline.visibility(tracer, view.points)
    rays = tracer.rays
    engine.soft(tracer, view.points, bits)
    assert sum(calls) == len(view.points) and tracer.rays == rays
    engine.hard(tracer, view.points)
    assert 0 < tracer.rays - rays <= len(view.points) * len(engine.pipeline.light.hard)


def test_settings_are_those_of_the_sharpest(device: Device) -> None:
    sharp = [[Material.parse("lambert:albedo=0.5")], [Material.parse("ggx:alpha=0.1,f0=0.04")]]
    assert Looks(device, Environment.constant(), sharp).pipeline.settings.levels == 6


@pytest.mark.parametrize("wrong", [[], [[]], [[Material.parse("lambert:albedo=0.5")], []]])
def test_looks_of_other_lengths_are_refused(device: Device, wrong: list[list[Material]]) -> None:
    with pytest.raises(InputError, match="looks"):
        Looks(device, Environment.constant(), wrong)


def test_the_cheaper_engine_is_taken_and_the_reason_says_why() -> None:
    light, view = Cost(once=0.5, each=1.0), Cost(once=5.0, each=0.1, apart=0.01)
    assert view.total(10, 2.0) == pytest.approx(2 * (5 + 1) + 0.1)
    few, many = (decide(light, view, n, 3, 100, 100) for n in (2, 50))
    assert few.engine == "light" and many.engine == "view"
    assert many.reason.startswith("V ⊕ f_v") and "50 environments × 3 materials" in many.reason
    assert "10.5 s" in many.reason and "50.5 s" in many.reason
    # Resampling costs the same for ten times the pixels, so the balance shifts with them.
    assert decide(Cost(0, 1), Cost(0, 0.5, 2), 4, 1, 100, 100).engine == "light"
    assert decide(Cost(0, 1), Cost(0, 0.5, 2), 4, 1, 1000, 100).engine == "view"


def test_a_trial_measures_both(device: Device, tracer: Tracer, view: ViewPoints, sky: Environment) -> None:
    lights = [replace(sky, rotate=float(r)) for r in range(3)]
    points: Points = replace(view.points, material=np.zeros_like(view.points.material))
    choice = choose_engine(
        device, tracer, points, view.pixel, lights, [[Material.parse("lambert:albedo=0.5")]]
    )
    assert isinstance(choice, Choice) and choice.engine in ("light", "view")
    assert f"of {len(view.seen)} pixels" in choice.reason and "3 environments × 1 materials" in choice.reason

"""Which factorization serves a batch: what is tried, what is told, and that the job goes on with it."""

from __future__ import annotations

import weakref
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prtcl.compute import host
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.visibility import Tracer
from prtcl.scene import engine_choice
from prtcl.scene.camera import Camera
from prtcl.scene.engine_choice import Cost, choose_engine, decide
from prtcl.scene.factorization import FACTORIZATIONS, engine_for
from prtcl.scene.frames import relight
from prtcl.scene.frames_engine import Simple
from prtcl.scene.frames_looks import Looks
from prtcl.scene.frames_points import check_view
from prtcl.scene.frames_view import ViewEngine
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import seeing_pixels, shoot
from prtcl.scene.view_points import ViewPoints

CAMERA = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(24, 18))
COARSE: dict[str, Any] = {"levels": 4, "rays": 3, "keep": 4, "views": 16}
MATERIALS = ["lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.04"]


def test_the_cheaper_engine_is_taken_and_the_reason_says_why() -> None:
    light, view = Cost(once=0.5, each=1.0), Cost(once=2.0, each=0.1, block=3.0, apart=0.01)
    assert view.total(10, 2.0) == pytest.approx(2 * (5 + 1) + 0.1)
    (few, _), (many, reason) = (decide(light, view, n, 3, 100, 100) for n in (2, 50))
    assert few == "light" and many == "view"
    assert reason.startswith("V ⊕ f_v") and "50 environments × 3 materials" in reason
    assert "10.5 s" in reason and "50.5 s" in reason
    # Resampling costs the same for ten times the pixels, so the balance shifts with them.
    assert decide(Cost(0, 1), Cost(0, 0.5, apart=2), 4, 1, 100, 100)[0] == "light"
    assert decide(Cost(0, 1), Cost(0, 0.5, apart=2), 4, 1, 1000, 100)[0] == "view"
    # Ten blocks of five lights cost ten transports.
    chosen, reason = decide(light, view, 50, 3, 100, 100, blocks=20)
    assert chosen == "light" and "each of 20 blocks" in reason and "67.5 s" in reason


@pytest.mark.parametrize("cheap", FACTORIZATIONS)
def test_the_job_goes_on_with_what_was_tried(
    device: Device, mesh: Mesh, sky: Environment, monkeypatch: pytest.MonkeyPatch, cheap: str
) -> None:
    """Both engines are timed as they are; the chosen one then gives the images that a new one gives, bit for bit."""
    costs: dict[str, Cost] = {}
    for name in FACTORIZATIONS:
        real = getattr(engine_choice, f"{name}_cost")

        def measured(*given: Any, name: str = name, real: Any = real) -> Cost:
            costs[name] = real(*given)
            return Cost(100.0 if name == cheap else 200.0, 0.0)

        monkeypatch.setattr(engine_choice, f"{name}_cost", measured)
    monkeypatch.setattr(engine_choice, "SAMPLE", 40)
    lights = [replace(sky, rotate=float(r)) for r in range(3)]
    choice = choose_engine(mesh, Looks(MATERIALS, mesh, **COARSE), device, CAMERA, lights, samples=2)
    assert choice.factorization == cheap
    assert isinstance(choice.engine, Simple if cheap == "light" else ViewEngine)
    assert "3 environments × 2 materials" in choice.reason and "tried on 40 pixels" in choice.reason
    assert (
        costs["light"].once > 0
        and costs["light"].each >= 0
        and costs["light"].each + costs["light"].apart > 0
    )
    assert costs["view"].once > 0 and costs["view"].apart > 0
    arguments: tuple[Any, ...] = (mesh, lights[:2], MATERIALS, [CAMERA])
    going_on = relight(*arguments, engine=choice.engine)
    own = COARSE if cheap == "light" else {}
    anew = relight(*arguments, samples=2, factorization=cheap, device=device, **own)
    for one, other in zip(going_on, anew, strict=True):
        assert one.job == other.job and one.image.any() and (one.image == other.image).all()


def test_a_job_of_seconds_is_not_worth_a_trial(
    device: Device, mesh: Mesh, sky: Environment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted over all its views; V ⊕ f_v is then not even compiled."""
    tried: list[str] = []
    for name, cost in (("light", Cost(1.0, 0.0)), ("view", Cost(0.1, 0.0))):

        def measured(*_: Any, name: str = name, cost: Cost = cost) -> Cost:
            tried.append(name)
            return cost

        monkeypatch.setattr(engine_choice, f"{name}_cost", measured)
    monkeypatch.setattr(engine_choice, "SAMPLE", 10**6)  # all pixels: the costs are the view's
    looks = Looks(MATERIALS, mesh, **COARSE)
    few, many = (choose_engine(mesh, looks, device, CAMERA, [sky], views=number) for number in (4, 6))
    assert few.factorization == "light" and "about 4 s for all images" in few.reason
    assert many.factorization == "view"
    assert tried == ["light", "light", "view"]


def test_some_pixels_are_seen_as_among_all(device: Device, mesh: Mesh, sky: Environment) -> None:
    """A trial's row of pixels is the image's own, where no neighbour in a tile matters: bit for bit."""
    engine = Simple(mesh, Looks(MATERIALS, mesh, **COARSE), device, samples=2)
    engine.prepare(CAMERA)
    whole = list(engine.images([(sky, (0, 1))]))
    some = np.arange(7, 24 * 18, 5)
    engine.prepare(CAMERA, some)
    for image, row in zip(whole, engine.images([(sky, (0, 1))]), strict=True):
        assert row.shape == (1, len(some), 4)
        assert (row[0] == image.reshape(-1, 4)[some]).all() and (row[..., 3] > 0).mean() > 0.3


@pytest.mark.parametrize("samples", [None, 1])
def test_a_mesh_between_the_centres_of_pixels_is_tried(
    device: Device, mesh: Mesh, sky: Environment, samples: int | None
) -> None:
    """Where no first sub-pixel point sees the mesh a later one may; one point a pixel then sees nothing at all."""
    tracer, every = Tracer(mesh.vertices, mesh.faces), np.arange(48)
    far = replace(CAMERA, eye=(31.0, 25.0, 54.0), size=(8, 6))
    first, second = (shoot(tracer, far, every, np.full(48, sub)).ray for sub in (0, 1))
    assert not len(first) and len(second)
    assert list(seeing_pixels(tracer, far)) == list(second)
    choice = choose_engine(mesh, Looks(MATERIALS, mesh, **COARSE), device, far, [sky], samples=samples)
    assert choice.engine is not None
    for factorization in FACTORIZATIONS:
        frames = relight(
            mesh, [sky], MATERIALS, [far], samples=samples, factorization=factorization, device=device
        )
        for frame in frames:
            assert frame.image.shape == (6, 8, 4)
            assert frame.image.any() == (samples is None)


def test_a_view_of_nothing_is_refused(device: Device, mesh: Mesh, sky: Environment) -> None:
    away = replace(CAMERA, target=(10.0, 2.5, 5.4))
    with pytest.raises(InputError, match="sees nothing"):
        choose_engine(mesh, Looks(MATERIALS, mesh), device, away, [sky])


@pytest.mark.parametrize("factorization", FACTORIZATIONS)
def test_a_view_that_memory_does_not_hold_is_refused(
    device: Device, mesh: Mesh, sky: Environment, monkeypatch: pytest.MonkeyPatch, factorization: str
) -> None:
    """Before anything is traced; by the pixels that see the mesh, not by all."""
    fixed = {"rays": 4} if factorization == "light" else {}
    engine = engine_for(mesh, MATERIALS, device, factorization=factorization, **fixed)
    check = partial(check_view, engine.tracer, mesh, engine.pixel_bytes)
    check(CAMERA)
    pixels = len(seeing_pixels(engine.tracer, CAMERA))
    # 9 points of 200 bytes and 4^4 bits each; or 64 of 200 bytes, and 2 · 4^6 bits for all.
    each = 9 * (200 + 32) if factorization == "light" else 64 * 200 + 1024
    assert pixels < 24 * 18
    monkeypatch.setattr(host, "memory", lambda: pixels * each)
    check(CAMERA)
    monkeypatch.setattr(host, "memory", lambda: pixels * each - 1)
    with pytest.raises(InputError, match=f"{pixels} pixels see the mesh.*GiB"):
        check(CAMERA)
    device.profile.reset()
    with pytest.raises(InputError, match="smaller --size"):
        next(relight(mesh, [sky], MATERIALS, [CAMERA], factorization=factorization, device=device, **fixed))
    assert "visibility_rays" not in device.profile.host_seconds()


def test_points_of_a_view_are_let_go_of(mesh: Mesh) -> None:
    """What makes images keeps no part of the arrays that are ten times as large."""
    seen = ViewPoints.of(mesh, Tracer(mesh.vertices, mesh.faces), CAMERA, 2)
    grey = np.full((len(seen.seen), 3), 0.5)
    whole, held = seen.image(grey), [weakref.ref(own) for own in (seen.points.frames, seen.pixel)]
    seen = seen.without_points()
    assert (seen.image(grey) == whole).all() and [own() for own in held] == [None, None]


def test_what_memory_does_not_hold_is_not_chosen(
    device: Device, mesh: Mesh, sky: Environment, monkeypatch: pytest.MonkeyPatch
) -> None:
    pixels = len(seeing_pixels(Tracer(mesh.vertices, mesh.faces), CAMERA))
    monkeypatch.setattr(host, "memory", lambda: pixels * 10_000)
    choice = choose_engine(mesh, Looks(MATERIALS, mesh, **COARSE), device, CAMERA, [sky] * 1000)
    assert choice.factorization == "light" and "memory" in choice.reason
    assert isinstance(choice.engine, Simple)


@pytest.mark.parametrize(("limit", "least"), [("4096\n", 4096), ("max\n", 1 << 20), (None, 1 << 20)])
def test_a_container_may_have_less_memory_than_its_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str | None, least: int
) -> None:
    path = tmp_path / "memory.max"
    if limit is not None:
        path.write_text(limit)
    monkeypatch.setattr(host, "LIMITS", (path,))
    found = host.memory()
    assert found is not None and (found == least if limit == "4096\n" else found > least)

"""The sessions behind the viewer's pages: a picture depends on its page's state alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import write_skies

from prtcl.apps.view import studio as studio_module
from prtcl.apps.view.look import PRESETS, Look
from prtcl.apps.view.state import Eye, State
from prtcl.apps.view.studio import FINE, MOVING, STILL, Drawn, Quality, Studio
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.scene.mesh import Mesh
from prtcl.scene.session import Session

EYE = Eye((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), (0.0, 1.0, 0.0), 0.6, (40, 30))
PARTS = 5
PLAIN, DRESSED = (Look(),) * PARTS, (PRESETS["gold"], PRESETS["green glaze"], *(Look(),) * 3)
STATES = (
    State(EYE, PLAIN, "noon"),
    State(replace(EYE, position=(2.6, 2.9, 5.0)), DRESSED, "noon"),
    State(EYE, DRESSED, "late", rotate=90.0),
    State(EYE, PLAIN, "late", rotate=180.0),
)


@pytest.fixture(scope="module")
def skies(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_skies(tmp_path_factory.mktemp("skies"), 16)


@pytest.fixture
def make(mesh: Mesh, skies: dict[str, Path], device: Device) -> Callable[[], Studio]:
    return lambda: Studio(mesh, skies, device, levels=4, rays=3, size=(40, 30))


def traced(made: Studio) -> Studio:
    made.trace(lambda what: None, lambda: None)
    return made


def drawn(own: Studio, state: State, quality: Quality) -> Drawn:
    for _ in range(1000):
        got = own.step(state, quality)
        if got is not None:
            return got
    pytest.fail("no picture after a thousand steps")


def test_pictures_do_not_depend_on_what_came_before(make: Callable[[], Studio], mesh: Mesh) -> None:
    """Pages in any order, lights that push one another out: bit for bit what a studio of their own shows."""
    shared, rng = traced(make()), np.random.default_rng(3)
    alone = {state: drawn(traced(make()), state, FINE).render.image for state in STATES}
    for _ in range(12):
        state = STATES[rng.integers(0, len(STATES))]
        quality = (MOVING, STILL, FINE)[rng.integers(0, 3)]
        got = drawn(shared, state, quality).render.image
        if quality is FINE:
            assert (got == alone[state]).all()
    for state in STATES:
        assert (drawn(shared, state, FINE).render.image == alone[state]).all()


def test_a_fine_picture_is_the_sessions(
    make: Callable[[], Studio], mesh: Mesh, skies: dict[str, Path], device: Device
) -> None:
    state = STATES[1]
    got = drawn(traced(make()), state, STILL)
    session = Session(
        mesh, skies["noon"], [look.material for look in state.looks], device=device, levels=4, rays=3
    )
    assert (session.view(state.eye.camera((40, 30))).image == got.render.image).all()
    assert not got.draft
    assert got.exposure != 0.0


def test_long_work_comes_in_steps(make: Callable[[], Studio], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studio_module, "STEP", 0.0)  # the smallest chunks
    own, state = traced(make()), STATES[0]
    before, steps = own.left(state), 0
    assert before == 1.0
    while own.step(state, FINE) is None:
        assert own.left(state) < before or steps == 0
        before, steps = own.left(state), steps + 1
    assert steps > 5
    assert own.left(state) == 0.0
    # Before the rest is there, what faces away is made ready in idle time.
    assert own.look_ahead(state)
    while own.look_ahead(state):
        pass
    assert own.left(replace(state, eye=replace(EYE, position=(-3.0, 2.5, -5.4)))) < 0.2  # what shows its back


def test_previews_stand_in_until_rays_are_traced(make: Callable[[], Studio]) -> None:
    own, can = make(), []
    own.trace(lambda what: None, lambda: can.append((own.can(MOVING), own.can(FINE))))
    assert can == [(True, False), (True, True)]
    assert drawn(own, STATES[0], MOVING).draft
    drawn(own, STATES[0], FINE)
    assert not drawn(own, STATES[0], MOVING).draft


def test_unknown_or_broken_environments_are_named(
    mesh: Mesh, skies: dict[str, Path], device: Device, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.exr"
    bad.write_bytes(b"no image")
    own = traced(Studio(mesh, {**skies, "bad": bad}, device, levels=3, rays=2))
    with pytest.raises(InputError, match=r"bad\.exr"):
        own.step(replace(STATES[0], environment="bad"), MOVING)
    with pytest.raises(InputError, match=r"there is no '\.\./secret' in the list"):
        own.step(replace(STATES[0], environment="../secret"), MOVING)
    assert own.step(STATES[0], MOVING) is not None

"""What the viewer's pages share: one mesh, its traced visibility, and sessions under the lights now looked at.

A picture depends on a page's state alone, never on what was rendered before it. Long work is done in steps of a
fraction of a second, so that a page that moves need not wait for another that refines.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from prtcl.apps.view.state import State, metered_exposure
from prtcl.compute.chunks import largest_buffer
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.visibility import Progress
from prtcl.scene.bake import Bake
from prtcl.scene.camera import Triple
from prtcl.scene.mesh import Mesh
from prtcl.scene.scene import Render, read_environment
from prtcl.scene.session import Session
from prtcl.wavelet import pyramid

LEVELS = 6
DRAFT_LEVELS = 4
"""Of the sessions that stand in while the fine ones are not ready: a 16th of the rays and of the directions."""
STEP = 0.15
"""Seconds that a step of long work may take, about."""
KEPT_ENVIRONMENTS = 3


@dataclass(frozen=True)
class Quality:
    """A rung of the ladder a picture climbs while its page rests.

    Attributes
    ----------
    scale : of the image's sides
    samples : sub-pixel points along a pixel's side
    fine : from the fine session; else from whichever is ready
    rest : seconds that nothing may have changed for
    """

    name: str
    scale: float
    samples: int
    fine: bool
    rest: float


MOVING = Quality("moving", 0.5, 1, False, 0.0)
STILL = Quality("resting", 1.0, 1, True, 0.2)
FINE = Quality("refined", 1.0, 2, True, 0.5)
LADDER = (MOVING, STILL, FINE)


@dataclass(frozen=True)
class Drawn:
    """A render and how it came about.

    Attributes
    ----------
    exposure : stops that suit the environment
    seconds : wall time of the call that made it
    draft : whether a draft session made it
    notes : on the environment, such as what was repaired
    """

    render: Render
    exposure: float
    seconds: float
    draft: bool
    notes: tuple[str, ...] = ()


class Studio:
    """Sessions of one mesh, made as lights ask for them. One thread uses it; `trace` is another's.

    Parameters
    ----------
    mesh : with normals
    environments : name to file; a state names one of them
    bake : of the mesh, where its visibility is traced already
    levels : of light and product; None takes the most up to `LEVELS` that the device holds
    rays : levels of the visibility grid, at most `levels`
    error : relative, what cuts may cost
    size : the most pixels of an image
    """

    def __init__(
        self, mesh: Mesh, environments: dict[str, Path], device: Device, *, bake: Bake | None = None,
        levels: int | None = None, rays: int = 5, error: float = 0.01, size: tuple[int, int] = (1280, 800),
        up: str = "y", repair: bool = False,
    ) -> None:  # fmt: skip
        self.mesh, self.device, self.files, self.error, self.size = mesh, device, environments, error, size
        self.levels = _fitting(device, len(mesh.vertices)) if levels is None else levels
        if bake is not None:
            self.levels, rays = max(self.levels, bake.rays), bake.rays
        self.rays = min(rays, self.levels)
        self._up, self._repair = up, repair
        self._bakes: dict[bool, Bake] = {} if bake is None else {True: bake}
        self._pools: dict[bool, OrderedDict[tuple[str, float], Session]] = {
            True: OrderedDict(),
            False: OrderedDict(),
        }
        # Two fine ones, so that two pages under different lights do not undo each other's work.
        row = len(self.mesh.vertices) * pyramid.row_bytes(self.levels)
        self._kept = {False: 3, True: 2 if 4 * row < device.memory else 1}
        self._environments: OrderedDict[str, tuple[Environment, float, tuple[str, ...]]] = OrderedDict()
        self._chunk = 256

    # --- visibility -----------------------------------------------------------------------------------------

    def trace(self, progress: Callable[[str], Progress | None], done: Callable[[], None]) -> None:
        """Trace what is not traced yet, coarse and then fine: the one part that another thread may run."""
        draft = max(1, min(DRAFT_LEVELS, self.levels - 1))
        for fine, rays in ((False, draft), (True, self.rays)):
            if fine not in self._bakes:
                self._bakes[fine] = Bake.trace(self.mesh, rays, progress("trace" if fine else "preview"))
            done()

    def can(self, quality: Quality) -> bool:
        """Whether the visibility that a quality needs is there."""
        return True in self._bakes or (not quality.fine and False in self._bakes)

    # --- pictures -------------------------------------------------------------------------------------------

    def step(self, state: State, quality: Quality) -> Drawn | None:
        """The picture of a state; or None after a step towards it, where another must follow.

        Raises
        ------
        PrtclError
            If the environment cannot be read, or the camera is none.
        """
        camera = state.eye.camera(self.size, quality.scale)
        start = time.perf_counter()
        fine = quality.fine
        if not fine and True in self._bakes:
            # The draft stands in only where the fine one would have to work for longer than a step.
            held = self._pools[True].get(state.light)
            ready = held is not None and len(held.waiting(camera, quality.samples)[0]) <= self._chunk
            fine = False not in self._bakes or ready
        session = self._lit(state, fine)
        if quality.fine:
            wanted, back = session.waiting(camera, quality.samples)
            if len(wanted) and self._prepare(session, wanted, back) < len(wanted):
                return None
        materials = [look.material for look in state.looks]
        if list(session.materials) != materials:
            session.material = materials
        # Tables have their own cuts fitted once the hand rests.
        render = session.view(camera, samples=quality.samples, draft=quality is not FINE)
        _, exposure, notes = self.environment(state.environment)
        return Drawn(render, exposure, time.perf_counter() - start, not fine, notes)

    def left(self, state: State) -> float:
        """About which share of the vertices in sight a fine picture of a state still waits for."""
        held = self._pools[True].get(state.light)
        if held is None:
            return 1.0
        wanted, _ = held.waiting(state.eye.camera(self.size), FINE.samples)
        return min(1.0, len(wanted) / max(1, int(self._facing(state.eye.position).sum())))

    def look_ahead(self, state: State) -> bool:
        """Collapse some vertices that a state's camera does not see yet, those that face it first; False for none."""
        held = self._pools[True].get(state.light)
        if held is None:
            return False
        rest = ~held.collapsed
        if not rest.any():
            return False
        facing = rest & self._facing(state.eye.position)
        self._prepare(held, np.flatnonzero(facing if facing.any() else rest))
        return True

    def _facing(self, eye: Triple) -> npt.NDArray[np.bool_]:
        assert self.mesh.normals is not None
        return np.asarray(((eye - self.mesh.vertices) * self.mesh.normals).sum(axis=1) > 0.0)

    def _prepare(
        self, session: Session, wanted: npt.NDArray[np.integer], back: npt.NDArray[np.bool_] | None = None
    ) -> int:
        """Collapse some of the vertices that are wanted; how many they were."""
        some = slice(None, self._chunk)
        start = time.perf_counter()
        session.prepare(wanted[some], None if back is None else back[some])
        count = len(wanted[some])
        speed = count / max(1e-6, time.perf_counter() - start)
        # By at most a factor of two: the first chunk also pays for compiling.
        self._chunk = int(min(2 * self._chunk, max(64, self._chunk // 2, speed * STEP)))
        return count

    # --- lights ---------------------------------------------------------------------------------------------

    def environment(self, name: str) -> tuple[Environment, float, tuple[str, ...]]:
        """An environment of the list, not turned, the exposure that suits it, and notes on it."""
        if name not in self.files:
            raise InputError(f"environment: there is no {name!r} in the list")
        if name not in self._environments:
            found, notes = read_environment(self.files[name], up=self._up, repair=self._repair)
            self._environments[name] = found, metered_exposure(found.image), tuple(notes)
            if len(self._environments) > KEPT_ENVIRONMENTS:
                self._environments.popitem(last=False)
        self._environments.move_to_end(name)
        return self._environments[name]

    def _lit(self, state: State, fine: bool) -> Session:
        """The session under a state's light; the one longest unused takes that light where none is."""
        pool, bake = self._pools[fine], self._bakes[fine]
        if state.light not in pool:
            light = replace(self.environment(state.environment)[0], rotate=state.rotate)
            if len(pool) >= self._kept[fine]:
                session = pool.popitem(last=False)[1]
                session.light = light
            else:
                materials = [look.material for look in state.looks]
                levels = self.levels if fine else bake.rays
                session = Session(bake, light, materials, device=self.device, levels=levels, error=self.error)
            pool[state.light] = session
        pool.move_to_end(state.light)
        return pool[state.light]


def _fitting(device: Device, vertices: int) -> int:
    """The most levels, up to `LEVELS`, whose sums the device holds in one buffer."""
    room = largest_buffer(device)
    for fitting in range(LEVELS, 3, -1):
        if vertices * pyramid.row_bytes(fitting) <= room:
            return fitting
    return 3

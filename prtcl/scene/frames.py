"""`prtcl.relight`: images of a mesh under every light, in every material, from every view, one after another."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterator, Sequence, Sized
from contextlib import closing
from dataclasses import dataclass, fields
from itertools import groupby
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.scene.bake import Bake, read_mesh_or_bake
from prtcl.scene.camera import Camera
from prtcl.scene.camera_path import View
from prtcl.scene.factorization import engine_for
from prtcl.scene.frames_ahead import ahead
from prtcl.scene.frames_engine import Engine, Wanted, with_rotation
from prtcl.scene.kept_visibility import KeptVisibility
from prtcl.scene.mesh import Mesh
from prtcl.scene.scene import Path, read_environment
from prtcl.transport.settings import Settings

SETTINGS = tuple(own.name for own in fields(Settings))
"""What may be fixed by hand."""
READ_AHEAD = 2
KEPT = 512 << 20
"""Bytes of environments that are kept from one view to the next."""

Light = Environment | Path | npt.NDArray[Any]


@dataclass(frozen=True)
class Job:
    """Which image: numbers among the views, lights, rotations and materials given.

    Attributes
    ----------
    index : of the image in the order in which all are made
    """

    index: int
    view: int
    light: int
    rotation: int
    material: int


def jobs(views: int, lights: int, rotations: int, materials: int) -> Iterator[Job]:
    """Every image in order: materials change fastest, then rotations, lights and views."""
    index = 0
    for view in range(views):
        for light in range(lights):
            for rotation in range(rotations):
                for material in range(materials):
                    yield Job(index, view, light, rotation, material)
                    index += 1


@dataclass(frozen=True, eq=False)
class Frame:
    """One finished image, and which it is.

    Attributes
    ----------
    job : its numbers
    light : the environment's name; rotation : degrees; material : its SPEC, or "own"; view : name and camera
    image : (h, w, 4) float32 linear RGBA, colour premultiplied by coverage, writeable and nobody else's
    """

    job: Job
    light: str
    rotation: float
    material: str
    view: View
    image: npt.NDArray[np.float32]


def relight(
    mesh: Mesh | Bake | Path,
    lights: Sequence[Light] | Sources,
    materials: Sequence[str | Material | Sequence[str | Material] | None] = (None,),
    cameras: Sequence[View | Camera] | None = None,
    *,
    rotations: Sequence[float] = (0.0,),
    points: str = "pixel",
    samples: int | None = None,
    factorization: str = "light",
    up: str = "y",
    repair: bool = False,
    device: Device | None = None,
    two_sided: bool = True,
    smooth: bool = False,
    wanted: Callable[[Job], bool] | None = None,
    note: Callable[[str], object] | None = None,
    engine: Engine | None = None,
    kept: Path | KeptVisibility | None = None,
    **settings: float | str | None,
) -> Generator[Frame, None, None]:
    """Images under every light, in every material, from every view, given as they are done.

    Parameters
    ----------
    mesh : a `Mesh` or a path to one, or a `Bake` or a path to one (.npz), whose vertices are then shaded
    lights : an `Environment`, a path to an EXR or HDR map, or an array (h, 2 h, 3) each. Files are read as they are
        needed, on another thread, while images are computed. `Sources` keep what they have read from call to call
    materials : for each a SPEC or a `Material`; a list of one for each part of the mesh; or None for the mesh's own
    cameras : the views, with names or without; None frames the mesh
    rotations : degrees by which each light is turned, about its up axis, counter-clockwise seen from above
    points : "pixel" computes radiance at what the pixels see, "vertex" at the mesh's vertices
    samples : N × N sub-pixel points a pixel, 1 to 64, traced once a view; None takes what suits the engine
    factorization : "light" collapses L ⊕ V for each light, for all materials; "view" makes V ⊕ f_v for each view, for
        blocks of lights at once, which pays from some ten lights on; it takes neither vertices nor colours of the mesh,
        and of `settings` only `hard`
    up, repair : as for `read_environment`
    device : None chooses one
    two_sided, smooth, settings : as for `Scene`
    wanted : which images to make, of those there are; None makes all
    note : called with notes on lights as they are read
    engine : what computes the images; None takes that of `factorization`. The arguments from `points` to
        `settings`, but for `up` and `repair`, are then its own affair
    kept : a folder in which each view's visibility is kept, for other jobs with the same view of the same mesh
        (`prtcl.scene.kept_visibility`, of the extra `bake`); images are the same, bit for bit

    Yields
    ------
    frame : `Frame`, in the order of `jobs`: all materials under the first rotation of the first light from the first
        view, then the next rotation. The same arguments give the same images, bit for bit, whatever is `wanted`

    Raises
    ------
    InputError
        If an argument is wrong: at the call. Of a light that cannot be read: when its turn comes.

    Examples
    --------
    >>> for frame in prtcl.relight("bunny.ply", ["sky.exr"], ["lambert:albedo=0.5"]):  # doctest: +SKIP
    ...     tensor = torch.from_dlpack(frame.image)
    """
    if points not in ("pixel", "vertex"):
        raise InputError(f"points: expected pixel or vertex, got {points!r}")
    if samples is not None and (not isinstance(samples, int | np.integer) or not 1 <= samples <= 64):
        raise InputError(f"samples: expected 1 to 64 points along a pixel's side, got {samples}")
    _check_list("lights", lights, Sources)
    _check_list("materials", materials)
    if cameras is not None:
        _check_list("cameras", cameras)
    _check_list("rotations", rotations, np.ndarray)
    if not all(isinstance(own, int | float | np.number) and np.isfinite(own) for own in rotations):
        raise InputError(f"rotations: expected degrees, got {rotations}")
    unknown = sorted(settings.keys() - SETTINGS)
    if unknown:
        raise InputError(f"{unknown[0]}: no such argument or setting; expected one of {', '.join(SETTINGS)}")
    mesh, bake = read_mesh_or_bake(mesh)
    if kept is not None and bake is not None:
        raise InputError("kept: a bake holds its visibility already; leave it out, or give the mesh")
    mesh = mesh.smooth() if smooth and bake is None else mesh
    seen = named_views([Camera.framing(mesh.bounds)] if cameras is None else cameras)
    if engine is None:
        engine = engine_for(
            mesh if bake is None else bake, materials, device or Device(), points=points, samples=samples,
            factorization=factorization, two_sided=two_sided,
            kept=kept if kept is None or isinstance(kept, KeptVisibility) else KeptVisibility(kept, mesh, note),
            **settings,
        )  # fmt: skip
    sources = lights if isinstance(lights, Sources) else Sources(lights, up, repair, note)
    return _frames(engine, sources, seen, list(map(float, rotations)), list(materials), wanted)


def _check_list(name: str, given: Any, *also: type[Sized]) -> None:
    """Refuse one thing where several are expected, and none."""
    several = not isinstance(given, str) and isinstance(given, (Sequence, *also))
    if not several or not len(given):
        raise InputError(f"{name}: expected a list of one or more, got {_short(given)}")


def _short(value: Any) -> str:
    text = repr(value) if isinstance(value, str | int | float | list | tuple) else type(value).__name__
    return text if len(text) < 60 else type(value).__name__


def named_views(given: Sequence[View | Camera]) -> list[View]:
    """Views with names: view001 and so on for cameras without."""
    if not given:
        raise InputError("cameras: expected one or more, got none")
    digits = max(3, len(str(len(given))))
    return [
        own if isinstance(own, View) else View(f"view{number:0{digits}}", own)
        for number, own in enumerate(given, start=1)
    ]


class Sources:
    """Lights by number, read when they are asked for; some are kept, for they come again with every view."""

    def __init__(
        self, lights: Sequence[Light], up: str, repair: bool, note: Callable[[str], object] | None
    ) -> None:
        self._lights, self._up, self._repair, self._note = lights, up, repair, note
        self._kept: OrderedDict[int, Environment] = OrderedDict()
        self._told: set[int] = set()

    def __len__(self) -> int:
        return len(self._lights)

    def name(self, number: int) -> str:
        """What a light is called: its file's path, its own name, or that it is an array."""
        light = self._lights[number]
        if isinstance(light, Environment):
            return light.name
        return "array" if isinstance(light, np.ndarray) else os.fspath(light)

    def read(self, number: int) -> Environment:
        """The environment."""
        if number not in self._kept:
            environment, notes = read_environment(self._lights[number], up=self._up, repair=self._repair)
            if self._note is not None and number not in self._told:
                for text in notes:
                    self._note(f"{self.name(number)}: {text}")
            self._told.add(number)
            self._kept[number] = environment
            while len(self._kept) > 1 and sum(e.host_bytes for e in self._kept.values()) > KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(number)
        return self._kept[number]


def _frames(
    engine: Engine, sources: Sources, views: list[View], rotations: list[float], materials: list[Any],
    wanted: Callable[[Job], bool] | None,
) -> Generator[Frame, None, None]:  # fmt: skip
    every = jobs(len(views), len(sources), len(rotations), len(materials))
    for number, group in groupby(every, key=lambda job: job.view):
        view, own = views[number], [job for job in group if wanted is None or wanted(job)]
        if not own:
            continue
        engine.prepare(view.camera)
        under: dict[tuple[int, int], list[int]] = {}
        for job in own:
            under.setdefault((job.light, job.rotation), []).append(job.material)

        def read(under: dict[tuple[int, int], list[int]] = under) -> Iterator[Wanted]:
            for (light, rotation), looks in under.items():
                environment = with_rotation(sources.read(light), rotations[rotation])
                engine.ahead(environment)
                yield environment, looks

        with closing(ahead(read(), READ_AHEAD)) as lights:
            images = engine.images(_waited(engine.device, lights))
            for job, image in zip(own, images, strict=True):
                spec = materials[job.material]
                yield Frame(job, sources.name(job.light), rotations[job.rotation], _spec(spec), view, image)


def _waited(device: Device, lights: Iterator[Wanted]) -> Iterator[Wanted]:
    """The same, with the time that is waited for each counted as the host stage "wait_for_light"."""
    while True:
        with device.profile.host("wait_for_light"):
            light = next(lights, None)
        if light is None:
            return
        yield light


def _spec(material: Any) -> str:
    if material is None:
        return "own"
    own = [material] if isinstance(material, str | Material) else material
    return ", ".join(m.spec if isinstance(m, Material) else str(m) for m in own)

"""A batch on many machines: the rays of a view are one task, and images of that view under some lights are others.

The command reads the batch, and holds the folder's lock, manifest and journal. A worker reads the same files, which lie
in folders that all machines share, and checks that they make the same job; it writes its images itself and answers
with their digests, which the command records as they come. The folder is the same, byte for byte, as one process
leaves it.

What a task is made of is sent where it is missing: a view is traced once, not by every worker that makes images of it.
Without a scheduler one process goes through the same work in the same order, view by view and in each light by light
(`prtcl.scene.frames`), with what the tasks only approximate: rays, kernels, reading and writing overlap from one image
to the next. Tasks on one machine would add copies, and nothing else: its cores are all at work as it is.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.apps.cluster import Workers, kept
from prtcl.apps.relight import batch
from prtcl.apps.relight.folder import Folder
from prtcl.apps.relight.images import SECONDS, make_images
from prtcl.apps.relight.manifest import difference
from prtcl.apps.relight.shared import Shared
from prtcl.compute import choice
from prtcl.compute.device import Device
from prtcl.compute.tuning import VARIABLE
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material, anchored
from prtcl.scene.camera import Camera
from prtcl.scene.frames import Sources, jobs
from prtcl.scene.frames_engine import Engine, Image, Wanted
from prtcl.scene.frames_view import TOGETHER

LIGHTS = {"light": 8, "view": TOGETHER}
"""Most lights of a task, by factorization. L ⊕ V is made for each light anew, so a task may be short: eight lights keep
reading, computing and writing side by side for most of it. V ⊕ f_v is made anew for each task, at the price of some ten
lights: a task has as many as one product takes, and its worker's death costs that many."""


# --- the command's side ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Order:
    """What workers are told of a batch.

    Attributes
    ----------
    options : what the command chose is fixed in them, and paths hold wherever a worker was started
    folder : from which relative paths in SPECs start
    specs : of the materials, as they were given
    manifest : of the output
    """

    options: dict[str, Any]
    folder: str
    specs: list[str | None]
    manifest: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Made:
    """What a task made: digests of each image's files by its number, where `SECONDS` went, and notes on lights."""

    images: list[tuple[int, dict[str, str]]]
    seconds: dict[str, float]
    notes: list[str]


def order(options: argparse.Namespace, job: batch.Batch) -> Order:
    """What workers are told."""
    fixed = {key: value for key, value in vars(options).items() if key not in ("run", "arguments")}
    fixed |= {
        "error": None, "samples": job.samples, "rays": job.settings["rays"], "factorization": job.factorization,
        "mesh": os.path.abspath(options.mesh), "env": [os.path.abspath(path) for path in job.lights],
        "output": os.path.abspath(options.output),
        "cameras": options.cameras and os.path.abspath(options.cameras),
        "keep_visibility": options.keep_visibility and os.path.abspath(options.keep_visibility),
    }  # fmt: skip
    specs = list(dict.fromkeys(options.brdf or [None]))
    return Order(fixed, os.getcwd(), specs, job.manifest)


def blocks(job: batch.Batch, finished: set[int], lights: int) -> Iterator[tuple[int, list[list[int]]]]:
    """Each view of which images are missing, and these by tasks: numbers of all materials under some lights."""
    every = jobs(len(job.views), len(job.lights), len(job.rotations), len(job.materials))
    width = len(job.rotations)
    for view, seen in groupby(every, key=lambda own: own.view):
        parts = groupby(seen, key=lambda own: (own.light * width + own.rotation) // lights)
        missing = [[own.index for own in part if own.index not in finished] for _, part in parts]
        if any(missing):
            yield view, [wanted for wanted in missing if wanted]


def lights_of_a_task(job: batch.Batch, workers: int) -> int:
    """`LIGHTS`, or fewer where some of the workers would otherwise have no task of their own."""
    many = len(job.lights) * len(job.rotations)
    parts = max(-(-many // LIGHTS[job.factorization]), -(-workers // len(job.views)))
    return max(1, -(-many // parts))


def spread(
    workers: Workers, options: argparse.Namespace, job: batch.Batch, folder: Folder,
    told: Callable[[int, dict[str, Any]], object], note: Callable[[str], object],
) -> tuple[dict[str, float], int]:  # fmt: skip
    """Have workers make what is missing, and record it.

    Parameters
    ----------
    told : called with each image's number and entry of the manifest, once it is recorded
    note : called with notes on lights, once each

    Returns
    -------
    seconds : `SECONDS`, the sum over workers
    count : of workers that made images

    Raises
    ------
    InputError, PrtclError
        As `Workers.answers`.
    """
    shared = workers.share(order(options, job))
    each = options.chunk or lights_of_a_task(job, workers.count())

    def tasks() -> Iterator[Any]:
        for view, parts in blocks(job, folder.finished, each):
            # Not held by the command, what was traced is let go of after the view's last image.
            traced = workers.submit(_trace, shared, view, rank=parts[0][0])
            for wanted in parts:
                yield workers.submit(_make, shared, view, wanted, traced, rank=wanted[0])

    total, seen, noted = dict.fromkeys(SECONDS, 0.0), set(), set()
    with closing(workers.answers(tasks())) as answers:
        for answer in answers:
            made: Made = answer.value
            seen.add(answer.worker)
            for name in SECONDS:
                total[name] += made.seconds[name]
            for text in made.notes:
                if text not in noted:
                    noted.add(text)
                    note(text)
            for number, digests in made.images:
                folder.record(number, digests)
                told(number, job.manifest["frames"][number])
    return total, len(seen)


# --- a worker's side ---------------------------------------------------------------------------------------------


class Standing:
    """An engine that stays before its view from one task to the next, and takes what others traced for it.

    As `prtcl.scene.frames_engine.Engine`, all of it.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine, self.tracer, self.pixel_bytes = engine, engine.tracer, engine.pixel_bytes
        self.before: Camera | None = None
        self.traced: Any = None

    @property
    def device(self) -> Device:
        """Where kernels run."""
        return self.engine.device

    def ahead(self, environment: Environment) -> None:
        """The engine's."""
        self.engine.ahead(environment)

    def prepare(self, camera: Camera, pixels: npt.NDArray[np.int64] | None = None, traced: Any = None) -> Any:
        """Stand before a view, unless it does; returns what was traced for it."""
        if camera != self.before or pixels is not None:
            self.before = None  # should it fail
            self.traced = self.engine.prepare(camera, pixels, traced)
            self.before = camera if pixels is None else None
        return self.traced

    def images(self, lights: Iterable[Wanted]) -> Iterator[Image]:
        """The engine's."""
        return self.engine.images(lights)


class Place:
    """A batch as a worker has it.

    Raises
    ------
    InputError
        If something that images depend on is not what the command has.
    """

    def __init__(self, told: Order) -> None:
        self.options = argparse.Namespace(**told.options)
        # A machine of several devices has a worker for each, which that worker's environment names.
        asked = None if os.environ.get(choice.VARIABLE) else self.options.device
        self.device = Device(asked, precision=self.options.precision)
        materials = [None if spec is None else _material(spec, told.folder) for spec in told.specs]
        self.notes: list[str] = []
        self.job = batch.read(self.options, self.device, self.notes.append, materials)
        if self.job.manifest["job"] != told.manifest["job"]:
            what = difference(self.job.manifest, told.manifest)
            raise InputError(
                f"would make other images; what differs is {what}\n"
                + (
                    f"have one file of `prtcl bench --tune` for all in {VARIABLE}, or set it to nothing"
                    if what.startswith("kernels")
                    else "workers need the same files, and a device and driver as the command's: see --device and "
                    "PRTCL_DEVICE"
                )
            )
        self.manifest = told.manifest
        self.sources = Sources(self.job.lights, self.options.env_up, self.options.repair, self.notes.append)
        self.engine = Standing(self.job.engine(self.device, not self.options.one_sided))

    def stand(self, view: int, traced: Any = None) -> Any:
        """Have the engine before a view."""
        return self.engine.prepare(self.job.views[view].camera, traced=traced)


def _material(spec: str, folder: str) -> Material:
    """As the command has it, its SPEC too: that is part of the job, and a path in it may be relative there."""
    return replace(Material.parse(anchored(spec, folder)), spec=spec)


def _trace(told: Order, view: int) -> Any:
    """The task before a view's images: its rays. Their seconds are told by the worker's next images."""
    return kept(lambda: Place(told)).stand(view)


def _make(told: Order, view: int, wanted: list[int], traced: Any) -> Made:
    """Images of a view, written."""
    place, numbers = kept(lambda: Place(told)), set(wanted)
    place.stand(view, traced)
    folder = Shared(Path(place.options.output), place.manifest)
    seconds = make_images(
        place.job, folder, place.device, place.options, wanted=lambda own: own.index in numbers,
        told=lambda *_: None, engine=place.engine, sources=place.sources,
    )  # fmt: skip
    place.device.profile.reset()
    notes, place.notes[:] = list(place.notes), []
    return Made(folder.made, seconds, notes)

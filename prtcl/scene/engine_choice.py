"""Which factorization serves a batch: L ⊕ V, collapsed anew for each light, or V ⊕ f_v, made anew for each view.

What either costs depends on the mesh, the light and the device, so the job's own two engines are both tried on some
of its own pixels, and the cheaper one goes on with the job.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from prtcl.compute import host
from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Camera
from prtcl.scene.factorization import engine_of
from prtcl.scene.frames_engine import Engine
from prtcl.scene.frames_looks import Looks
from prtcl.scene.frames_view import together
from prtcl.scene.kept_visibility import KeptVisibility
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import check_eye, seeing_pixels

SAMPLE = 256
"""Pixels of a trial, evenly taken from all that see the mesh."""
FEWER = 4
"""Of how many of these one is taken for the second trial of L ⊕ V."""
BATCH = 16
"""Environments of the second trial of V ⊕ f_v; the first has one."""
LITTLE = 5.0
"""Seconds of a whole job by L ⊕ V that are not worth a trial of V ⊕ f_v, which takes about as long."""
APART = "resample_light"
"""The host stage of V ⊕ f_v that does not grow with the pixels."""


@dataclass(frozen=True)
class Cost:
    """Seconds of one engine.

    Attributes
    ----------
    once : for the view
    each : for each environment
    block : for each block of environments that it takes together
    apart : for each environment, whatever the pixels
    """

    once: float
    each: float
    block: float = 0.0
    apart: float = 0.0

    def total(self, environments: int, share: float = 1.0, blocks: int = 1) -> float:
        """Seconds for so many environments and `share` times the pixels."""
        return (
            share * (self.once + blocks * self.block + environments * self.each) + environments * self.apart
        )


@dataclass(frozen=True, eq=False)
class Choice:
    """What was chosen.

    Attributes
    ----------
    factorization : `light` (L ⊕ V) or `view` (V ⊕ f_v)
    reason : in words
    engine : of that factorization, with what the trial compiled and made; None where there was no trial
    """

    factorization: str
    reason: str
    engine: Engine | None = None


def choose_engine(
    mesh: Mesh, looks: Looks, device: Device, camera: Camera, environments: Sequence[Environment], *,
    views: int = 1, samples: int | None = None, two_sided: bool = True, hard: str = "auto",
    kept: KeptVisibility | None = None,
) -> Choice:  # fmt: skip
    """Try both engines on some of one view's pixels and take the one that is faster for all.

    Parameters
    ----------
    looks : of the job; `prtcl.scene.frames_view.serves` them
    environments : all of the job; the first few are tried
    views : how many the job has, all taken to cost the same
    samples, two_sided, hard, kept : as `prtcl.scene.factorization.engine_of` takes them

    Raises
    ------
    InputError
        If the camera sees nothing of the mesh, or stands inside it.

    Notes
    -----
    Two runs of one job may choose differently where both cost the same, and the engines' pictures differ by their
    errors: a job that may be resumed keeps its choice.
    """
    with device.profile.host("build_bvh"):
        tracer = Tracer(mesh.vertices, mesh.faces)
    check_eye(tracer, mesh, camera)
    seen = seeing_pixels(tracer, camera)
    tried = seen[np.unique(np.linspace(0, len(seen) - 1, min(SAMPLE, len(seen))).round().astype(np.int64))]
    engines = {
        name: engine_of(
            name, mesh, looks, device, points="pixel", samples=samples, two_sided=two_sided, bits=None, hard=hard,
            tracer=tracer, kept=kept,
        )
        for name in ("light", "view")
    }  # fmt: skip
    if not host.holds(len(seen) * engines["view"].pixel_bytes):
        return Choice("light", "V ⊕ f_v needs more memory than there is", engines["light"])
    number = len(looks.full)
    light = light_cost(engines["light"], camera, tried, environments[0], number)
    seconds = views * light.total(len(environments), len(seen) / len(tried))
    if seconds < LITTLE:
        return Choice(
            "light",
            f"about {seconds:.2g} s for all images by L ⊕ V, too little to try V ⊕ f_v",
            engines["light"],
        )
    view = view_cost(engines["view"], camera, tried, environments, number)
    blocks = -(-len(environments) // together(len(seen), number))
    chosen, reason = decide(light, view, len(environments), number, len(seen), len(tried), blocks)
    return Choice(chosen, reason, engines[chosen])


def decide(
    light: Cost, view: Cost, environments: int, looks: int, pixels: int, tried: int, blocks: int = 1
) -> tuple[str, str]:
    """The factorization of the cheaper of two engines, and the sentence that says so.

    Parameters
    ----------
    blocks : of environments, for each of which V ⊕ f_v is made anew
    """
    share = pixels / tried
    seconds = {
        "light": light.total(environments, share),
        "view": view.total(environments, share, blocks),
    }
    chosen, other = ("view", "light") if seconds["view"] < seconds["light"] else ("light", "view")
    names = {
        "light": "L ⊕ V, collapsed for each environment",
        "view": "V ⊕ f_v, one transport for "
        + ("all environments" if blocks == 1 else f"each of {blocks} blocks of environments"),
    }
    return chosen, (
        f"{names[chosen]}: about {seconds[chosen]:.3g} s a view for {environments} environments × {looks} materials "
        f"of {pixels} pixels, against {seconds[other]:.3g} s for {names[other]} (both tried on {tried} pixels)"
    )


def light_cost(
    engine: Engine, camera: Camera, pixels: npt.NDArray[np.int64], environment: Environment, looks: int
) -> Cost:
    """Seconds of L ⊕ V for some pixels; a quarter of them tells what a light costs whatever the pixels."""
    few = pixels[:: min(FEWER, len(pixels))]
    once = _timed(lambda: engine.prepare(camera, pixels))
    _draw(engine, [environment], looks)  # compiles kernels and makes the slices
    many = _fastest(lambda: _draw(engine, [environment], looks))
    engine.prepare(camera, few)
    less = _fastest(lambda: _draw(engine, [environment], looks))
    a_pixel = max(0.0, many - less) / max(1, len(pixels) - len(few))
    each = min(many, a_pixel * len(pixels))
    return Cost(once, each, apart=many - each)


def view_cost(
    engine: Engine, camera: Camera, pixels: npt.NDArray[np.int64], environments: Sequence[Environment], looks: int
) -> Cost:  # fmt: skip
    """Seconds of V ⊕ f_v for some pixels."""
    once = _timed(lambda: engine.prepare(camera, pixels))
    few = [replace(environments[i % len(environments)]) for i in range(BATCH)]
    _draw(engine, few, looks)  # compiles kernels and splits the maps
    begin = engine.device.profile.host_seconds()[APART]
    one = _timed(lambda: _draw(engine, few[:1], looks))
    between = engine.device.profile.host_seconds()[APART]
    many = _timed(lambda: _draw(engine, few, looks))
    # The light is resampled once for all pixels: it does not grow with them.
    apart = engine.device.profile.host_seconds()[APART] - between
    one, many = one - (between - begin), many - apart
    each = max(0.0, many - one) / (BATCH - 1)
    return Cost(once, each, block=max(0.0, one - each), apart=apart / BATCH)


def _draw(engine: Engine, environments: Sequence[Environment], looks: int) -> None:
    """Make every look's image under some lights, and forget it."""
    for _ in engine.images((environment, range(looks)) for environment in environments):
        pass


def _fastest(work: Callable[[], object]) -> float:
    return min(_timed(work) for _ in range(2))


def _timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start

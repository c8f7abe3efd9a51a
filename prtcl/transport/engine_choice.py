"""Which factorization serves a batch: L ⊕ V, collapsed anew for each light, or V ⊕ f_v, made anew for each view.

What either costs depends on the mesh, the light and the device, so both are tried on some of the job's own pixels.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.pixel_visibility import Pixels
from prtcl.factors.visibility import Tracer
from prtcl.transport.fixed_view import FixedView, rays_for
from prtcl.transport.looks import Looks
from prtcl.transport.pipeline import Points

T = TypeVar("T")

SAMPLE = 256
"""Pixels of a trial, evenly taken from all."""
FEW = 4
"""Points a pixel at which L ⊕ V is tried: it pays for each, where V ⊕ f_v does not."""
BATCH = 16
"""Environments of the second trial of V ⊕ f_v; the first has one."""


@dataclass(frozen=True)
class Cost:
    """Seconds of one engine: once for the view, for each of its environments, and for each whatever the pixels."""

    once: float
    each: float
    apart: float = 0.0

    def total(self, environments: int, share: float = 1.0) -> float:
        """Seconds for so many environments and `share` times the pixels."""
        return share * (self.once + environments * self.each) + environments * self.apart


@dataclass(frozen=True)
class Choice:
    """The engine that was chosen, `light` (L ⊕ V) or `view` (V ⊕ f_v), and why, in words."""

    engine: str
    reason: str


def choose_engine(
    device: Device,
    tracer: Tracer,
    points: Points,
    pixel: npt.ArrayLike,
    environments: Sequence[Environment],
    looks: Sequence[Sequence[Material]],
) -> Choice:
    """Try both engines on some of one view's pixels and take the one that is faster for all.

    Parameters
    ----------
    points, pixel : as `FixedView` takes them
    environments, looks : all of the job; of the environments the first few are tried

    Notes
    -----
    Two runs of one job may choose differently where both cost the same, and the engines' pictures differ by their
    errors: a job that may be resumed keeps its choice.
    """
    pixels = Pixels.of(pixel)
    chosen = np.unique(np.linspace(0, len(pixels) - 1, min(SAMPLE, len(pixels))).round().astype(np.int64))
    costs = (
        light_cost(device, tracer, points, pixels, chosen, environments[0], looks),
        view_cost(device, tracer, points, pixels, chosen, environments, looks),
    )
    return decide(*costs, len(environments), len(looks), len(pixels), len(chosen))


def decide(light: Cost, view: Cost, environments: int, looks: int, pixels: int, tried: int) -> Choice:
    """The cheaper of two engines, and the sentence that says so."""
    share = pixels / tried
    seconds = {"light": light.total(environments, share), "view": view.total(environments, share)}
    engine = "view" if seconds["view"] < seconds["light"] else "light"
    names = {
        "light": "L ⊕ V, collapsed for each environment",
        "view": "V ⊕ f_v, one transport for all environments",
    }
    other = "light" if engine == "view" else "view"
    return Choice(
        engine,
        f"{names[engine]}: about {seconds[engine]:.3g} s a view for {environments} environments × {looks} materials "
        f"of {pixels} pixels, against {seconds[other]:.3g} s for {names[other]} (both tried on {tried} pixels)",
    )


def light_cost(
    device: Device, tracer: Tracer, points: Points, pixels: Pixels, chosen: npt.NDArray[np.int64],
    environment: Environment, looks: Sequence[Sequence[Material]],
) -> Cost:  # fmt: skip
    """Seconds of L ⊕ V for some pixels, at their first `FEW` points."""
    some = points[_of(pixels, chosen, FEW)[0]]
    engine = Looks(device, environment, looks, polar=points.polar)
    once, bits = _timed(lambda: engine.pipeline.visibility(tracer, some))
    engine.radiance(tracer, some, bits)  # compiles kernels and makes the slices
    each, _ = _timed(lambda: engine.radiance(tracer, some, bits))
    return Cost(once, each)


def view_cost(
    device: Device, tracer: Tracer, points: Points, pixels: Pixels, chosen: npt.NDArray[np.int64],
    environments: Sequence[Environment], looks: Sequence[Sequence[Material]],
) -> Cost:  # fmt: skip
    """Seconds of V ⊕ f_v for some pixels, at all of their points."""
    index, own = _of(pixels, chosen, None)
    rays = rays_for(material for look in looks for material in look)
    start, view = _timed(lambda: FixedView(device, tracer, points[index], own, rays=rays))
    few = [replace(environments[i % len(environments)]) for i in range(BATCH)]
    view.radiance(few, looks)  # compiles kernels and splits the maps
    before = device.profile.host_seconds().get("resample_light", 0.0)
    one, _ = _timed(lambda: view.radiance(few[:1], looks))
    between = device.profile.host_seconds()["resample_light"]
    many, _ = _timed(lambda: view.radiance(few, looks))
    # The light is resampled once for all pixels: it does not grow with them.
    last = (device.profile.host_seconds()["resample_light"] - between) / BATCH
    one, many = one - (between - before), many - BATCH * last
    each = max(0.0, many - one) / (BATCH - 1)
    return Cost(start + max(0.0, one - each), each, last)


def _of(
    pixels: Pixels, chosen: npt.NDArray[np.int64], most: int | None
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The points of some pixels, at most so many of each, and each one's pixel."""
    counts = np.diff(pixels.first)[chosen]
    counts = counts if most is None else np.minimum(counts, most)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.repeat(pixels.first[chosen], counts) + within, np.repeat(chosen, counts)


def _timed(work: Callable[[], T]) -> tuple[float, T]:
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result

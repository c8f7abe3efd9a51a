"""A plan for vertices: each has only its own rays, so that what one errs is what the picture errs there."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.errors import InputError
from prtcl.factors.visibility import Tracer
from prtcl.scene.pilot import SAMPLES, SEARCHED, Squared, pipelines
from prtcl.scene.plan import Plan, Trial
from prtcl.scene.planner import AIM, SECONDS, SHARE, finished, root, shifted
from prtcl.scene.points import shoot, vertex_points, with_eye
from prtcl.scene.tint import Rows
from prtcl.transport.pipeline import Pipelines, Points
from prtcl.transport.settings import Settings
from prtcl.transport.truth import Truth

if TYPE_CHECKING:
    from prtcl.scene.scene import Scene

Array = npt.NDArray[np.float64]

VERTICES = 1024
"""Vertices of the sample."""


def plan_vertices(scene: Scene, error: float, base: list[Settings], fixed: set[str]) -> Plan:
    """A plan for the vertices in sight, whose radiance is then interpolated; that is not counted as an error.

    Parameters and errors are those of `plan_pixels`.
    """
    start = time.perf_counter()
    rng = np.random.default_rng(0)
    seen = _in_sight(scene, rng)
    chosen = np.sort(rng.choice(seen, min(VERTICES, len(seen)), replace=False)).astype(np.int32)
    points, bits = _points(scene, chosen)
    truth = Truth(scene.environment, scene.tracer, scene.tints.materials)

    def colour(at: npt.NDArray[np.intp]) -> npt.NDArray[np.floating]:
        return scene.mesh.vertex_colour(chosen[at])

    halves = [
        scene.tints.radiance(lambda some, _: truth.radiance(some, SAMPLES, rng), points, colour)
        for _ in (0, 1)
    ]
    mean = float(np.mean(halves))
    trials: list[Trial] = []
    for own in _candidates(base, fixed):
        began = time.perf_counter()
        shade = partial(_shade, pipelines(scene, own), scene.tracer, bits)
        got = scene.tints.radiance(shade, points, colour)
        seconds = (time.perf_counter() - began) / len(chosen) * len(seen)
        each = np.prod([(got - half) / max(mean, 1e-300) for half in halves], axis=0).mean(axis=1)
        off = Squared(float(each.mean()), float(each.std() / np.sqrt(len(each))))
        name = f"4^{max(one.levels for one in own)} directions, 4^{max(one.rays for one in own)} rays"
        # What the reference cannot tell counts as an error: there is no audit later on.
        off = Squared(max(off.value, 0.0) + off.uncertain, off.uncertain)
        met = off.value <= (AIM * error) ** 2
        trials.append(Trial(name, root(off.value), root(off.uncertain), 0.0, seconds if met else None))
        if met or time.perf_counter() - start > max(SECONDS, SHARE * seconds):
            break
    # From coarse to fine: the first that meets the error was the last to be tried.
    last = trials[-1]
    if last.seconds is None:
        raise InputError(
            f"error {error:g}: no setting that was tried meets it: {last.name} err {last.bias:.2g}\n"
            "ask for more, render --points pixel, or fix --levels and --rays by hand"
        )
    return finished(scene, error, own, "vertex", off, 0.0, last.seconds, start, tuple(trials))


def _shade(
    pipelines: Pipelines, tracer: Tracer, bits: npt.NDArray[np.uint32] | None, some: Points, at: Rows
) -> npt.NDArray[np.floating]:
    return pipelines.radiance(tracer, some, None if bits is None else bits[at])


def _candidates(base: list[Settings], fixed: set[str]) -> list[list[Settings]]:
    """Settings from coarse to fine."""
    finest = max(one.rays for one in base)
    shifts = (
        [0] if "rays" in fixed else [s for s in (-2, -1, 0, 1, 2) if 2 <= finest + s <= quadtree.MAX_LEVELS]
    )
    return [[shifted(one, shift, "levels" in fixed) for one in base] for shift in shifts]


def _in_sight(scene: Scene, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    count = scene.camera.size[0] * scene.camera.size[1]
    pixels = np.arange(count) if count <= SEARCHED else rng.choice(count, SEARCHED, replace=False)
    hits = shoot(scene.tracer, scene.camera, pixels, np.zeros(len(pixels), dtype=np.int64))
    return np.unique(scene.mesh.faces[hits.face])


def _points(scene: Scene, chosen: npt.NDArray[np.int32]) -> tuple[Points, npt.NDArray[np.uint32] | None]:
    """Vertices as `VertexShader` shades them, and their visibility where a bake holds it."""
    if scene.bake is None:
        points = vertex_points(scene.mesh, scene.tracer, scene.camera.eye, chosen)
        return scene.single_material(points), None
    points = vertex_points(scene.mesh, scene.tracer, None, chosen)
    points = with_eye(points, scene.mesh.vertices[chosen], scene.camera.eye)
    return scene.single_material(points), scene.bake.bits[chosen]

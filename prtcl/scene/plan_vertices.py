"""A plan for vertices: each has only its own rays, so that what one errs is what the picture errs there."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.factors.visibility import Tracer
from prtcl.scene.ladder import SAMPLES, coarsest
from prtcl.scene.pilot import pipelines, searched
from prtcl.scene.plan import Plan
from prtcl.scene.planner import AIM, finished, shifted
from prtcl.scene.points import shoot, vertex_points, with_eye
from prtcl.scene.tint import Rows
from prtcl.transport.pipeline import Pipelines, Points
from prtcl.transport.settings import Settings
from prtcl.transport.truth import Truth

if TYPE_CHECKING:
    from prtcl.scene.scene import Scene

Array = npt.NDArray[np.float64]

VERTICES = 512
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

    def shade(own: list[Settings]) -> npt.NDArray[np.floating]:
        own_shade = partial(_shade, pipelines(scene, own), scene.tracer, bits)
        return scene.tints.radiance(own_shade, points, colour)

    found = coarsest(
        _candidates(base, fixed),
        lambda own: f"4^{max(one.levels for one in own)} directions, 4^{max(one.rays for one in own)} rays",
        shade,
        lambda: scene.tints.radiance(lambda some, _: truth.radiance(some, SAMPLES, rng), points, colour),
        AIM * error, len(seen), "ask for more, render --points pixel, or fix --levels and --rays by hand",
    )  # fmt: skip
    return finished(
        scene, error, found.candidate, "vertex", found.squared, 0.0, found.seconds, start, found.trials
    )


def _shade(
    pipelines: Pipelines, tracer: Tracer, bits: npt.NDArray[np.uint32] | None, some: Points, at: Rows
) -> npt.NDArray[np.floating]:
    return pipelines.radiance(tracer, some, None if bits is None else bits[at])


def _candidates(base: list[Settings], fixed: set[str]) -> list[list[Settings]]:
    """Settings from coarse to fine."""
    finest = max(one.rays for one in base)
    shifts = [0] if "rays" in fixed else [s for s in (-2, -1, 0, 1) if 2 <= finest + s <= quadtree.MAX_LEVELS]
    return [[shifted(one, shift, "levels" in fixed) for one in base] for shift in shifts]


def _in_sight(scene: Scene, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    pixels = searched(scene, rng)
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

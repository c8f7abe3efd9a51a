"""Resolution for an editing session, so that its vertices err by no more than was asked.

A session evaluates the BRDF exactly over a cut of L ⊕ V (`prtcl.transport.cut`): its error is that of light and
visibility on 4**levels directions, 4**rays of them traced, and that of the cut. The first is measured here, against
float64; the cut gets what is left.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl.compute.chunks import largest_buffer
from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.scene.camera import Triple
from prtcl.scene.ladder import SAMPLES, coarsest
from prtcl.scene.mesh import Mesh
from prtcl.scene.plan import Trial, check_error
from prtcl.scene.planner import AIM, confidence, noise_left
from prtcl.scene.points import back_origins, vertex_points
from prtcl.transport.edit import Relit
from prtcl.transport.truth import Truth
from prtcl.wavelet import pyramid

VERTICES = 512
"""Vertices of the sample."""
RESOLUTION = 0.7
"""The part of the error that light and visibility may have: a half of its square, the cut's the other half."""
CANDIDATES = ((4, 4), (5, 4), (5, 5), (6, 5), (6, 6), (7, 6))
"""Levels of directions and of rays, from coarse to fine."""


@dataclass(frozen=True)
class SessionPlan:
    """Arguments of a `Session`, and what its pictures' vertices are expected to err.

    Attributes
    ----------
    levels, rays : of light and product, of visibility
    error : what the cuts may cost, relative
    predicted, confidence : relative RMSE of the vertices' radiance, and that it is no more than was asked
    trials : the candidates
    """

    asked: float
    levels: int
    rays: int
    error: float
    predicted: float
    confidence: float
    pilot_seconds: float
    trials: tuple[Trial, ...]


def plan_session(
    mesh: Mesh, light: Environment, materials: Sequence[Material], eye: Triple, error: float, *,
    device: Device, levels: int | None = None, rays: int | None = None,
) -> SessionPlan:  # fmt: skip
    """The coarsest resolution that meets a relative RMSE over vertices seen from `eye`.

    Parameters
    ----------
    mesh : with normals
    materials : one a part of the mesh; colours of the mesh count as white
    levels, rays : fixed by hand, or None

    Raises
    ------
    InputError
        If nothing that was tried meets the error, or it is not between 0 and 1.
    """
    check_error(error)
    start = time.perf_counter()
    rng = np.random.default_rng(0)
    tracer = Tracer(mesh.vertices, mesh.faces)
    facing = _facing(mesh, eye)
    chosen = np.sort(rng.choice(facing, min(VERTICES, len(facing)), replace=False)).astype(np.int32)
    points = vertex_points(mesh, tracer, None, chosen)
    towards = np.asarray(eye) - mesh.vertices[chosen]
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    views = np.einsum("nij,nj->ni", points.frames, towards).astype(np.float32)
    points.views[:] = views
    truth = Truth(light, tracer, list(materials))
    every = np.arange(len(chosen), dtype=np.int32)

    def shade(own: tuple[int, int]) -> npt.NDArray[np.floating]:
        relit = Relit(device, tracer, mesh.vertices[chosen], points, back_origins(mesh, tracer)[chosen], *own)
        relit.set_light(light)
        relit.trace(every)
        relit.collapse(every)
        return relit.radiance(relit.dress(list(materials), 0.0), eye, every)

    found = coarsest(
        _candidates(device, len(mesh.vertices), levels, rays), lambda own: f"4^{own[0]} directions, 4^{own[1]} rays",
        shade, lambda: truth.radiance(points, SAMPLES, rng), RESOLUTION * AIM * error, len(facing),
        "ask for more, or fix --levels and --rays by hand",
    )  # fmt: skip
    cuts = math.sqrt(noise_left(error, found.squared.value))
    whole = found.squared.value + cuts**2
    return SessionPlan(
        error, *found.candidate, cuts, math.sqrt(whole),
        confidence(error, whole, math.hypot(found.squared.uncertain, 0.25 * cuts**2)),
        time.perf_counter() - start, found.trials,
    )  # fmt: skip


def _candidates(device: Device, vertices: int, levels: int | None, rays: int | None) -> list[tuple[int, int]]:
    """Pairs of levels and rays that agree with what is fixed and whose sums the device holds."""
    room = largest_buffer(device)
    fitting = [own for own in CANDIDATES if vertices * pyramid.row_bytes(own[0]) <= room] or [CANDIDATES[0]]
    out = [own for own in fitting if levels in (None, own[0]) and rays in (None, own[1])]
    if not out:
        finest = levels if levels is not None else max(fitting[-1][0], rays or 0)
        out = [(finest, min(finest, 5) if rays is None else rays)]
    return out


def _facing(mesh: Mesh, eye: Triple) -> npt.NDArray[np.int64]:
    """Vertices that have the eye above their horizon; all where none has."""
    assert mesh.normals is not None
    towards = np.asarray(eye, dtype=np.float64) - mesh.vertices
    above = (mesh.normals * towards).sum(axis=1) > 0.05 * np.linalg.norm(towards, axis=1)
    return np.flatnonzero(above) if above.any() else np.arange(len(mesh.vertices))

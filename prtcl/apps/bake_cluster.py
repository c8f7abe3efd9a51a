"""A bake on many machines: each task traces the rays of some vertices, and the command puts their bits together.

A vertex's rays depend on the mesh and on its own normal alone (`prtcl.scene.bake.visible`), so the bake is the same,
bit for bit, however its vertices are shared out. Workers get the geometry once, and need no folder in common.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.apps.cluster import Workers, kept
from prtcl.factors.visibility import Tracer
from prtcl.scene.bake import Bake, ready, visible
from prtcl.scene.mesh import Mesh

RAYS = 1 << 22
"""Rays of a task, before those are left out that `prtcl.factors.refine` does not need: about a second of a core's,
4,096 vertices of 4**5 rays. Their bits, half a megabyte, are sent in some milliseconds; a worker that dies costs this.
"""


@dataclass(frozen=True, eq=False)
class Geometry:
    """What workers trace."""

    mesh: Mesh
    rays: int


def trace(
    workers: Workers, mesh: Mesh, rays: int, vertices: int | None, progress: Callable[[int], object]
) -> Bake:
    """`Bake.trace` by workers.

    Parameters
    ----------
    vertices : of a task; None takes what suits the rays
    progress : called with the number of vertices done, as they come

    Raises
    ------
    InputError, PrtclError
        As `Bake.trace` and `Workers.answers`.
    """
    mesh = ready(mesh, rays)
    each = vertices or max(1, RAYS // quadtree.n_samples(rays))
    count = len(mesh.vertices)
    plain = replace(
        mesh, materials=(None,) * len(mesh.materials), notes=(), colours=None, uv=None, twins=None
    )
    geometry = workers.share(Geometry(plain, rays))
    tasks = (
        workers.submit(_trace, geometry, start, min(start + each, count), rank=start)
        for start in range(0, count, each)
    )
    bits = np.zeros((count, quadtree.visibility_words(rays)), dtype=np.uint32)
    with closing(workers.answers(tasks)) as answers:
        for answer in answers:
            start, part = answer.value
            bits[start : start + len(part)] = part
            progress(len(part))
    return Bake(mesh, bits, rays)


def _trace(geometry: Geometry, start: int, stop: int) -> tuple[int, npt.NDArray[np.uint32]]:
    """A worker's task: the first vertex, and the bits of vertices start … stop − 1."""
    mesh = geometry.mesh
    tracer = kept(lambda: Tracer(mesh.vertices, mesh.faces))
    return start, visible(mesh, tracer, geometry.rays, np.arange(start, stop))

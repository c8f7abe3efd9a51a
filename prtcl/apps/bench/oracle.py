"""What a stage's first points should give, in float64, and how far off they are.

The only module that imports `prtcl.reference`: it computes nothing with it, it holds results against it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl import reference as reference
from prtcl.factors import hemisphere
from prtcl.factors.environment import Light
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.transport.pipeline import Points

Array = npt.NDArray[np.float64]

FIRST = 6
"""Points that are checked, at most."""


def haar(samples: npt.ArrayLike) -> Array:
    """Haar coefficients of rows (..., 4**levels)."""
    return np.asarray(reference.haar(samples))


def host(result: Any) -> Array:
    """The first points of a result, from the device or the host, as float64."""
    first = result[: min(FIRST, len(result))]
    return np.asarray(first.get() if hasattr(first, "get") else first, dtype=np.float64)


def error(result: Any, expected: npt.ArrayLike) -> float:
    """The worst point's ‖result − expected‖ / ‖expected‖ among those that both have; infinite where one is not finite.

    Parameters
    ----------
    result : (n, …) device or host array
    expected : (k, …) of the first k points; only the first `FIRST` count
    """
    wanted = np.asarray(expected, dtype=np.float64)[:FIRST]
    got = host(result)
    if got.shape != wanted.shape or not np.isfinite(got).all():
        return float("inf")
    rows = len(wanted)
    length = np.linalg.norm(wanted.reshape(rows, -1), axis=1)
    off = np.linalg.norm((got - wanted).reshape(rows, -1), axis=1)
    # A point that sees nothing has no length: there any difference counts in full.
    return float((off / np.where(length > 0, length, 1.0)).max(initial=0.0))


def gathered(light: Light, frames: npt.ArrayLike, levels: int) -> Array:
    """Soft radiance along every direction of some points: (n, 3, 4**levels), bilinear in the light's cube."""
    world = reference.directions(levels) @ np.asarray(frames, dtype=np.float64)
    d = world @ light.to_map.T
    cube, face = light.cube.astype(np.float64), light.cube.shape[1] - 2
    axis = np.argmax(np.abs(d), axis=-1)
    own, next_, last = (np.take_along_axis(d, ((axis + k) % 3)[..., None], -1)[..., 0] for k in range(3))
    which = 2 * axis + (own < 0)
    s, t = (x / np.abs(own) * face / 2 + face / 2 + 0.5 for x in (next_, last))
    i, j = (np.minimum(x.astype(np.int64), face) for x in (s, t))
    fs, ft = (s - i)[..., None], (t - j)[..., None]
    near = cube[which, j, i] * (1 - fs) + cube[which, j, i + 1] * fs
    far = cube[which, j + 1, i] * (1 - fs) + cube[which, j + 1, i + 1] * fs
    return np.moveaxis((near * (1 - ft) + far * ft)[..., :3], -1, 1)


def bits(tracer: Tracer, points: Points, levels: int) -> npt.NDArray[np.bool_]:
    """Which directions some points see, every ray traced: (n, 4**levels)."""
    directions = reference.directions(levels)
    seen = []
    for origin, frame in zip(points.origins, points.frames.astype(np.float64), strict=True):
        world = (directions @ frame).astype(np.float32)
        seen.append(~tracer.occluded(np.broadcast_to(origin, world.shape), world))
    return np.stack(seen)


def slice_samples(material: Material, views: npt.ArrayLike, levels: int, sub: int) -> Array:
    """f_v with the cosine, averaged over 4**sub directions a cell, each with its mean cosine: (n, 3, 4**levels)."""
    rows, columns = quadtree.morton_to_grid(levels + sub)
    cosine = hemisphere.mean_cosines(rows, columns, 1 << (levels + sub))[:, None]
    incident, given = reference.directions(levels + sub), material.reference()
    made = [
        (reference.brdf(given, incident, view) * cosine).reshape(4**levels, 4**sub, 3).mean(axis=1)
        for view in np.asarray(views, dtype=np.float64)
    ]
    return np.stack(made).transpose(0, 2, 1)


def means(samples: npt.ArrayLike) -> Array:
    """Means over the squares of levels 0 … levels, coarse to fine: (..., n_squares(levels + 1))."""
    values = np.asarray(samples, dtype=np.float64)
    levels = quadtree.levels_of(values.shape[-1])
    return np.concatenate(
        [values.reshape(*values.shape[:-1], 4**r, -1).mean(axis=-1) for r in range(levels + 1)], -1
    )


def inner_product(rows: npt.ArrayLike, f: npt.ArrayLike, weight: npt.ArrayLike, levels: int) -> Array:
    """Radiance (n, 3) of rows (n, 1 or 3, 4**levels) and the slices f (n, k, 1 or 3, 4**levels) of each point."""
    mixed = np.einsum("nk,nkcs->ncs", np.asarray(weight, np.float64), np.asarray(f, np.float64))
    radiance = (np.asarray(rows, np.float64) * mixed).sum(axis=-1) * (2 * np.pi / 4.0**levels)
    return np.broadcast_to(radiance, (len(radiance), 3))

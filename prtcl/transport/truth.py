"""Equation (1) at many points in float64, by importance sampling: what a plan's settings are held against.

Shared with what it judges are the mesh, its rays, and the points themselves; light and reflectance are the definitions
of `prtcl.reference`, evaluated in every direction. The answer is noisy and without bias: whoever compares with it
takes products of differences at points that were sampled apart, in which the noise has mean zero.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl import reference
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer, in_parallel
from prtcl.transport.pipeline import Points

Array = npt.NDArray[np.float64]

PER_TASK = 1 << 15
"""Directions in flight of one thread: their arrays stay in its cache."""
LEAST_ALPHA = 1e-3
WIDE = 0.6
"""GGX alpha from which a lobe is met by what is sampled for the cosine."""


class Truth:
    """Radiance of points under one light, by directions drawn for light, lobe and cosine together.

    Parameters
    ----------
    environment : the light; every texel counts as bilinear, none is left out
    tracer : what occludes
    materials : what `Points.material` indexes
    """

    def __init__(self, environment: Environment, tracer: Tracer, materials: list[Material]) -> None:
        self.tracer, self.to_map = tracer, environment.to_map
        self.image = environment.image.astype(np.float64)
        self.materials = [(own.reference(), max(own.roughness, LEAST_ALPHA)) for own in materials]
        self._drawn = _Texels(self.image, environment.texel_solid_angles())

    def radiance(self, points: Points, samples: int, rng: np.random.Generator) -> Array:
        """(n, 3) float64 radiance, each point by directions of its own.

        Parameters
        ----------
        samples : directions a point, about
        """
        out = np.zeros((len(points), 3))
        tasks = []
        for index in np.unique(points.material):
            of_it = np.flatnonzero(points.material == index)
            step = max(1, PER_TASK // samples)
            tasks += [(index, of_it[start : start + step]) for start in range(0, len(of_it), step)]
        seeds = rng.spawn(len(tasks))

        def run(part: slice) -> None:
            for (index, rows), seed in zip(tasks[part], seeds[part], strict=True):
                out[rows] = self._some(points[rows], int(index), samples, seed)

        in_parallel(run, len(tasks), 1)
        return out

    def _some(self, points: Points, index: int, samples: int, rng: np.random.Generator) -> Array:
        """Points of one material; `incident` and `view` are in each point's own frame."""
        material, alpha = self.materials[index]
        axes, view = points.frames.astype(np.float64), points.views.astype(np.float64)[:, None]
        shares = (
            {"light": 0.5, "cosine": 0.5} if alpha >= WIDE else {"light": 0.4, "lobe": 0.4, "cosine": 0.2}
        )
        sides = {name: max(2, round(np.sqrt(share * samples))) for name, share in shares.items()}
        drawn = []
        for name, side in sides.items():
            if name == "light":
                world = (
                    self._drawn.draw(len(points), side**2, rng) @ self.to_map
                )  # rows times it: map to world
                drawn.append(np.matmul(world, axes.transpose(0, 2, 1)))
            else:
                u, v = _jittered(len(points), side, rng)
                drawn.append(_cosine(u, v) if name == "cosine" else _reflected(u, v, alpha, view))
        incident = np.concatenate(drawn, axis=1)
        world = np.matmul(incident, axes)
        on_map = world @ self.to_map.T
        above = (incident[..., 2] > 0.0) & (view[..., 2] > 0.0)
        # The balance heuristic (Veach & Guibas 1995): each direction over what all three draw it with.
        density = sides["light"] ** 2 * self._drawn.density(on_map)
        density += sides["cosine"] ** 2 * np.maximum(incident[..., 2], 0.0) / np.pi
        if "lobe" in sides:
            density += sides["lobe"] ** 2 * _lobe_density(incident, alpha, view)
        point, direction = np.nonzero(above)
        origins, towards = points.origins[point], world[point, direction].astype(np.float32)
        seen = ~self.tracer.occluded(origins, towards)
        point, direction = point[seen], direction[seen]
        own = incident[point, direction]
        value = reference.environment(self.image, on_map[point, direction])
        value *= reference.brdf(material, own, view[point, 0])
        value *= (own[:, 2] / density[point, direction])[:, None]
        out = np.zeros((len(points), 3))
        for channel in range(3):
            out[:, channel] = np.bincount(point, value[:, channel], len(points))
        return out


class _Texels:
    """Directions of a map drawn in proportion to its texels' energy.

    A texel counts as the brightest of its neighbours: bilinear between centres, a sun shines into the texels beside it.
    """

    def __init__(self, image: Array, solid: Array) -> None:
        self.height, self.width = image.shape[:2]
        bright = image.mean(axis=2)
        bright = np.max([np.roll(bright, shift, axis=1) for shift in (-1, 0, 1)], axis=0)
        padded = np.pad(bright, ((1, 1), (0, 0)), mode="edge")
        bright = np.max([padded[:-2], padded[1:-1], padded[2:]], axis=0)
        energy = bright * solid[:, None]
        total = energy.sum()
        share = energy / total if total > 0 else np.broadcast_to(solid[:, None], energy.shape) / (4 * np.pi)
        self._cumulative = np.cumsum(share)
        self._density = (share / solid[:, None]).ravel()
        # Even in cos θ within a texel, so that its density is constant over the solid angle.
        self._edges = np.cos(np.pi * np.arange(self.height + 1) / self.height)

    def draw(self, points: int, samples: int, rng: np.random.Generator) -> Array:
        """Map directions (points, samples, 3), of each point one from every `samples`-th of the energy."""
        u, a, b = rng.random((3, points, samples))
        at = (np.arange(samples) + u) * (self._cumulative[-1] / samples)
        texel = np.searchsorted(self._cumulative, at, side="right")
        row, column = np.divmod(np.minimum(texel, self._cumulative.size - 1), self.width)
        cosine = self._edges[row] + (self._edges[row + 1] - self._edges[row]) * a
        sine, phi = np.sqrt(np.maximum(1.0 - cosine**2, 0.0)), 2 * np.pi * (column + b) / self.width
        return np.stack([sine * np.sin(phi), cosine, -sine * np.cos(phi)], axis=-1)

    def density(self, on_map: Array) -> Array:
        """Of `draw`, per steradian, at map directions (..., 3)."""
        u, v = reference.equirectangular(on_map)
        row = np.minimum((v * self.height).astype(np.int64), self.height - 1)
        column = np.minimum((u * self.width).astype(np.int64), self.width - 1)
        return self._density[row * self.width + column]


def _jittered(count: int, side: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """One random place in each of side × side cells of the unit square: two arrays (count, side²)."""
    cell = np.arange(side * side)
    u, v = rng.random((2, count, side * side))
    return (cell % side + u) / side, (cell // side + v) / side


def _cosine(u: Array, v: Array) -> Array:
    """Local directions in proportion to the cosine."""
    radius, phi = np.sqrt(u), 2 * np.pi * v
    return np.stack([radius * np.cos(phi), radius * np.sin(phi), np.sqrt(1.0 - u)], axis=-1)


def _reflected(u: Array, v: Array, alpha: float, view: Array) -> Array:
    """The view reflected by half vectors in proportion to the GGX facets that it sees.

    Dupuy & Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps": of a sphere stretched to the facets'
    slopes the visible half is a cap's directions plus the view's.
    """
    stretched = view * [alpha, alpha, 1.0]
    stretched = stretched / np.linalg.norm(stretched, axis=-1, keepdims=True)
    z = (1.0 - u) * (1.0 + stretched[..., 2]) - stretched[..., 2]
    sine, phi = np.sqrt(np.clip(1.0 - z**2, 0.0, 1.0)), 2 * np.pi * v
    half = (np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=-1) + stretched) * [alpha, alpha, 1.0]
    half = half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-300)
    return np.asarray(2.0 * (half * view).sum(axis=-1, keepdims=True) * half - view)


def _lobe_density(incident: Array, alpha: float, view: Array) -> Array:
    """Of `_reflected`, per steradian: G1(v) D(h) / (4 cos θ_v)."""
    total = incident + view
    length = np.maximum(np.linalg.norm(total, axis=-1), 1e-300)
    facing = np.maximum(view[..., 2], 1e-9)
    seen = reference.smith_g1(facing, alpha) / (4.0 * facing)
    return np.asarray(reference.ggx_distribution(np.clip(total[..., 2] / length, 0.0, 1.0), alpha) * seen)

"""What the stages are run on: a bumpy ball under a generated sky, and rows of light as bright and dark as a lamp's.

Everything is made of a block of different points that repeats, so that a million of them need no more work than the
block. All of it lives on the host and is made once.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.apps.bench.costs import Size
from prtcl.compute.device import Device
from prtcl.factors import hemisphere
from prtcl.factors.environment import Environment, Light
from prtcl.factors.material import Material
from prtcl.factors.sky import sun_sky
from prtcl.factors.slices import ViewTable
from prtcl.factors.visibility import Tracer
from prtcl.transport.pipeline import Points

BLOCK = 4096
"""Points that are different."""
ROWS = 512
"""Points whose rows of light are different."""
SKY = 128
"""Rows of the sky's map."""
BUMPS, DEPTH = 9, 0.25
"""Bumps around the ball, and how high they are."""
GREY = "ggx:alpha=0.3,eta=0.2,k=3.0"
COLOURED = "ggx:alpha=0.3,eta=0.18/0.42/1.37,k=3.4/2.35/1.77"


@lru_cache(maxsize=1)
def _ball() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
    """Vertices (n, 3) and faces (m, 3) of a ball of 24,000 triangles whose bumps shadow each other."""
    rows, columns = 80, 160
    theta = np.pi * (np.arange(rows + 1) + 0.01) / (rows + 0.02)
    phi = 2 * np.pi * np.arange(columns) / columns
    t, p = np.meshgrid(theta, phi, indexing="ij")
    radius = 1.0 + DEPTH * np.sin(BUMPS * p) * np.sin(BUMPS * t) * np.sin(t)
    vertices = radius[..., None] * np.stack(
        [np.sin(t) * np.cos(p), np.cos(t), np.sin(t) * np.sin(p)], axis=-1
    )
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a, b = (i * columns + j).ravel(), (i * columns + (j + 1) % columns).ravel()
    faces = np.concatenate([np.stack([a, b, a + columns], 1), np.stack([b, b + columns, a + columns], 1)])
    return vertices.reshape(-1, 3), faces.astype(np.int32)


@lru_cache(maxsize=1)
def tracer() -> Tracer:
    """embree over the ball."""
    return Tracer(*_ball())


@lru_cache(maxsize=1)
def _block() -> Points:
    """`BLOCK` points on the ball, each seen from somewhere above it; frames turned to the viewer."""
    rng = np.random.default_rng(5)
    vertices, faces = _ball()
    face = rng.integers(0, len(faces), BLOCK)
    weight = rng.dirichlet((1.0, 1.0, 1.0), BLOCK)
    corners = vertices[faces[face]]
    positions = np.einsum("nc,ncx->nx", weight, corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals *= np.sign(np.sum(normals * positions, axis=1, keepdims=True))
    away = rng.normal(size=(BLOCK, 3))
    towards = normals + 0.8 * away / np.linalg.norm(away, axis=1, keepdims=True)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    frames = hemisphere.frames_from(normals, towards).astype(np.float32)
    alone = np.full(BLOCK, hemisphere.ALONE, dtype=np.int32)
    views = np.einsum("nij,nj->ni", frames, towards).astype(np.float32)
    origins = tracer().origins(positions, normals, tracer().face_reach[face])
    return Points(origins, frames, views, np.zeros(BLOCK, dtype=np.int32), alone, polar=True)


def points(count: int) -> Points:
    """So many of the ball's points."""
    return _block()[np.arange(count) % BLOCK]


@lru_cache(maxsize=4)
def _traced(levels: int) -> npt.NDArray[np.uint32]:
    block = _block()
    return tracer().visibility(block.origins, block.frames, levels, block.grid)


def bits(count: int, levels: int) -> npt.NDArray[np.uint32]:
    """Visibility of `points`, traced on 4**levels directions: (count, words) uint32."""
    return _traced(levels)[np.arange(count) % BLOCK]


def unpacked(words: npt.NDArray[np.uint32], levels: int) -> npt.NDArray[np.uint8]:
    """Bits as (n, 4**levels) of 0 and 1."""
    flat = np.unpackbits(words.astype("<u4").view(np.uint8), axis=1, bitorder="little")
    return flat[:, : quadtree.n_samples(levels)]


def seen(words: npt.NDArray[np.uint32]) -> int:
    """How many directions are visible, of all points together."""
    return int(np.unpackbits(words.view(np.uint8)).sum(dtype=np.int64))


@lru_cache(maxsize=2)
def environment(channels: int) -> Environment:
    """The sky, grey for one channel."""
    image = sun_sky(SKY, sun_elevation=40.0, sun_azimuth=130.0)
    if channels == 1:
        image = np.repeat(image.mean(axis=2, keepdims=True), 3, axis=2)
    return Environment(image, name="sun and sky")


def light(levels: int, channels: int) -> Light:
    """Its soft and hard part, for 4**levels directions. A new one each time: it keeps what a device holds of it."""
    return environment(channels).split(levels)


def material(channels: int) -> Material:
    """A rough conductor, grey for one channel."""
    return Material.parse(COLOURED if channels == 3 else GREY)


def table(levels: int) -> ViewTable:
    """As many view angles as a job of so many levels stores."""
    return ViewTable.make(True, 128 if levels <= 5 else 256 if levels == 6 else 512)


@lru_cache(maxsize=2)
def samples(levels: int, channels: int) -> npt.NDArray[np.float32]:
    """Rows of light (`ROWS`, channels, 4**levels), float32, 0 or more: the brightest 10⁴ times the dimmest."""
    rng = np.random.default_rng([7, levels, channels])
    shape = (ROWS, channels, quadtree.n_samples(levels))
    return np.exp(rng.standard_normal(shape, dtype=np.float32))


@lru_cache(maxsize=2)
def coefficients(levels: int, channels: int) -> npt.NDArray[np.float32]:
    """Haar coefficients of `samples`."""
    from prtcl.apps.bench.oracle import haar

    return haar(samples(levels, channels)).astype(np.float32)


def repeated(device: Device, block: npt.NDArray[Any], count: int) -> Any:
    """A device array of `count` points, the block's one after another, over and over: (count, …) of its dtype."""
    own = device.array(block[:count], block.dtype)
    out = device.empty((count, *block.shape[1:]), block.dtype)
    source, target = own.reshape(own.shape[0], -1), out.reshape(count, -1)
    for start in range(0, count, len(block)):
        device.paste(source[: min(len(block), count - start)], target, start)
    return out


def light_rows(device: Device, size: Size, *, transformed: bool = False) -> Any:
    """`samples` or, transformed, `coefficients` on the device: (points, channels, 4**levels)."""
    rows = (coefficients if transformed else samples)(size.levels, size.channels)
    return repeated(device, rows, size.points)


def host_rows(rows: npt.NDArray[np.float32], count: int) -> npt.NDArray[np.float32]:
    """The same rows on the host, for rivals: (count, channels, 4**levels)."""
    return rows[np.arange(count) % len(rows)]

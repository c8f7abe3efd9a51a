"""Light, visibility and shapes that several tests share: hard data, fixed seeds, work-group edges."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prtcl import quadtree, reference
from prtcl.compute import tuning
from prtcl.compute.device import Device
from prtcl.factors.sky import sun_sky
from prtcl.files.image import write_exr
from prtcl.scene.camera import Camera


class Ran(NamedTuple):
    """What a command came to."""

    status: int
    out: str
    err: str

    @property
    def events(self) -> list[dict[str, Any]]:
        """Of --json where it prints an object a line."""
        return [json.loads(line) for line in self.out.splitlines()]


Run = Callable[..., Ran]

GROUP_EDGES = (1, 63, 64, 65, 131)
"""Row counts about a work-group of 64, and a prime of several groups."""

DEMO_CAMERA = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(40, 30))
"""Sees all of the demo's scene."""

KINDS = ("random", "sparse", "constant", "high dynamic range")


def ends_long_loops(device: Device) -> bool:
    """Whether the device gives up on the plain twins' longest loops: llvmpipe ends any after 65536 turns."""
    return "llvmpipe" in device.name


def row_counts(levels: int) -> tuple[int, ...]:
    """As many of `GROUP_EDGES` as 4**levels values a row allow in a moment."""
    return GROUP_EDGES if levels <= 4 else (1, 5) if levels <= 6 else (3,)


def light_samples(kind: str, rows: int, levels: int, seed: int = 0) -> NDArray[np.float64]:
    """Rows of light in sample space.

    random: Gaussian; sparse: one sample in sixteen, at least one; constant: a row one value; high dynamic
    range: exp(3 · Gaussian), whose brightest of 4**7 samples is some 10⁵ times the median.
    """
    rng = np.random.default_rng([seed, levels, KINDS.index(kind)])
    shape = (rows, 4**levels)
    if kind == "random":
        return rng.normal(size=shape)
    if kind == "sparse":
        lit = rng.uniform(size=shape) < 1 / 16
        lit[np.arange(rows), rng.integers(0, 4**levels, rows)] = True
        return np.where(lit, rng.uniform(0.5, 2, shape), 0.0)
    if kind == "constant":
        return np.broadcast_to(rng.uniform(0.1, 10, (rows, 1)), shape).copy()
    return np.exp(3 * rng.normal(size=shape))


def visibility(rows: int, levels: int, seed: int = 0) -> NDArray[np.bool_]:
    """Binary visibility: half of the rows random, half with a straight horizon; never all hidden."""
    rng = np.random.default_rng([seed, levels, 99])
    seen = rng.uniform(size=(rows, 4**levels)) < 0.5
    d = reference.directions(levels)
    for row in range(0, rows, 2):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        seen[row] = d @ axis > rng.choice([-0.3, 0.0, 0.3])
    seen[np.arange(rows), rng.integers(0, 4**levels, rows)] = True
    return seen


def pack_bits(seen: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """(rows, 4**levels) bool to (rows, words) uint32: sample s is bit s % 32 of word s // 32."""
    rows, count = seen.shape
    words = np.zeros((rows, quadtree.visibility_words(quadtree.levels_of(count))), dtype=np.uint32)
    for s in range(count):
        words[:, s // 32] |= seen[:, s].astype(np.uint32) << np.uint32(s % 32)
    return words


def write_skies(folder: Path, height: int) -> dict[str, Path]:
    """Two environments as EXR files, a high and a low sun: name to path."""
    found = {}
    for name, elevation in (("noon", 60.0), ("late", 10.0)):
        sky = sun_sky(height, sun_elevation=elevation, sun_azimuth=130.0)
        found[name] = folder / f"{name}.exr"
        write_exr(found[name], np.dstack([sky, np.ones(sky.shape[:2])]).astype(np.float32))
    return found


def frames(count: int, seed: int = 0) -> NDArray[np.float32]:
    """Random right-handed orthonormal frames (count, 3, 3): tangent, bitangent, normal as rows."""
    rng = np.random.default_rng([seed, 7])
    out = np.empty((count, 3, 3))
    for i in range(count):
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        q *= np.sign(np.diag(r))
        out[i] = q if np.linalg.det(q) > 0 else q[[1, 0, 2]]
    return out.astype(np.float32)


@contextmanager
def forms(wide: bool) -> Iterator[None]:
    """Have every kernel that has a form on vectors run in that form, or in its simplest."""
    with ExitStack() as stack:
        for tunable in tuning.KNOWN.values():
            found = [form for form in tunable.forms if (form.name == "wide") == wide]
            stack.enter_context(tunable.trial((found or tunable.forms)[0]))
        yield

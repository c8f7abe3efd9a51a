"""Light, visibility and directions that are hard on arithmetic; made from fixed seeds, float64 that float32 holds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.apps.stress.oracle import reference

Array = npt.NDArray[np.float64]
Seen = npt.NDArray[np.bool_]

BRIGHT = {"a light of 1e6 times the rest, hidden": 1e6, "a sun of 1e9 times the rest, hidden": 1e9}
"""Kinds of light in which the brightest sample is not visible."""


def stored(values: npt.ArrayLike) -> Array:
    """Rounded to float32, so that a device of any precision is given the same numbers."""
    return np.asarray(values, dtype=np.float32).astype(np.float64)


def light(kind: str, levels: int, rows: int = 2) -> Array:
    """Samples (rows, 4**levels).

    random: Gaussian; constant; nearly constant: 1 with 1e-6 of noise; lamps: exp(3 Gaussian), whose brightest of 4**7
    samples is some 10⁵ times the median; the kinds of `BRIGHT`: one sample of so many times the others.
    """
    rng, shape = np.random.default_rng([levels, 11]), (rows, 4**levels)
    noise = rng.normal(size=shape)
    if kind == "random":
        return stored(noise)
    if kind == "constant":
        return stored(np.full(shape, 0.7))
    if kind == "nearly constant":
        return stored(1.0 + 1e-6 * noise)
    if kind == "lamps":
        return stored(np.exp(3 * noise))
    out = rng.uniform(0.5, 1.5, shape)
    out[:, _bright(levels)] = BRIGHT[kind]
    return stored(out)


def _bright(levels: int) -> int:
    """Where the brightest sample is: off the middle, in no corner."""
    return (5 * 4**levels) // 16


def visibility(kind: str, levels: int, rows: int = 2) -> Seen:
    """(rows, 4**levels): "horizon" is a straight one, and holes; "one", "all but one"; "all but the bright one"."""
    rng = np.random.default_rng([levels, 12])
    at = rng.integers(0, 4**levels, rows)
    if kind == "horizon":
        axis = np.array([0.6, -0.3, 0.4])
        seen = np.broadcast_to(reference.directions(levels) @ axis > -0.1, (rows, 4**levels)).copy()
        seen &= rng.uniform(size=seen.shape) < 0.9
        seen[np.arange(rows), at] = True
        return seen
    if kind == "one":
        seen = np.zeros((rows, 4**levels), dtype=np.bool_)
        seen[np.arange(rows), at] = True
        return seen
    seen = np.ones((rows, 4**levels), dtype=np.bool_)
    seen[np.arange(rows), at if kind == "all but one" else _bright(levels)] = False
    return seen


def packed(seen: Seen) -> npt.NDArray[np.uint32]:
    """(rows, 4**levels) to (rows, words) uint32: sample s is bit s % 32 of word s // 32."""
    words = quadtree.visibility_words(quadtree.levels_of(seen.shape[1]))
    flat = np.zeros((len(seen), 32 * words), dtype=np.bool_)
    flat[:, : seen.shape[1]] = seen
    return np.packbits(flat, axis=1, bitorder="little").view("<u4").astype(np.uint32)


def checkerboard(levels: int) -> Array:
    """+c and −c in turn along rows and columns: (1, 4**levels), Morton order."""
    rows, columns = quadtree.morton_to_grid(levels)
    return stored(0.7) * (1.0 - 2.0 * ((rows + columns) & 1))[None]


def adversarial(levels: int, last: float) -> Array:
    """Samples under which every addition of a transform rounds: (n, 4**levels).

    The signs of one basis function, one of every level and kind, so that nothing cancels in its coefficient; the
    magnitudes are between 1 and 2 with an odd last bit, so that a sum of two, which is beyond 2, has to round.

    Parameters
    ----------
    last : the last bit of numbers from 1 to 2, 2⁻²³ in float32
    """
    rng = np.random.default_rng([levels, 13])
    functions = [0, *(quadtree.coefficient(r, 0, m) for r in range(levels) for m in (1, 2, 3))]
    unit = np.zeros((len(functions), 4**levels))
    unit[np.arange(len(functions)), functions] = 1.0
    signs = np.where(reference.ihaar(unit) < 0, -1.0, 1.0)
    odd = 2 * rng.integers(0, int(0.5 / last), signs.shape) + 1
    return np.asarray(signs * (1.0 + odd * last))


def sphere(z: npt.ArrayLike, phi: npt.ArrayLike) -> Array:
    """Unit vectors of given height and azimuth."""
    height = np.asarray(z, dtype=np.float64)
    s = np.sqrt((1 - height) * (1 + height))
    return np.stack([s * np.cos(phi), s * np.sin(phi), height + 0 * np.asarray(phi)], axis=-1)


def pairs(where: str, count: int = 997) -> tuple[Array, Array]:
    """Incident and outgoing directions (count, 3) over the hemisphere.

    "near the mirror": the outgoing one within 10⁻⁵ … 10⁻¹ of the incident one's mirror direction; "grazing": cosines
    10⁻⁵ … 10⁻¹ of both; "grazing mirror": such, in mirror directions; "at the horizon": cosines 10⁻³⁰ … 10⁻⁵, one
    against the other in some.
    """
    rng = np.random.default_rng(len(where))
    turn = rng.uniform(0, 2 * np.pi, (2, count))
    if where == "near the mirror":
        i = sphere(rng.uniform(0.05, 1, count), turn[0])
        o = i * [-1, -1, 1] + rng.normal(size=(count, 3)) * 10 ** rng.uniform(-5, -1, (count, 1))
        o[:, 2] = np.abs(o[:, 2])
        return i, o / np.linalg.norm(o, axis=1, keepdims=True)
    low, high = (-30, -5) if where == "at the horizon" else (-5, -1)
    i, o = (sphere(10 ** rng.uniform(low, high, count), phi) for phi in turn)
    if where == "grazing mirror":
        o = i * [-1, -1, 1] + rng.normal(size=(count, 3)) * (i[:, 2:] * 10 ** rng.uniform(-4, 0, (count, 1)))
        o[:, 2] = np.abs(o[:, 2])
        o /= np.linalg.norm(o, axis=1, keepdims=True)
    if where == "at the horizon":
        o[::2, :2] = -i[::2, :2]
    return i, o

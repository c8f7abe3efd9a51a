"""Cuts of the quadtree: where f_v may be taken as constant, chosen from its Haar coefficients.

A cut's leaves cover the hemisphere; over each leaf f_v is replaced by its value in the middle, weighed for what its
mean is (`weights`). What that leaves out is f_v's detail below the leaves, and since the inner product with L ⊕ V
multiplies detail by detail, the error's variance is about

    Σ over left-out squares of level r of  Σ_M f_M²  ·  w_r,      w_r = mean of (L ⊕ V)_M² over the points' squares

relative to the mean radiance squared, for f_v and L ⊕ V scaled to a mean product of one. A square is split while
what lies below it counts: the smallest cut whose sum stays below a square of an error. Where a lobe peaks leaves are
samples; far from it they are large. The sum takes details as independent, which those of a lamp or a horizon are not,
and a view is never quite that of its bin's middle, which weighs on flat light, too. So the error of a cut is measured
at some of the mesh's points, and the cut made anew for what that says (`prtcl.transport.pilots`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.factors import hemisphere
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.wavelet import haar

SIDE = 32
"""View bins along the side of the square of views; each is 4.5 degrees wide."""
TRUST = 2.0
"""The most that a leaf's weight may make of f in its middle, and one over the least."""
STEPS = 4
"""Cuts are made for lobe widths in steps of 2^(1/4), the next sharper one: an edit within a step finds its cut made."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cut:
    """Leaves for every canonical view bin.

    Attributes
    ----------
    leaves : (any,) int32 squares, all bins one after another
    starts : (bins + 1,) int32
    weights : (2, any) float32, what f in a leaf's middle counts for, at the sharp and the wide end of the lobes that
        the cut serves
    error : expected, relative to the mean radiance: the root of the sum above, or what was measured
    """

    leaves: npt.NDArray[np.int32]
    starts: npt.NDArray[np.int32]
    weights: npt.NDArray[np.float32]
    error: float


def bins(side: int = SIDE) -> Array:
    """Views of the canonical bins, x ≥ y ≥ 0: (bins, 5, 3), the middle first, then near the corners."""
    half = side // 2
    row, column = np.tril_indices(half)
    out = []
    for da, db in ((0.5, 0.5), (0.02, 0.02), (0.98, 0.02), (0.02, 0.98), (0.98, 0.98)):
        a, b = (row + da) / half, (column + db) / half
        out.append(hemisphere.from_square((a + 1) / 2, (b + 1) / 2))
    return np.stack(out, axis=1)


def ends(material: Material) -> tuple[tuple[Material, ...], tuple[Material, ...], float]:
    """Stand-ins at the sharp and at the wide end of a step of lobe widths, and where between them `material` is.

    Each end is the lobe with and without what else there is. Colours do not matter, and how lobe and base are mixed
    need not: a cut holds for both. So an edit of a colour or an index finds the cut it had.
    """
    if material.kind == "lambert":
        own = (Material.parse("lambert:albedo=0.5"),)
        return own, own, 0.0
    if material.table is not None:
        return (material,), (material,), 0.0
    based = any(np.ravel(material.numbers.get("kd", 0.0)) > 0)
    if material.kind == "blinn":
        place = STEPS * math.log2(max(1.0, material.numbers["exponent"]))
        sharp = math.ceil(place)
        made = [_blinn(2.0 ** (step / STEPS), based) for step in (sharp, sharp - 1)]
        return made[0], made[1], sharp - place
    place = STEPS * math.log2(material.numbers["alpha"])
    sharp = math.floor(place)
    made = [_ggx(2.0 ** (step / STEPS), based) for step in (sharp, sharp + 1)]
    return made[0], made[1], place - sharp


def _blinn(exponent: float, based: bool) -> tuple[Material, ...]:
    text = f"blinn:exponent={min(1e5, exponent):.6g},ks=0.5"
    return tuple(Material.parse(t) for t in ([text, text + ",kd=0.3"] if based else [text]))


def _ggx(alpha: float, based: bool) -> tuple[Material, ...]:
    text = f"ggx:alpha={min(1.0, max(1e-3, alpha)):.6g},f0="
    return tuple(Material.parse(text + t) for t in (["0.8", "0.04,kd=0.5"] if based else ["0.8"]))


def energies(
    device: Device, materials: tuple[Material, ...], levels: int, spread: Array, side: int = SIDE
) -> list[Array]:
    """What the sum above counts in and below each square, by level (bins, 4**r): the most over some materials.

    Parameters
    ----------
    levels : of the product
    spread : (levels,) w_r as above
    """
    views = bins(side)
    below = [np.zeros((len(views), quadtree.n_samples(r))) for r in range(levels)]
    for material in materials:
        own = _below(device, material, views, levels, spread)
        below = [np.maximum(a, b) for a, b in zip(below, own, strict=True)]
    return below


def build(below: list[Array], error: float) -> Cut:
    """The smallest cuts that leave out no more than the square of `error`, of what `energies` gives."""
    allowed, bins_ = error**2, len(below[0])
    low, high = np.full(bins_, -60.0), np.zeros(bins_)
    for _ in range(16):
        middle = (low + high) / 2
        left_out = _split(below, np.exp(middle))[1]
        low, high = np.where(left_out <= allowed, middle, low), np.where(left_out <= allowed, high, middle)
    leaf, left_out = _split(below, np.exp(low))
    bin_of, square = np.nonzero(leaf)
    starts = np.searchsorted(bin_of, np.arange(bins_ + 1)).astype(np.int32)
    ones = np.ones((2, len(square)), dtype=np.float32)
    return Cut(square.astype(np.int32), starts, ones, float(np.sqrt(left_out.mean())))


def weights(packed: Materials, levels: int, own: Cut, means: Array) -> npt.NDArray[np.float32]:
    """What f in the middle of each of a cut's leaves counts for, for the first of some materials.

    A lobe's tail is convex: f in the middle of a leaf is less than its mean there, and pictures come out dark, by a
    percent and more where leaves are large. What f in the middle must be multiplied by changes little with the view.
    Leaves of one sample are left alone, for there the lobe peaks and it changes much; no weight leaves `TRUST`.

    Parameters
    ----------
    means : (bins, squares) as `mean_reflectance` gives them, for this material
    """
    bin_of = np.repeat(np.arange(len(own.starts) - 1), np.diff(own.starts))
    directions = leaf_directions(levels).astype(np.float64)[own.leaves]
    level_of = np.repeat(np.arange(levels + 1), 4 ** np.arange(levels + 1))[own.leaves]
    cosine = directions[:, 3] * 4.0**level_of / (2 * np.pi)
    f = packed.evaluate(0, directions[:, :3], bins()[bin_of, 0]).mean(axis=1) * cosine
    ratio = np.divide(means[bin_of, own.leaves], f, out=np.ones(len(f)), where=f > 0)
    return np.where(level_of < levels, np.clip(ratio, 1 / TRUST, TRUST), 1.0).astype(np.float32)


def mean_reflectance(packed: Materials, levels: int) -> Array:
    """Mean of f times the cosine over every square, for the middle view of every bin: (bins, squares), grey.

    Of the first of some materials.
    """
    views = bins()[:, 0]
    samples = haar.inverse(packed.device, packed.slices(views, levels, sub=1)[0].reshape(-1, 4**levels)).get()
    finest = samples.reshape(len(views), -1, 4**levels).mean(axis=1, dtype=np.float64)
    rows = [finest]
    for _ in range(levels):
        rows.append(rows[-1].reshape(len(views), -1, 4).mean(axis=2))
    return np.concatenate(rows[::-1], axis=1)


def whole(levels: int, side: int = SIDE) -> Cut:
    """Every sample a leaf: the exact mode."""
    count = len(bins(side))
    samples = np.arange(quadtree.n_squares(levels), quadtree.n_squares(levels + 1), dtype=np.int32)
    ones = np.ones((2, samples.size * count), dtype=np.float32)
    return Cut(np.tile(samples, count), np.arange(count + 1, dtype=np.int32) * samples.size, ones, 0.0)


def _below(device: Device, material: Material, views: Array, levels: int, spread: Array) -> list[Array]:
    """Weighted detail in and below each square, the most over a bin's five views: (bins, 4**r) a level."""
    packed = Materials(device, [material])
    slices = packed.slices(views.reshape(-1, 3), levels, sub=0)[0]
    coefficients = slices.get().mean(axis=1).reshape(*views.shape[:2], -1).astype(np.float64)
    # f_v scaled to a sum of one over the samples: with it the mean product is the mean of L V.
    total = np.maximum(coefficients[..., :1] * 2.0**levels, 1e-300)
    detail = (coefficients / total) ** 2
    out: list[Array] = []
    finer = 0.0
    for level in reversed(range(levels)):
        count = quadtree.n_samples(level)
        own = detail[..., count : 4 * count].reshape(*views.shape[:2], count, 3).sum(axis=3) * spread[level]
        here = own + finer
        out.append(here.max(axis=1))
        finer = here.reshape(*views.shape[:2], count // 4, 4).sum(axis=3) if level else 0.0
    return out[::-1]


def _split(below: list[Array], threshold: Array) -> tuple[npt.NDArray[np.bool_], Array]:
    """Leaves (bins, squares of all levels) where no more than `threshold` lies below, and the sum left out."""
    count, levels = len(threshold), len(below)
    leaf = np.zeros((count, quadtree.n_squares(levels + 1)), dtype=np.bool_)
    left_out, alive = np.zeros(count), np.ones((count, 1), dtype=np.bool_)
    for level in range(levels):
        split = alive & (below[level] > threshold[:, None])
        ends = alive & ~split
        leaf[:, quadtree.n_squares(level) : quadtree.n_squares(level + 1)] = ends
        left_out += (below[level] * ends).sum(axis=1)
        alive = np.repeat(split, 4, axis=1)
    leaf[:, quadtree.n_squares(levels) :] = alive
    return leaf, left_out


def leaf_directions(levels: int) -> npt.NDArray[np.float32]:
    """Middle direction of every square of levels 0 … `levels`; w is its mean cosine times its solid angle, sr."""
    out = np.concatenate([hemisphere.directions(level) for level in range(levels + 1)]).astype(np.float64)
    for level in range(levels + 1):
        out[quadtree.n_squares(level) : quadtree.n_squares(level + 1), 3] *= 2 * np.pi / 4**level
    return out.astype(np.float32)

"""Cuts of the quadtree and radiance over them, against float64 sums and the plain twin."""

from __future__ import annotations

import numpy as np
import pytest
from guard import guard_bands
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tolerances import assert_close

from prtcl import quadtree, reference
from prtcl.compute.device import Device
from prtcl.factors import hemisphere
from prtcl.factors.material import Material, from_table
from prtcl.factors.slices import Materials
from prtcl.transport import cut
from prtcl.transport.leaves import Leaves, Squares
from prtcl.wavelet import pyramid

LEVELS = 3
GOLD = Material.parse("ggx:alpha=0.2,eta=0.2/0.4/1.3,k=3.4/2.3/1.8")
MATERIALS = [
    Material.parse("lambert:albedo=0.8/0.2/0.1"), GOLD, Material.parse("ggx:alpha=0.4,f0=0.04,kd=0.5/0.3/0.1"),
    Material.parse("blinn:exponent=20,ks=0.5/0.4/0.3,kd=0.1"),
    from_table(np.random.default_rng(6).uniform(0.1, 1, (7, 5, 3)), np.linspace(0, 1.5, 7), np.linspace(0.1, 1.4, 5)),
]  # fmt: skip


def directions(count: int, seed: int = 0) -> NDArray[np.float64]:
    """Unit directions over the upper hemisphere, the axes and diagonals of the square among them."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(count, 3))
    d[:, 2] = np.abs(d[:, 2]) + 0.05
    d[: min(8, count), :2] = np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, 1], [1, -1], [0, 0]])[
        :count
    ]
    return d / np.linalg.norm(d, axis=1, keepdims=True)


class Case:
    """Random packed sums of some points, and views of some of them."""

    def __init__(self, device: Device, chosen: int, cuts: list[cut.Cut], levels: int = LEVELS) -> None:
        rng = np.random.default_rng(3)
        self.device, self.levels, self.cuts, points = device, levels, cuts, 9
        samples = np.exp(rng.normal(size=(points, 3, 4**levels))).astype(np.float32)
        sums = device.array(np.zeros((points, quadtree.n_squares(levels + 1))), np.uint32)
        pyramid.pack(device, device.array(samples), device.array(np.arange(points), np.int32), sums, 256.0)
        self.means = pyramid.unpack(sums.get(), 256.0).astype(np.float64)
        self.material = (np.arange(points) % len(MATERIALS)).astype(np.int32)
        self.chosen = rng.integers(0, points, chosen).astype(np.int32)
        self.views = directions(chosen)
        self.materials = Materials(device, MATERIALS)
        padded = np.concatenate([self.views, np.zeros((chosen, 1))], axis=1)
        leaves = Leaves(device, Squares(levels), cuts)
        self.arguments = (
            *self.materials.arguments, device.array(self.material, np.int32),
            *leaves.arguments,
            sums, device.array(self.chosen, np.int32), device.array(padded),
        )  # fmt: skip

    def run(self, kernel: str, group: int) -> NDArray[np.floating]:
        device, count = self.device, len(self.chosen)
        kernels = device.kernels(
            "cut.cl", LEVELS=self.levels, SIDE=cut.SIDE, KINDS=self.materials.mask, GROUP=group
        )
        out = device.empty((count, 4))
        if kernel == "shade_cut":
            device.launch(kernels[kernel], group, group, *self.arguments, out, 1 / 256.0, 0, y=count)
        else:
            device.launch(kernels[kernel], count, group, *self.arguments, out, 1 / 256.0, count)
        return out.get()

    def expected(self) -> NDArray[np.float64]:
        """The same sum in float64, bins and turns found otherwise: the view's cell of the square, and the leaves
        turned as directions."""
        leaves = cut.leaf_directions(self.levels).astype(np.float64)
        finest = hemisphere.to_square(leaves[:, :3])
        level_of = np.repeat(np.arange(self.levels + 1), 4 ** np.arange(self.levels + 1))
        out = np.zeros((len(self.chosen), 3))
        for i, point in enumerate(self.chosen):
            own, view = self.material[point], self.views[i]
            a, b = (abs(2 * x - 1) for x in hemisphere.to_square(view))
            row, column = sorted(
                (min(int(x * cut.SIDE / 2), cut.SIDE // 2 - 1) for x in (a, b)), reverse=True
            )
            index = row * (row + 1) // 2 + column
            nodes = self.cuts[own].leaves[self.cuts[own].starts[index] : self.cuts[own].starts[index + 1]]
            for node in nodes:
                u, v = 2 * finest[0][node] - 1, 2 * finest[1][node] - 1
                if abs(view[1]) > abs(view[0]):
                    u, v = v, u
                u, v = u * (-1 if view[0] < 0 else 1), v * (-1 if view[1] < 0 else 1)
                level, side = level_of[node], 1 << level_of[node]
                place = int((v + 1) / 2 * side), int((u + 1) / 2 * side)
                there = quadtree.square(level, quadtree.grid_to_morton(level)[place])
                d = hemisphere.from_square((u + 1) / 2, (v + 1) / 2)
                f = reference.brdf(MATERIALS[own].reference(), d[None], view)[0]
                out[i] += f * leaves[node, 3] * self.means[point, there]
        return out


def made(device: Device, error: float, levels: int = LEVELS) -> list[cut.Cut]:
    spread = 4.0 ** -np.arange(levels)
    return [cut.build(cut.energies(device, cut.ends(m)[0], levels, spread), error) for m in MATERIALS]


@pytest.mark.parametrize("group", [16, 64])
@pytest.mark.parametrize("error", [0.3, 0.03])
def test_against_the_float64_sum(any_device: Device, group: int, error: float) -> None:
    cuts = made(any_device, error)
    assert any(len(c.leaves) < 136 * 4**LEVELS for c in cuts), "MISTRUSTED: every cut is the whole grid"
    with guard_bands(any_device):
        case = Case(any_device, 33, cuts)
        fast, plain = case.run("shade_cut", group), case.run("shade_cut_plain", 64)
    expected = case.expected()
    # Positive terms: f errs by some tens of roundings (tests/tolerances.py), the sum by one a term.
    bound = expected * (200 + 4**LEVELS) * 2.0**-24
    assert_close(fast[:, :3], expected, bound)
    assert_close(plain[:, :3], expected, bound)
    assert not fast[:, 3].any()


@pytest.mark.parametrize("chosen", [1, 63, 64, 65, 131])
def test_fast_equals_plain_at_the_edges_of_a_group(device: Device, chosen: int) -> None:
    case = Case(device, chosen, [cut.whole(2)] * len(MATERIALS), levels=2)
    fast, plain = case.run("shade_cut", 16), case.run("shade_cut_plain", 64)
    assert_close(fast, plain, np.abs(plain) * 64 * 2.0**-24)
    assert (case.run("shade_cut", 16) == fast).all(), "two runs agree bit for bit"


def test_a_view_below_the_horizon_is_black(device: Device) -> None:
    case = Case(device, 3, [cut.whole(2)] * len(MATERIALS), levels=2)
    views = np.array([[0.6, 0, -0.8, 0], [0.0, 0, 1, 0], [0, 0, 0, 0]])
    case.arguments = (*case.arguments[:-1], device.array(views))
    got = case.run("shade_cut", 16)
    assert not got[[0, 2]].any()
    assert (got[1, :3] > 0).all()


@pytest.mark.parametrize("levels", [1, 2, 4])
def test_turns_of_the_square(levels: int) -> None:
    """Each is a permutation of every level; the first is none; a leaf's direction turns with it."""
    turns, leaves = quadtree.turned_squares(levels), cut.leaf_directions(levels)
    assert (turns[0] == np.arange(turns.shape[1])).all()
    for turn, to in enumerate(turns):
        assert (np.sort(to) == np.arange(turns.shape[1])).all()
        d = leaves[:, :3].copy()
        d[:, :2] = d[:, 1::-1] if turn & 4 else d[:, :2]
        d[:, 0] *= -1 if turn & 1 else 1
        d[:, 1] *= -1 if turn & 2 else 1
        assert np.abs(leaves[to, :3] - d).max() < 1e-6


@given(st.sampled_from(range(len(MATERIALS))), st.floats(0.005, 0.5))
def test_a_cut_covers_the_hemisphere_once(which: int, error: float) -> None:
    """In every bin the leaves' solid angles add up to 2 pi, and no leaf lies in another."""
    spread = 4.0 ** -np.arange(LEVELS)
    own = cut.build(cut.energies(shared_device(), cut.ends(MATERIALS[which])[0], LEVELS, spread), error)
    level_of = np.repeat(np.arange(LEVELS + 1), 4 ** np.arange(LEVELS + 1))
    for first, last in zip(own.starts[:-1], own.starts[1:], strict=True):
        covered = np.zeros(4**LEVELS, dtype=int)
        for node in own.leaves[first:last]:
            level = level_of[node]
            index, run = node - quadtree.n_squares(level), 4 ** (LEVELS - level)
            covered[index * run : (index + 1) * run] += 1
        assert (covered == 1).all()


def shared_device() -> Device:
    from prtcl.stages import default_device

    return default_device()


def test_less_error_takes_more_leaves(device: Device) -> None:
    spread = 4.0 ** -np.arange(5.0)
    sizes = []
    for error in (0.3, 0.1, 0.03, 0.01):
        own = cut.build(cut.energies(device, (GOLD,), 5, spread), error)
        assert own.error <= error
        sizes.append(len(own.leaves))
    assert sizes == sorted(sizes)
    assert sizes[-1] > 3 * sizes[0]


def test_a_sharper_lobe_has_finer_leaves_at_its_peak_and_no_more_elsewhere(device: Device) -> None:
    spread = 4.0 ** -np.arange(6.0)
    sharp = Material.parse("ggx:alpha=0.05,f0=0.8")
    own = cut.build(cut.energies(device, (sharp,), 6, spread), 0.02 / 3)
    finest = quadtree.n_squares(6)
    assert (own.leaves >= finest).any()
    assert len(own.leaves) / 136 < 0.1 * 4**6


@pytest.mark.parametrize("alpha", [0.05, 0.11, 0.3, 0.9])
def test_what_stands_in_is_no_wider(alpha: float) -> None:
    """An edit of colour or index keeps its cut; one of width may take the next."""
    first = cut.ends(Material.parse(f"ggx:alpha={alpha},eta=0.2,k=3"))[0]
    assert all(alpha / 2**0.25 < m.numbers["alpha"] <= alpha * (1 + 1e-6) for m in first)
    again = cut.ends(Material.parse(f"ggx:alpha={alpha},eta=1.5/1.4/0.3,k=2"))[0]
    assert [m.spec for m in first] == [m.spec for m in again]
    assert len(cut.ends(Material.parse(f"ggx:alpha={alpha},f0=0.04,kd=0.3"))[0]) == 2

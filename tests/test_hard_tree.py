"""The tree over hard light: its nodes, its cuts, its kernels against float64 sums over all samples."""

from __future__ import annotations

import cases
import numpy as np
import pytest
from guard import guard_bands
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tolerances import assert_close

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.transport import hard_tree
from prtcl.transport.hard_tree import HardSums, Tree
from prtcl.wavelet import pyramid

SPECS = ("lambert:albedo=0.8/0.2/0.1", "ggx:alpha=0.3,f0=0.04,kd=0.5", "ggx:alpha=0.1,eta=0.2/0.4/1.3,k=3",
         "ggx:alpha=0.05,f0=0.9")  # fmt: skip
MATERIALS = [Material.parse(spec) for spec in SPECS]


def lights(count: int, seed: int = 0, sun: bool = False) -> NDArray[np.float64]:
    """Samples all over the sphere; or a sun of half a degree with most of the energy, and a glow about it."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(count, 3))
    if sun:
        d = np.array([0.3, 0.9, 0.2]) + d * np.where(np.arange(count) < count // 2, 0.003, 0.03)[:, None]
    energy = rng.uniform(0.2, 1.0, (count, 3)) * (
        np.where(np.arange(count) < count // 2, 20, 1)[:, None] if sun else 1
    )
    return np.concatenate([d / np.linalg.norm(d, axis=1, keepdims=True), energy], axis=1)


@given(count=st.integers(1, 40), seed=st.integers(0, 1000))
def test_nodes_are_ranges_that_halve_down_to_single_samples(count: int, seed: int) -> None:
    hard = lights(count, seed)
    tree = Tree.over(hard)
    assert sorted(tree.order) == list(range(count))
    assert len(tree.ranges) == 2 * count - 1
    assert tree.ranges[0].tolist() == [0, count]
    weight = hard[tree.order, 3:].mean(axis=1)
    for node, (first, last) in enumerate(tree.ranges):
        own = weight[first:last] / weight[first:last].sum()
        mean = own @ hard[tree.order[first:last], :3]
        np.testing.assert_allclose(tree.centres[node], mean / np.linalg.norm(mean), atol=1e-12)
        assert np.isclose(tree.shares[node], weight[first:last].sum() / weight.sum())
        left, right = tree.children[node]
        if last - first == 1:
            assert left == right == -1
            assert tree.extents[node] < 1e-7
        else:
            assert left > node and right > node
            assert [*tree.ranges[left], *tree.ranges[right]] == [
                first,
                tree.ranges[left][1],
                tree.ranges[left][1],
                last,
            ]


@given(count=st.integers(0, 60), width=st.floats(0.01, 1.0), error=st.floats(0.0, 0.5))
def test_a_cut_holds_every_sample_once(count: int, width: float, error: float) -> None:
    tree = Tree.over(lights(count, count))
    cut = tree.cut(width, error)
    covered = np.zeros(count, dtype=int)
    for node in cut:
        covered[tree.ranges[node][0] : tree.ranges[node][1]] += 1
    assert (covered == 1).all()
    if error == 0:
        assert len(cut) == count
    assert (tree.extents[cut] <= max(width, 1e-7)).all()


def test_narrow_lobes_and_small_errors_take_more_nodes() -> None:
    tree = Tree.over(lights(200, sun=True))
    widths = [len(tree.cut(width, 0.01)) for width in (1.0, 0.3, 0.1, 0.03)]
    errors = [len(tree.cut(0.1, error)) for error in (0.1, 0.03, 0.01, 0.003)]
    assert widths == sorted(widths) and widths[0] < 4 and widths[-1] > 10
    assert errors == sorted(errors) and errors[0] < errors[-1] < 200


class Case:
    """Points of several materials, some of whose lights are hidden."""

    def __init__(self, device: Device, hard: NDArray[np.float64], points: int = 40, seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        self.device, self.points = device, points
        self.kept = HardSums(device, hard, 1.0, points)
        self.seen = rng.uniform(size=(points, len(hard))) < 0.7
        # Half of the points have a straight shadow edge: whole runs of samples hidden.
        self.seen[::2] = (self.kept.samples[:, :3] @ rng.normal(size=3)) > -0.2
        self.frames = cases.frames(points, seed)
        views = rng.normal(size=(points, 3))
        views[:, 2] = np.abs(views[:, 2]) + 0.1
        self.views = views / np.linalg.norm(views, axis=1, keepdims=True)
        self.material = (np.arange(points) % len(MATERIALS)).astype(np.int32)
        words = (len(hard) + 31) // 32
        self.bits = np.zeros((points, words), dtype=np.uint32)
        for l in range(len(hard)):
            self.bits[:, l // 32] |= self.seen[:, l].astype(np.uint32) << np.uint32(l % 32)

    def run(self, error: float, chosen: NDArray[np.int32] | None = None) -> NDArray[np.floating]:
        device = self.device
        chosen = np.arange(self.points, dtype=np.int32) if chosen is None else chosen
        self.kept.collapse(self.bits[chosen], chosen)
        out = device.array(np.zeros((len(chosen), 4)))
        padded = np.concatenate([self.views[chosen], np.zeros((len(chosen), 1))], axis=1)
        self.kept.add_radiance(
            Materials(device, MATERIALS), self.kept.lists(MATERIALS, error), device.array(chosen, np.int32),
            device.array(self.material, np.int32), device.array(self.frames), device.array(padded), out,
        )  # fmt: skip
        return out.get()[:, :3]

    def expected(self) -> NDArray[np.float64]:
        out = np.zeros((self.points, 3))
        for p in range(self.points):
            local = self.kept.samples[:, :3] @ self.frames[p].astype(np.float64).T
            f = reference.brdf(MATERIALS[self.material[p]].reference(), local, self.views[p])
            terms = f * np.maximum(local[:, 2:], 0) * self.kept.samples[:, 3:] * self.seen[p][:, None]
            out[p] = terms.sum(axis=0)
        return out


@pytest.mark.parametrize("count", [1, 31, 32, 33, 70])
def test_all_samples_against_the_float64_sum(any_device: Device, count: int) -> None:
    with guard_bands(any_device):
        case = Case(any_device, lights(count))
        got = case.run(0.0)
    expected = case.expected()
    # Energies are kept to half a step of their largest channel, here at most five times the smallest.
    assert_close(got, expected, 5 * pyramid.ROUNDING * expected + 1e-6, zeros=1.0)
    assert expected.any()


@pytest.mark.parametrize("chosen", [1, 63, 64, 65, 131])
def test_nodes_sum_what_is_seen(device: Device, chosen: int) -> None:
    case = Case(device, lights(45), points=150)
    rows = np.random.default_rng(2).permutation(150)[:chosen].astype(np.int32)
    kept = case.kept
    kept.collapse(case.bits[rows], rows)
    got = pyramid.unpack(kept._sums.get(), kept.scale)
    for node, (first, last) in enumerate(kept.tree.ranges):
        want = case.seen[rows, first:last] @ kept.samples[first:last, 3:]
        assert (np.abs(got[node, rows] - want) <= pyramid.ROUNDING * want.max(axis=1, keepdims=True)).all()


@pytest.mark.parametrize("sun", [True, False])
def test_a_cut_errs_about_as_it_may(device: Device, sun: bool) -> None:
    # The bound is a model's: how often a lobe meets a light, and how wide it is, to within half.
    case = Case(device, lights(150, sun=sun), points=400)
    exact, sizes = case.run(0.0), []
    for error in (0.1, 0.03, 0.01):
        got = case.run(error)
        for own in range(len(MATERIALS)):
            a, b = got[case.material == own], exact[case.material == own]
            assert np.sqrt(((a - b) ** 2).mean()) <= 1.5 * error * b.mean(), (own, error)
        sizes.append(sum(len(case.kept.tree.cut(m.roughness, error)) for m in MATERIALS))
    assert sizes[0] < sizes[-1] < 4 * 150


def test_no_hard_light_is_no_node() -> None:
    tree = Tree.over(np.zeros((0, 6)))
    assert len(tree.ranges) == len(tree.cut(0.3, 0.01)) == 0


def test_runs_cover_the_samples_and_are_narrow() -> None:
    rng = np.random.default_rng(0)
    sun = np.array([0.0, 0.6, 0.8]) + 0.01 * rng.normal(size=(150, 3))
    directions = np.concatenate([sun, rng.normal(size=(30, 3))])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    tree = Tree.over(np.concatenate([directions, rng.uniform(0.5, 1, (180, 3))], axis=1))
    starts = tree.runs()
    assert starts[0] == 0 and (np.diff(starts) > 0).all()
    ends = np.append(starts[1:], 180)
    assert (ends - starts).max() <= hard_tree.RUN and len(starts) < 90
    for first, last in zip(starts, ends, strict=True):
        own = directions[tree.order[first:last]]
        assert last - first == 1 or np.linalg.norm(own - own.mean(axis=0), axis=1).max() < 6 * hard_tree.NEAR
    assert Tree.over(np.zeros((0, 6))).runs().tolist() == []

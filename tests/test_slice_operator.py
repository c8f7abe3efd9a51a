"""W_v and its adjoint: against the dense matrix of the definition, the inner product, the twin, brdf_slices."""

from __future__ import annotations

from functools import lru_cache

import cases
import numpy as np
import pytest
import tolerances
from guard import guard_bands
from numpy.typing import NDArray

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import hemisphere
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.environment import Light
from prtcl.factors.slice_operator import SliceOperator
from prtcl.factors.slices import GRAZING, Materials, ViewTable

Array = NDArray[np.float64]
THETA_H, THETA_D = np.linspace(0.0, 1.0, 7) ** 2 * np.pi / 2, np.linspace(0.1, 1.5, 5)


def views(count: int = 5) -> Array:
    """Of a polar table, the last of them on the horizon."""
    return ViewTable.make(True, count).views


def hats(nodes: Array, angle: Array) -> Array:
    """Weight of every node at some angles: (..., n), by linear interpolation of unit vectors, clamped outside."""
    return np.stack([np.interp(angle, nodes, own) for own in np.eye(nodes.size)], axis=-1)


def node_weights(incident: Array, outgoing: Array, theta_h: Array, theta_d: Array) -> Array:
    """(..., nh, nd) bilinear weights of pairs of directions, zero below the horizon."""
    half = incident + outgoing
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    h = np.arctan2(np.hypot(half[..., 0], half[..., 1]), half[..., 2])
    d = np.arctan2(np.linalg.norm(np.cross(half, outgoing), axis=-1), np.sum(half * outgoing, axis=-1))
    above = (incident[..., 2] > 0) & (outgoing[..., 2] > 0)
    both = hats(theta_h, h)[..., :, None] * hats(theta_d, d)[..., None, :]
    return np.asarray(both * above[..., None, None])


@lru_cache(maxsize=4)
def dense(levels: int, sub: int, count: int) -> Array:
    """W of `views(count)` before the Haar transform, by the definition: (views, 4**levels, nh, nd)."""
    fine = hemisphere.directions(levels + sub).astype(np.float64)
    own = views(count)
    own[:, 2] = np.maximum(own[:, 2], GRAZING)
    weights = node_weights(fine[None, :, :3], own[:, None], THETA_H, THETA_D) * fine[:, 3, None, None]
    return weights.reshape(count, 4**levels, 4**sub, *weights.shape[2:]).mean(axis=2)


def bound(levels: int, sub: int, u: float, values: Array) -> Array:
    """What angles that err do to a cell's sample: `tolerances.table_lookup`, the cosine and the average besides."""
    fine = hemisphere.directions(levels + sub).astype(np.float64)
    _, cos_d = reference.half_angles(fine[None, :, :3], views()[:, None])
    each = tolerances.table_lookup(values, THETA_H, THETA_D, u, cos_d) * fine[:, 3]
    return each.reshape(5, 4**levels, 4**sub).mean(axis=2) + (4**sub + 8) * u * np.abs(values).max()


@pytest.mark.parametrize(("levels", "sub", "channels"), [(2, 0, 1), (2, 2, 3), (3, 1, 3)])
def test_forward_against_the_definition(any_device: Device, levels: int, sub: int, channels: int) -> None:
    values = np.random.default_rng(1).normal(size=(7, 5, channels)).astype(np.float32).astype(np.float64)
    with guard_bands(any_device):
        got = (
            SliceOperator(any_device, THETA_H, THETA_D, levels, channels, sub).forward(values, views()).get()
        )
    expected = np.einsum("vshd,hdc->vcs", dense(levels, sub, 5), values)
    u = tolerances.STORED[any_device.precision]
    own = bound(levels, sub, u, values)[:, None]
    limit = tolerances.norms(np.broadcast_to(own, expected.shape)) + tolerances.haar(levels, u, expected)
    tolerances.assert_close(got, reference.haar(expected), np.broadcast_to(limit, got.shape))


@pytest.mark.parametrize(("levels", "sub", "channels"), [(2, 0, 1), (2, 2, 3), (3, 1, 3)])
def test_adjoint_against_the_definition(any_device: Device, levels: int, sub: int, channels: int) -> None:
    """The error of a node is that of its weights: of a table that is one there, whose slope `bound` knows."""
    g = np.random.default_rng(2).normal(size=(5, channels, 4**levels)).astype(np.float32).astype(np.float64)
    operator = SliceOperator(any_device, THETA_H, THETA_D, levels, channels, sub)
    with guard_bands(any_device):
        got = operator.adjoint(g, views(), per_view=True)
    samples = reference.ihaar(g)
    expected = np.einsum("vshd,vcs->vhdc", dense(levels, sub, 5), samples)
    u, summed = (kind[any_device.precision] for kind in (tolerances.STORED, tolerances.SUMMED))
    steepest = max(bound(levels, sub, u, e.reshape(7, 5, 1)).max() for e in np.eye(35))
    size = np.abs(samples).sum(axis=2)[:, None, None, :]
    terms = (4 ** (levels + sub) + 8) * summed * size
    limit = (
        steepest * size
        + terms
        + 2 * levels * u * tolerances.norms(samples)[..., 0][:, None, None] * 2**levels
    )
    tolerances.assert_close(got, expected, np.broadcast_to(limit, got.shape), zeros=0.8)
    whole = operator.adjoint(g, views())
    np.testing.assert_array_equal(whole, got.sum(axis=0))


@pytest.mark.parametrize("channels", [1, 3])
def test_the_two_are_adjoint(any_device: Device, channels: int) -> None:
    """⟨W x, g⟩ = ⟨x, Wᵀ g⟩ to rounding: on one device both sides see the same angles."""
    rng, levels, sub = np.random.default_rng(4), 4, 2
    x, g = rng.normal(size=(7, 5, channels)), rng.normal(size=(5, channels, 4**levels))
    operator = SliceOperator(any_device, THETA_H, THETA_D, levels, channels, sub)
    x, g = (a.astype(any_device.dtype).astype(np.float64) for a in (x, g))
    forward = operator.forward(x, views()).get().astype(np.float64)
    back = operator.adjoint(g, views())
    u = tolerances.STORED[any_device.precision]
    # Both transforms, the sums of 4**sub in a cell and of at most N terms in a node; 8 roundings of each term.
    size = float(np.abs(x).max() * np.abs(reference.ihaar(g)).sum())
    limit = (4 ** (levels + sub) + 8) * tolerances.SUMMED[any_device.precision] * size
    limit += (4**sub + 8) * u * size + 4 * levels * u * float(
        np.linalg.norm(x) * np.linalg.norm(g)
    ) * 2**levels
    tolerances.assert_close((forward * g).sum(), (x * back).sum(), limit)
    # The bound is of the worst case; what roundings of random signs leave is a thousandth of it and less.
    assert abs((forward * g).sum() - (x * back).sum()) < 1e3 * u * np.linalg.norm(forward) * np.linalg.norm(g)


def test_forward_is_brdf_slices_bit_for_bit(any_device: Device) -> None:
    values = np.random.default_rng(5).random((7, 5, 3))
    own = Materials(any_device, [Bivariate.make(values, THETA_H, THETA_D).material()])
    got = SliceOperator(any_device, THETA_H, THETA_D, 3, 3, 2).forward(values, views()).get()
    np.testing.assert_array_equal(got, own.slices(views(), 3, 2).get()[0])


def test_two_runs_agree_bit_for_bit_and_with_the_twin(any_device: Device) -> None:
    device, rng, levels, sub, per_row = any_device, np.random.default_rng(6), 2, 1, 2
    operator = SliceOperator(device, THETA_H, THETA_D, levels, 3, sub)
    samples = device.array(np.where(rng.random((10, 3, 16)) < 0.3, 0.0, rng.random((10, 3, 16))))
    outgoing = operator.outgoing(np.tile(views(), (2, 1)))
    outgoing[3, 2] = -0.5  # below the horizon: nothing
    found = []
    for _ in range(2):
        rows = operator.rows(5)
        with guard_bands(device):
            operator.add_soft(rows, samples, outgoing, per_row, 0.25)
        found.append(rows.get())
    np.testing.assert_array_equal(found[0], found[1])
    plain = operator.rows(5)
    twin = device.kernels("bivariate.cl", LEVELS=levels, SUB=sub, CHANNELS=3, KINDS=16, GROUP=64)
    device.launch(
        twin["table_adjoint_plain"], 35, 64, operator.nodes, 7, 5, operator.directions, device.array(outgoing),
        samples, per_row, 0.25, plain, y=5,
    )  # fmt: skip
    most = 2 * (64 + 8) * tolerances.STORED[device.precision] * 0.25 * samples.get().sum(axis=2).max()
    tolerances.assert_close(found[0], plain.get(), most, zeros=0.8)


def test_hard_light_against_the_definition(any_device: Device) -> None:
    device, rng, count = any_device, np.random.default_rng(7), 40
    towards = rng.normal(size=(count, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    light = Light(
        np.zeros((6, 3, 3, 4), np.float32), np.hstack([towards, rng.random((count, 3))]), np.eye(3), 1, 1
    )
    frames, seen = cases.frames(6), rng.random((6, count)) < 0.7
    bits = np.zeros((6, 2), np.uint32)
    for at in range(count):
        bits[:, at // 32] |= seen[:, at].astype(np.uint32) << np.uint32(at % 32)
    operator = SliceOperator(device, THETA_H, THETA_D, 1)
    outgoing = operator.outgoing(np.resize(views()[:4], (6, 3)))
    rows = operator.rows(3)
    with guard_bands(device):
        operator.add_hard(rows, light, bits, frames, outgoing, 2, 0.5)
    local = np.einsum("pij,lj->pli", frames.astype(np.float64), towards)
    weights = node_weights(local, outgoing[:, None, :3], THETA_H, THETA_D)
    terms = np.einsum("plhd,pl,pl,lc->phdc", weights, np.maximum(local[..., 2], 0), seen, light.hard[:, 3:])
    expected = 0.5 * terms.reshape(3, 2, 7, 5, 3).sum(axis=1).reshape(3, -1)
    u = tolerances.STORED[device.precision]
    slope = 1 / np.diff(THETA_H).min() + 1 / np.diff(THETA_D).min()
    # Directions are stored to 2 u and turned to 8 u; angles as in `tolerances.table_lookup`, and 1e-7 near θ_h = 0.
    per_term = (32 * u * np.pi / 2) * slope + (80 + 8) * u + np.sqrt(u) * 1e-3
    tolerances.assert_close(rows.get(), expected, per_term * 0.5 * 2 * light.hard[:, 3:].sum(), zeros=0.6)


def test_what_is_wrong_is_named(device: Device) -> None:
    with pytest.raises(InputError, match="channels: expected 1 or 3, got 2"):
        SliceOperator(device, THETA_H, THETA_D, 2, 2)
    with pytest.raises(InputError, match="nodes: theta_h expected finite, strictly ascending"):
        SliceOperator(device, THETA_H[::-1], THETA_D, 2)
    operator = SliceOperator(device, THETA_H, THETA_D, 2)
    with pytest.raises(InputError, match=r"values: expected shape \(7, 5, 3\), got \(5, 7, 3\)"):
        operator.forward(np.zeros((5, 7, 3)), views())
    with pytest.raises(InputError, match=r"coefficients: expected shape \(5, 3, 16\), got \(5, 3, 64\)"):
        operator.adjoint(np.zeros((5, 3, 64)), views())
    with pytest.raises(InputError, match=r"views: expected \(n, 3\)"):
        operator.outgoing(np.zeros((4, 2)))

"""Three-angle BRDFs: angles, interpolation, gaps, clamping, the table of two angles, the device."""

from __future__ import annotations

import numpy as np
import pytest
import tolerances
from numpy.typing import NDArray

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import three_angles
from prtcl.factors.bivariate import Bivariate, directions, merl_nodes
from prtcl.factors.measured import Measured, filled, turns
from prtcl.factors.reduction import reduction_error
from prtcl.factors.slices import Materials
from prtcl.transport import cut
from prtcl.transport.settings import choose

Array = NDArray[np.float64]
NODES = np.linspace(0.1, 1.2, 6) ** 2, np.linspace(0.05, 1.5, 5)


def measured(gaps: float = 0.0, seed: int = 4) -> Measured:
    rng = np.random.default_rng(seed)
    return Measured.make(
        rng.uniform(0.1, 1, (6, 5, 8, 3)), *NODES, rng.random((6, 5, 8)) >= gaps, name="made"
    )


def pairs(count: int = 500, seed: int = 5) -> tuple[Array, Array]:
    d = np.random.default_rng(seed).normal(size=(2, count, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    d[..., 2] = np.abs(d[..., 2])
    return d[0], d[1]


# --- angles -------------------------------------------------------------------------------------------------


def test_angles_are_those_of_the_directions_made_from_them() -> None:
    rng = np.random.default_rng(6)
    h, d, p = rng.random((3, 300)) * [[1.5], [1.5], [2 * np.pi]] - [[0], [0], [np.pi]]
    found = three_angles.angles(*directions(h, d, p))
    for got, wanted in zip(found, (h, d, p), strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-12)


def test_angles_are_those_of_the_definition() -> None:
    """The reference turns the incident direction; here nothing is turned."""
    i, o = pairs()
    for got, wanted in zip(three_angles.angles(i, o), reference.difference_angles(i, o), strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-11)


def test_swapped_directions_are_half_a_turn_apart() -> None:
    i, o = pairs()
    (h, d, p), (h2, d2, p2) = three_angles.angles(i, o), three_angles.angles(o, i)
    assert (h == h2).all() and (d == d2).all()
    np.testing.assert_allclose((p - p2) % (2 * np.pi), np.pi, atol=1e-12)


# --- interpolation ------------------------------------------------------------------------------------------


def test_nodes_give_their_values() -> None:
    own = measured()
    h, d, p = np.meshgrid(*NODES, turns(8), indexing="ij")
    np.testing.assert_allclose(own.at(h, d, p), own.values, rtol=1e-12)
    np.testing.assert_allclose(own.at(h, d, p - np.pi), own.values, rtol=1e-12)


def test_between_nodes_it_is_linear_in_the_root_of_theta_h() -> None:
    own = measured()
    root = (np.sqrt(NODES[0][2]) + np.sqrt(NODES[0][3])) / 2
    got = own.at(np.array([root**2]), (NODES[1][1:2] + NODES[1][2:3]) / 2, np.array([np.pi / 2]))
    np.testing.assert_allclose(got[0], own.values[2:4, 1:3, 3:5].mean(axis=(0, 1, 2)), rtol=1e-12)


def test_phi_d_is_periodic_and_the_thetas_are_clamped() -> None:
    own = measured()
    h, d = NODES[0][2:3], NODES[1][2:3]
    np.testing.assert_allclose(
        own.at(h, d, np.array([0.0])), own.values[2:3, 2, [0, 7]].mean(axis=1), rtol=1e-12
    )
    top = own.at(np.array([np.pi / 2]), np.array([np.pi / 2]), turns(8)[3:4])
    np.testing.assert_allclose(top[0], own.values[-1, -1, 3], rtol=1e-12)


@pytest.mark.parametrize("gaps", [0.0, 0.4])
def test_it_is_what_the_reference_evaluates(gaps: float) -> None:
    own = measured(gaps)
    i, o = pairs()
    expected = reference.brdf(own.material().reference(), i, o)
    np.testing.assert_allclose(own.evaluate(i, o), expected, rtol=1e-9)
    assert (own.evaluate(i, -o) == 0).all() and (own.evaluate(-i, o) == 0).all()
    np.testing.assert_allclose(own.evaluate(o, i), expected, rtol=1e-9)  # reciprocal


@pytest.mark.parametrize("nodes", [(0.0, 0.0), (0.0, 0.2), (0.3, 0.0)])
def test_first_nodes_at_zero(nodes: tuple[float, float]) -> None:
    rng = np.random.default_rng(1)
    h, d = (np.array([first, 0.5, 1.2]) for first in nodes)
    own = Measured.make(rng.random((3, 3, 4, 3)), h, d)
    i, o = pairs()
    np.testing.assert_allclose(
        own.evaluate(i, o), reference.brdf(own.material().reference(), i, o), rtol=1e-9
    )


def test_one_sample_is_constant() -> None:
    for node in (0.0, 0.4):
        own = Measured.make(np.full((1, 1, 1, 3), 0.25), [node], [node])
        i, o = pairs()
        np.testing.assert_allclose(own.evaluate(i, o), 0.25, rtol=1e-12)
        np.testing.assert_allclose(reference.brdf(own.material().reference(), i, o), 0.25, rtol=1e-12)


def test_invalid_samples_are_left_out() -> None:
    """One of the eight is missing: the other seven's weights are renormalised, to the millionth that a gap counts."""
    own = measured()
    valid = np.ones(own.valid.shape, np.bool_)
    valid[2, 1, 3] = False
    hole = Measured.make(np.where(valid[..., None], own.values, 1e6), *NODES, valid)
    root = (np.sqrt(NODES[0][2]) + np.sqrt(NODES[0][3])) / 2
    at = np.array([root**2]), (NODES[1][1:2] + NODES[1][2:3]) / 2, np.array([np.pi / 2])
    corners = own.values[2:4, 1:3, 3:5].reshape(8, 3)
    np.testing.assert_allclose(hole.at(*at)[0], corners[1:].mean(axis=0), rtol=3e-6)
    assert hole.values.max() <= 1.0  # what stood there is forgotten


def test_where_nothing_was_measured_it_is_filled_and_finite() -> None:
    own = measured()
    valid = np.ones(own.valid.shape, np.bool_)
    valid[3:, :, :] = False
    hole = Measured.make(own.values, *NODES, valid)
    f = hole.at(np.full(8, NODES[0][-1]), np.full(8, NODES[1][1]), turns(8))
    assert np.isfinite(f).all() and (f > 0.05).all()


@pytest.mark.parametrize("gaps", [0.0, 0.4])
def test_the_thetas_are_clamped_to_the_first_nodes(gaps: float) -> None:
    """About coinciding directions, and half vectors at the normal, f is what the first nodes hold at that φ_d."""
    own = measured(gaps)
    turn = np.linspace(0.1, 2 * np.pi, 37)
    first_h, first_d = own.theta_h[:1], own.theta_d[:1]
    for h, d, node in ((0.6, 1e-7, (np.array([0.6]), first_d)), (1e-10, 0.7, (first_h, np.array([0.7])))):
        f = own.evaluate(*directions(h, d, turn))
        expected = own.at(*(np.broadcast_to(x, turn.shape) for x in node), turn)
        np.testing.assert_allclose(f, expected, rtol=1e-4)
    same = np.array([[0.6, 0, 0.8], [0, 0, 1.0]])
    assert np.isfinite(own.evaluate(same, same)).all()


# --- what is made of it -------------------------------------------------------------------------------------


def test_negative_samples_are_left_out_and_noted() -> None:
    values = measured().values.copy()
    values[1, 2, 3, 1] = -1e-3
    own = Measured.make(values, *NODES, name="made")
    assert not own.valid[1, 2, 3] and own.valid.sum() == own.valid.size - 1
    assert own.notes == ("made: 1 of 240 samples are negative; they are left out",)
    np.testing.assert_allclose(
        own.values[1, 2, 3], np.delete(values[1, 2], 3, axis=0).mean(axis=0), rtol=1e-12
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"values": np.ones((6, 5, 3))}, r"expected values\[nh, nd, np, 3\]"),
        ({"theta_h": NODES[0][:-1]}, "expected values"),
        ({"theta_d": NODES[1][::-1]}, "theta_d expected strictly ascending"),
        ({"theta_h": np.degrees(NODES[0])}, "theta_h expected strictly ascending angles from 0 to pi/2"),
        ({"valid": np.ones((6, 5))}, "valid expected bool"),
        ({"valid": np.zeros((6, 5, 8), np.bool_)}, "no sample is valid"),
        ({"values": np.full((6, 5, 8, 3), np.nan)}, "NaN or infinite"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, Array], words: str) -> None:
    given = {
        "values": np.ones((6, 5, 8, 3)),
        "theta_h": NODES[0],
        "theta_d": NODES[1],
        "valid": None,
        **change,
    }
    with pytest.raises(InputError, match=words):
        Measured.make(**given, name="made")


def test_the_material_knows_its_kind() -> None:
    own = measured()
    material = own.material("merl:x.binary")
    assert (material.kind, material.spec, material.grey, material.black) == (
        "measured",
        "merl:x.binary",
        False,
        False,
    )
    assert Measured.make(np.zeros((6, 5, 8, 3)), *NODES).material().black
    assert Measured.make(np.repeat(own.values[..., :1], 3, axis=3), *NODES).material().grey
    assert cut.ends(material) == ((material,), (material,), 0.0)
    settings = choose(material)[0]
    assert settings.levels >= 1


@pytest.mark.parametrize("alpha", [0.05, 0.3])
def test_its_roughness_is_that_of_its_lobe(alpha: float) -> None:
    nodes = np.radians(np.linspace(0, 90, 451))
    lobe = alpha**2 / (np.pi * (np.cos(nodes) ** 2 * (alpha**2 - 1) + 1) ** 2)
    table = np.broadcast_to(lobe[:, None, None, None], (451, 2, 3, 3))
    assert Measured.make(table, nodes, [0.1, 0.2]).material().roughness == pytest.approx(alpha, rel=0.12)


# --- two angles ---------------------------------------------------------------------------------------------


def test_two_angles_are_the_mean_over_phi_d() -> None:
    own = measured()
    reduced = own.bivariate()
    assert isinstance(reduced, Bivariate) and (reduced.valid == own.above.any(axis=2)).all()
    inside = own.above.all(axis=2)
    assert inside.any() and not inside.all()
    np.testing.assert_allclose(reduced.values[inside], own.values.mean(axis=2)[inside], rtol=1e-12)


def test_only_directions_above_the_horizon_count() -> None:
    """Whatever a file holds below it changes nothing."""
    own = measured()
    i, o = directions(NODES[0][:, None, None], NODES[1][:, None], turns(8))
    below = (i[..., 2] <= 0) | (o[..., 2] <= 0)
    assert (below == ~own.above).all() and 0.05 < below.mean() < 0.6
    changed = Measured.make(np.where(below[..., None], 77.0, own.values), *NODES)
    np.testing.assert_array_equal(changed.bivariate().values, own.bivariate().values)
    assert reduction_error(changed) == reduction_error(own)


def test_cells_without_a_measurement_are_filled_marked_and_counted() -> None:
    own = measured()
    valid = np.ones(own.valid.shape, np.bool_)
    valid[2, 3], valid[0, 0] = False, False
    reduced = Measured.make(own.values, *NODES, valid, name="made").bivariate()
    gone = own.above.any(axis=2) & ~reduced.valid
    assert gone.sum() == 2 and gone[2, 3] and gone[0, 0] and reduced.valid[1:4, 3].sum() == 2
    around = [reduced.values[at] for at in ((1, 3), (3, 3), (2, 2), (2, 4))]
    np.testing.assert_allclose(reduced.values[2, 3], np.mean(around, axis=0), rtol=1e-12)
    np.testing.assert_allclose(
        reduced.values[0, 0], (reduced.values[0, 1] + reduced.values[1, 0]) / 2, rtol=1e-12
    )
    count = int((~reduced.valid).sum())
    assert f"{count} of 30 pairs of theta_h and theta_d have no measurement" in reduced.notes[-1]


def test_filling_reaches_everything_from_one_cell() -> None:
    known = np.zeros((4, 7), np.bool_)
    known[3, 1] = True
    assert (filled(np.full((4, 7, 3), 5.0), known) == 5.0).all()


# --- sampling, and the device -------------------------------------------------------------------------------


def test_a_function_is_sampled_reciprocally_above_the_horizon() -> None:
    def f(i: Array, o: Array) -> Array:
        assert (i[:, 2] > 0).all() and (o[:, 2] > 0).all()
        return np.stack([i[:, 2], o[:, 2], i[:, 2] * o[:, 2]], axis=1)

    own = Measured.sample(f)
    assert (own.valid == own.above).all() and 0.7 < own.valid.mean() < 0.8
    i, o = directions(*(x[at] for x, at in zip((*merl_nodes(), turns(180)), (40, 20, 50), strict=True)))
    np.testing.assert_allclose(
        own.values[40, 20, 50], [(i[2] + o[2]) / 2, (i[2] + o[2]) / 2, i[2] * o[2]], rtol=1e-12
    )
    less = Measured.sample(f, least=0.1)
    assert less.valid.sum() < own.valid.sum()


def test_the_device_in_merls_layout(device: Device) -> None:
    """Random numbers in all 1.5 million bins, gaps among them: what no neighbour's value can stand in for."""
    rng = np.random.default_rng(11)
    own = Measured.make(
        rng.uniform(0.1, 1, (90, 90, 180, 3)), *merl_nodes(), rng.random((90, 90, 180)) > 0.2, name="made"
    )
    i, o = (x.astype(np.float32).astype(np.float64) for x in pairs(5000))
    got = Materials(device, [own.material()]).evaluate(0, i, o)
    h, d, p = three_angles.angles(i, o)
    share = own.weighted(h, d, p)[:, 3]
    u = tolerances.STORED["float32"]
    bound = tolerances.measured_lookup(own.values, own.theta_h, own.theta_d, u, (h, d), share)[:, None]
    seen = np.median(bound / own.evaluate(i, o))
    assert seen < 0.01  # the bound is worth something
    tolerances.assert_close(got, own.evaluate(i, o), bound)


@pytest.mark.parametrize("gaps", [0.0, 0.4])
def test_the_device_where_phi_d_says_nothing(device: Device, gaps: float) -> None:
    """The same direction twice, and next to it: some mean of what is measured there, not a NaN."""
    own = measured(gaps)
    i = np.array([[0.6, 0, 0.8], [0, 0, 1.0], [0.28, -0.96 * 0.6, 0.96 * 0.8]])
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    near = i[0] + 3e-7 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    around = Materials(device, [own.material()]).evaluate(
        0, np.concatenate([i, near]), np.concatenate([i, i[:1].repeat(64, 0)])
    )
    ring = own.values[:, 0]
    assert (
        np.isfinite(around).all()
        and around.min() >= ring.min() * 0.999
        and around.max() <= own.values.max() * 1.001
    )

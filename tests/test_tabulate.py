"""Materials as tables: the host's float64 forms against the reference, and the mean over φ_d against a plain one."""

from __future__ import annotations

import numpy as np
import pytest

from prtcl import reference
from prtcl.errors import InputError
from prtcl.factors.analytic import evaluate
from prtcl.factors.bivariate import Bivariate, directions, merl_nodes
from prtcl.factors.material import Material
from prtcl.factors.measured import Measured
from prtcl.factors.tabulate import misplaced, sqrt_nodes, tabulate

SPECS = [
    "lambert:albedo=0.2/0.5/0.8",
    "ggx:alpha=0.3,f0=0.04,kd=0.5/0.2/0.1",
    "ggx:alpha=0.05,f0=0.9/0.7/0.3",
    "ggx:alpha=0.1,eta=0.2/0.4/1.3,k=3.0/2.3/1.8,kd=0.1",
    "blinn:exponent=200,ks=0.5,kd=0.1",
    "blinn:exponent=0,ks=0.5",
]


@pytest.mark.parametrize("spec", SPECS)
def test_f_is_the_references(spec: str) -> None:
    rng = np.random.default_rng(4)
    incident, outgoing = rng.normal(size=(2, 500, 3))
    outgoing[:250] = incident[:250] * [-1, -1, 1] + 0.1 * outgoing[:250]  # near the mirror direction
    incident, outgoing = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (incident, outgoing))
    expected = reference.brdf(Material.parse(spec).reference(), incident, outgoing)
    found = evaluate(Material.parse(spec), incident, outgoing)
    assert (expected > 0).mean() > 0.2
    # The reference takes 1 − cos² for sin², which loses digits at a peak: 1e-16 / α² of D, squared.
    np.testing.assert_allclose(found, expected, rtol=1e-11)


@pytest.mark.parametrize("spec", SPECS)
def test_a_value_is_the_mean_over_phi(spec: str) -> None:
    """Against a sum over 20,000 φ_d, each weighed by both cosines, none below the horizon."""
    h, d = np.radians([0.0, 5.0, 40.0, 70.0, 85.0]), np.radians([1.0, 45.0, 80.0])
    table = tabulate(spec, h, d)
    phi = (np.arange(20_000) + 0.5) * 2 * np.pi / 20_000
    incident, outgoing = directions(h[:, None, None], d[:, None], phi)
    weight = np.maximum(incident[..., 2:], 0.0) * np.maximum(outgoing[..., 2:], 0.0)
    f = reference.brdf(Material.parse(spec).reference(), incident, outgoing)
    expected = (f * weight).sum(axis=2) / weight.sum(axis=2)
    worst = np.abs(table.values / expected - 1).max()
    print(f"{spec}: {worst:.1e}")
    assert worst < 1e-4


def test_what_does_not_depend_on_phi_is_exact_at_the_nodes() -> None:
    table = tabulate("blinn:exponent=50,ks=0.5,kd=0.1", *merl_nodes())
    incident, outgoing = directions(table.theta_h[:, None], table.theta_d, np.pi / 2)
    expected = reference.brdf(
        Material.parse("blinn:exponent=50,ks=0.5,kd=0.1").reference(), incident, outgoing
    )
    np.testing.assert_allclose(table.values, expected, rtol=1e-12)


def test_the_error_is_stated_and_shrinks_with_the_nodes() -> None:
    spec = Material.parse("blinn:exponent=300,ks=0.5")
    coarse, fine = (np.linspace(0, 1, n) ** 2 * np.pi / 2 for n in (31, 121))
    errors = [misplaced(tabulate(spec, h), spec) for h in (coarse, fine)]
    print(errors)
    assert errors[1] < errors[0] / 8 and 0 < errors[1] < 0.01  # bilinear: a sixteenth
    assert "% of the reflected light misplaced" in tabulate(spec).notes[-1]
    assert misplaced(tabulate("lambert:albedo=0.5"), Material.parse("lambert:albedo=0.5")) < 1e-12
    half = Bivariate.make([[0.25 / np.pi]], [0.0], [0.0])
    assert misplaced(half, Material.parse("lambert:albedo=0.5")) == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("alpha", [0.005, 0.03, 0.2, 1.0])
def test_default_nodes_resolve_the_lobe(alpha: float) -> None:
    table = tabulate(f"ggx:alpha={alpha},f0=0.9")
    profile = table.values[:, 0, 0]
    assert (profile[1:] >= 0.5 * profile[0]).sum() >= 10
    assert table.theta_h[0] == 0 and table.theta_h[-1] == pytest.approx(np.pi / 2)
    assert len(sqrt_nodes(1e-9)) <= 1025
    assert table.material().roughness == pytest.approx(alpha, rel=0.15)


def test_a_table_stays_itself_and_colours_of_the_mesh_are_told() -> None:
    own = tabulate("ggx:alpha=0.3,f0=0.9")
    np.testing.assert_array_equal(tabulate(own.material()).values, own.values)
    assert any("mesh's colours" in note for note in tabulate("lambert:albedo=mesh").notes)
    with pytest.raises(InputError, match="two lists of node angles"):
        tabulate("lambert:albedo=0.5", [[0.0, 1.0]])
    with pytest.raises(InputError, match="ascending"):
        tabulate("lambert:albedo=0.5", [1.0, 0.5], [0.1])


def test_a_measured_material_is_evaluated_and_reduced_as_it_says() -> None:
    h, d = (np.linspace(0.05, 1.5, n) for n in (6, 5))
    own = Measured.make(np.random.default_rng(1).random((6, 5, 4, 3)), h, d, name="made")
    incident, outgoing = directions([0.1, 0.4, 0.6], [0.3, 0.5, 0.1], [0.2, 2.0, 5.0])
    np.testing.assert_array_equal(
        evaluate(own.material(), incident, outgoing), own.evaluate(incident, outgoing)
    )
    table = tabulate(own.material())
    np.testing.assert_array_equal(table.values, own.bivariate().values)
    even = tabulate(own.material(), h, d)
    assert even.shape == (6, 5) and np.isfinite(even.values).all()

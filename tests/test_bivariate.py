"""Bivariate tables: nodes, interpolation, files, angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prtcl import reference
from prtcl.errors import InputError
from prtcl.factors.bivariate import Bivariate, directions, interval, merl_nodes


def table(nh: int = 5, nd: int = 4) -> Bivariate:
    rng = np.random.default_rng(3)
    h, d = np.linspace(0.0, np.pi / 2, nh) ** 2 / (np.pi / 2), np.linspace(0.0, np.pi / 2, nd)
    valid = rng.random((nh, nd)) > 0.2
    return Bivariate.make(rng.random((nh, nd, 3)), h, d, valid, name="made")


def test_nodes_give_their_values_and_between_them_is_bilinear() -> None:
    own = table()
    np.testing.assert_array_equal(own.evaluate(own.theta_h[:, None], own.theta_d), own.values)
    between = own.evaluate((own.theta_h[1] + own.theta_h[2]) / 2, (own.theta_d[2] + own.theta_d[3]) / 2)
    np.testing.assert_allclose(between, own.values[1:3, 2:4].mean(axis=(0, 1)), rtol=1e-14)


def test_angles_outside_the_nodes_are_clamped() -> None:
    h, d = merl_nodes()
    own = Bivariate.make(np.random.default_rng(1).random((90, 90, 3)), h, d)
    np.testing.assert_array_equal(own.evaluate(0.0, np.pi / 2), own.values[0, -1])
    assert Bivariate.make([[1.0]], [0.1], [0.2]).evaluate([0.0, 1.0], 0.5).tolist() == [[1.0] * 3] * 2
    low, weight = interval(np.array([0.0, 1.0]), np.array([-1.0, 0.25, 2.0]))
    assert low.tolist() == [0, 0, 0] and weight.tolist() == [0.0, 0.25, 1.0]


def test_the_table_is_the_material_the_reference_evaluates() -> None:
    own, rng = table(), np.random.default_rng(5)
    incident, outgoing = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in rng.normal(size=(2, 200, 3)))
    incident[:, 2], outgoing[:, 2] = np.abs(incident[:, 2]), np.abs(outgoing[:, 2])
    cos_h, cos_d = reference.half_angles(incident, outgoing)
    expected = reference.brdf(own.material().reference(), incident, outgoing)
    np.testing.assert_allclose(own.evaluate(np.arccos(cos_h), np.arccos(cos_d)), expected, rtol=1e-12)


def test_a_saved_table_is_read_back_whole(tmp_path: Path) -> None:
    own = table()
    own.save(tmp_path / "t.npz")
    back = Bivariate.load(tmp_path / "t.npz")
    for key in ("values", "theta_h", "theta_d", "valid"):
        np.testing.assert_array_equal(getattr(back, key), getattr(own, key))


def test_what_is_wrong_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "none.npz", a=1)
    with pytest.raises(InputError, match=r"none\.npz: expected arrays values, theta_h and theta_d, found a"):
        Bivariate.load(tmp_path / "none.npz")
    own = table()
    with pytest.raises(InputError, match=r"made: valid expected bool \(5, 4\), got bool \(4, 5\)"):
        Bivariate.make(own.values, own.theta_h, own.theta_d, own.valid.T, name="made")
    negative = Bivariate.make(own.values - 0.5, own.theta_h, own.theta_d)
    assert negative.values.min() == 0.0 and "negative" in negative.notes[0]


def test_directions_have_the_angles_asked_for() -> None:
    rng = np.random.default_rng(7)
    h, d, p = rng.random((3, 100)) * [[0.5], [0.5], [2 * np.pi]]
    incident, outgoing = directions(h, d, p)
    for x in (incident, outgoing):
        np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1.0, rtol=1e-14)
    cos_h, cos_d = reference.half_angles(incident, outgoing)
    np.testing.assert_allclose(np.arccos(cos_h), h, atol=1e-7)
    np.testing.assert_allclose(np.arccos(cos_d), d, atol=1e-7)

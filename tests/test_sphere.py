"""The grid of directions that all points share."""

from __future__ import annotations

import numpy as np
import pytest

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.factors import sphere
from prtcl.factors.environment import Environment


@pytest.mark.parametrize("levels", [2, 4])
def test_every_centre_lies_in_its_own_cell(levels: int) -> None:
    centres = sphere.centres(levels)[:, :3]
    assert (sphere.cell_of(centres, levels) == np.arange(sphere.n_cells(levels))).all()
    assert np.allclose(np.linalg.norm(centres, axis=1), 1, atol=1e-6)
    # Halves of the sphere: centres sum to nothing, and their outer products to a third of the identity each.
    assert np.abs(centres.mean(axis=0)).max() < 1e-6
    assert np.allclose(centres.T @ centres / len(centres), np.eye(3) / 3, atol=4.0**-levels)


def test_four_cells_surround_a_direction() -> None:
    centres = sphere.centres(4)[:, :3]
    cells, weights = sphere.around(centres, 4)
    nearest = np.argmax(weights, axis=1)
    assert (cells[np.arange(len(cells)), nearest] == np.arange(len(cells))).all()
    assert (weights.max(axis=1) > 1 - 1e-4).all()
    rng = np.random.default_rng(1)
    towards = rng.normal(size=(500, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    cells, weights = sphere.around(towards, 4)
    assert np.allclose(weights.sum(axis=1), 1) and (weights >= 0).all()
    assert (cells == sphere.cell_of(towards, 4)[:, None]).any(axis=1).all()
    near = np.arccos(np.clip((centres[cells] * towards[:, None]).sum(axis=2), -1, 1))
    assert near.max() < 3 * np.sqrt(2 * np.pi / 4**4)


def test_places_lie_in_their_cells_and_differ() -> None:
    places = sphere.places(3, 4)
    for one in places:
        assert (sphere.cell_of(one, 3) == np.arange(sphere.n_cells(3))).mean() > 0.999  # float32 on a border
    assert (np.linalg.norm(places[0] - places[1], axis=1) > 1e-3).all()


def test_the_frames_are_right_handed() -> None:
    assert (np.linalg.det(sphere.FRAMES.astype(np.float64)) == 1.0).all()


def test_constant_light_stays_itself(device: Device) -> None:
    light = Environment.constant((1.0, 2.0, 0.5)).split(4)
    means = sphere.light_means(device, light, 3)
    assert means.shape == (sphere.n_cells(3), 3)
    assert np.allclose(means, [1.0, 2.0, 0.5], rtol=1e-6)


def test_means_are_those_of_the_map(device: Device) -> None:
    """Against float64 averages of 64 bilinear look-ups a cell, turned by an angle that is none of the grid's."""
    rng = np.random.default_rng(0)
    image = rng.uniform(0.5, 1.5, (8, 16, 3)).astype(np.float32)
    turned = Environment(image, rotate=33.0)
    means = sphere.light_means(device, turned.split(6, "off"), 4)
    fine = sphere.centres(7)[:, :3].astype(np.float64)
    exact = (
        reference.environment(image, fine @ turned.to_map.T).reshape(sphere.n_cells(4), 64, 3).mean(axis=1)
    )
    # The cube that is gathered from blurs by its texel, a quarter of a cell here.
    error = np.sqrt(((means - exact) ** 2).mean())
    print(f"{error:.2e}, of the mean {np.abs(means.mean(axis=0) / exact.mean(axis=0) - 1).max():.2e}")
    assert error < 0.005
    assert np.allclose(means.mean(axis=0), exact.mean(axis=0), rtol=5e-4)

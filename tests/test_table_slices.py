"""Local edits of a table: the bits of a full rebuild, from the cells that read what changed."""

from __future__ import annotations

import numpy as np
import pytest

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.bivariate import Bivariate, merl_nodes
from prtcl.factors.slices import Materials, ViewTable
from prtcl.factors.table_slices import TableSlices

LEVELS, VIEWS = 4, 9


def made(device: Device, count: int = VIEWS) -> tuple[TableSlices, Bivariate]:
    table = Bivariate.make(np.random.default_rng(1).random((90, 90, 3)), *merl_nodes())
    return TableSlices(device, table, ViewTable.make(True, count).views, LEVELS, 1), table


def rebuilt(device: Device, table: Bivariate, values: np.ndarray, count: int = VIEWS) -> np.ndarray:  # type: ignore[type-arg]
    own = Bivariate.make(values, table.theta_h, table.theta_d)
    return Materials(device, [own.material()]).slices(ViewTable.make(True, count).views, LEVELS, 1).get()[0]


@pytest.mark.parametrize(
    ("h", "d"),
    [((0, 12), (0, 90)), ((20, 26), (40, 46)), ((80, 90), (84, 90)), ((0, 90), (0, 3)), ((36, 44), (4, 10))],
)
def test_an_edit_gives_the_bits_of_a_full_rebuild(
    any_device: Device, h: tuple[int, int], d: tuple[int, int]
) -> None:
    kept, table = made(any_device)
    before = kept.coefficients.get()
    kept.edit(slice(*h), slice(*d), [5.0, 3.0, 2.0])
    values = table.values.copy()
    values[slice(*h), slice(*d)] = [5.0, 3.0, 2.0]
    np.testing.assert_array_equal(kept.coefficients.get(), rebuilt(any_device, table, values))
    assert 0 < kept.made < VIEWS * 4**LEVELS
    assert (kept.coefficients.get() != before).any()


def test_only_what_reads_an_edited_node_is_made(device: Device) -> None:
    """Cells outside the plan's are those whose samples stay; scattered nodes take no more than they must."""
    kept, table = made(device)
    changed = np.zeros((90, 90), np.bool_)
    changed[[10, 70], [15, 60]] = True
    cells = kept.reading(changed)
    values = np.where(changed[..., None], 9.0, table.values)
    before = kept.samples.get().transpose(0, 2, 1).reshape(-1, 3)
    kept.update(values)
    after = kept.samples.get().transpose(0, 2, 1).reshape(-1, 3)
    differs = np.flatnonzero((before != after).any(axis=1))
    assert len(differs) and set(differs) <= set(cells.tolist())
    whole = np.zeros((90, 90), np.bool_)
    whole[10:71, 15:61] = True
    assert len(cells) < len(kept.reading(whole)) / 4
    np.testing.assert_array_equal(kept.coefficients.get(), rebuilt(device, table, values))


def test_slices_that_are_not_touched_are_not_transformed(device: Device) -> None:
    """Large θ_d is seen by grazing views only: a light at most 90 degrees from the normal is 2 θ_d from the view."""
    kept, table = made(device, 32)
    values = table.values.copy()
    values[:, 85:] = 4.0
    kept.update(values)
    assert 0 < kept.transformed < 16
    np.testing.assert_array_equal(kept.coefficients.get(), rebuilt(device, table, values, 32))
    kept.update(values)
    assert kept.made == kept.transformed == 0


def test_what_is_wrong_is_named(device: Device) -> None:
    kept, table = made(device)
    with pytest.raises(InputError, match=r"values: expected shape \(90, 90, 3\), got \(3, 90, 90\)"):
        kept.update(table.values.transpose(2, 0, 1))
    for bad in (np.nan, -1.0):
        with pytest.raises(InputError, match="expected finite reflectance, 0 or more"):
            kept.edit(slice(0, 1), slice(0, 1), bad)


@pytest.mark.parametrize("seed", range(4))
def test_scattered_edits_give_the_bits_of_a_full_rebuild(device: Device, seed: int) -> None:
    """Nodes here and there: the corner nodes of a cell's rectangle count as those within it."""
    kept, table = made(device)
    rng = np.random.default_rng(seed)
    for _ in range(2):
        values = kept.values.copy()
        some = rng.integers(0, 90, (2, 12))
        values[some[0], some[1]] = rng.random((12, 3)) * 7.0
        kept.update(values)
        np.testing.assert_array_equal(kept.coefficients.get(), rebuilt(device, table, values))

"""kernels/visibility.cl: coefficients of bits are exact, whatever the grids."""

from __future__ import annotations

import cases
import numpy as np
import pytest
from guard import guard_bands
from numpy.typing import NDArray

from prtcl import quadtree, reference
from prtcl.compute.device import Device
from prtcl.wavelet.masked import visibility_coefficients

GRIDS = [(rays, rays, rows) for rays in range(1, 8) for rows in cases.row_counts(rays)] + [
    (rays, levels, 5) for rays, levels in [(1, 2), (2, 3), (1, 5), (3, 5), (4, 5), (5, 6), (3, 7)]
]


def expected(seen: NDArray[np.bool_], levels: int) -> NDArray[np.float64]:
    """Haar of the bits, repeated where the coefficients' grid is finer; float64 holds all of it exactly."""
    repeat = 4**levels // seen.shape[1]
    return reference.haar(np.repeat(seen, repeat, axis=1).astype(np.float64))


def plain(device: Device, bits: NDArray[np.uint32], rays: int, levels: int) -> NDArray[np.floating]:
    kernel = device.kernels("visibility.cl", LEVELS=levels, BITS=rays, GROUP=64)[
        "visibility_coefficients_plain"
    ]
    out = device.empty((len(bits), 1, 4**levels))
    device.launch(kernel, 4**levels, 64, device.array(bits, np.uint32), out, y=len(bits))
    return np.asarray(out.get())[:, 0]


@pytest.mark.parametrize(("rays", "levels", "rows"), GRIDS)
def test_exact(device: Device, rays: int, levels: int, rows: int) -> None:
    seen = cases.visibility(rows, rays)
    bits = cases.pack_bits(seen)
    with guard_bands(device):
        got = visibility_coefficients(device, bits, rays, levels).get()
        twin = plain(device, bits, rays, levels)
    assert got.shape == (rows, 1, 4**levels)
    assert (got[:, 0] == expected(seen, levels)).all()
    assert (twin == expected(seen, levels)).all()


@pytest.mark.parametrize("rays", [1, 2, 3, 5])
def test_exact_in_every_precision(any_device: Device, rays: int) -> None:
    seen = cases.visibility(3, rays)
    got = visibility_coefficients(any_device, cases.pack_bits(seen), rays, 5).get()
    assert got.dtype == any_device.dtype
    assert (got[:, 0] == expected(seen, 5)).all()


@pytest.mark.parametrize("rays", range(1, 8))
def test_all_and_nothing_visible(device: Device, rays: int) -> None:
    count = 4**rays
    bits = cases.pack_bits(np.stack([np.ones(count, bool), np.zeros(count, bool)]))
    got = visibility_coefficients(device, bits, rays).get()[:, 0]
    assert got[0, 0] == 2**rays
    assert not got[0, 1:].any()
    assert not got[1].any()


@pytest.mark.parametrize("rays", [1, 2, 3, 4, 6])
def test_each_bit_is_its_own_sample(device: Device, rays: int) -> None:
    """One visible sample at a time: rows of the inverse of the basis."""
    chosen = np.random.default_rng(rays).permutation(4**rays)[:70]
    seen = np.zeros((len(chosen), 4**rays), dtype=bool)
    seen[np.arange(len(chosen)), chosen] = True
    got = visibility_coefficients(device, cases.pack_bits(seen), rays).get()[:, 0]
    assert (reference.ihaar(got) == seen).all()


@pytest.mark.parametrize("rays", [1, 2])
def test_padding_bits_of_small_grids_are_not_counted(device: Device, rays: int) -> None:
    seen = cases.visibility(4, rays)
    bits = cases.pack_bits(seen)
    padded = bits | (np.uint32(0xFFFFFFFF) << np.uint32(4**rays))
    assert (padded != bits).all()
    got = visibility_coefficients(device, padded, rays, 3).get()[:, 0]
    assert (got == expected(seen, 3)).all()
    assert (plain(device, padded, rays, 3) == expected(seen, 3)).all()


def test_the_packing_of_these_tests_by_hand() -> None:
    seen = np.zeros((1, 64), dtype=bool)
    seen[0, [0, 5, 31, 32, 63]] = True
    assert cases.pack_bits(seen).tolist() == [[(1 << 0) | (1 << 5) | (1 << 31), (1 << 0) | (1 << 31)]]
    assert cases.pack_bits(np.array([[True, False, True, True]])).tolist() == [[0b1101]]
    assert quadtree.visibility_words(1) == 1

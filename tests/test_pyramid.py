"""Packed parent sums: the 32-bit format, and means of squares against float64 NumPy."""

from __future__ import annotations

import cases
import numpy as np
import pytest
import tolerances
from guard import guard_bands

from prtcl import quadtree, reference
from prtcl.compute.device import Device
from prtcl.wavelet import pyramid


def packed(device: Device, samples: np.ndarray, rows: list[int], height: int, scale: float) -> np.ndarray:  # type: ignore[type-arg]
    levels = quadtree.levels_of(samples.shape[-1])
    sums = device.array(np.zeros((height, quadtree.n_squares(levels + 1))), np.uint32)
    pyramid.pack(device, device.array(samples), device.array(rows, np.int32), sums, scale)
    return sums.get()


@pytest.mark.parametrize("levels", range(1, 8))
@pytest.mark.parametrize("channels", [1, 3])
def test_means_of_squares(any_device: Device, levels: int, channels: int) -> None:
    points = 5 if levels < 6 else 2
    samples = np.abs(cases.light_samples("high dynamic range", points * channels, levels))
    samples = samples.reshape(points, channels, -1).astype(np.float32)
    scale = pyramid.scale_for(float(samples.max()))
    with guard_bands(any_device):
        words = packed(any_device, samples, list(range(points))[::-1], points, scale)[::-1]
    got = pyramid.unpack(words, scale)
    for level in range(levels + 1):
        squares = slice(quadtree.n_squares(level), quadtree.n_squares(level + 1))
        mean = samples.astype(np.float64).reshape(points, channels, 4**level, -1).mean(axis=3)
        expected = np.broadcast_to(mean.transpose(0, 2, 1), (points, 4**level, 3))
        # Half a step of the largest channel, and the float32 sums before it.
        step = pyramid.ROUNDING / 2 * expected.max(axis=2, keepdims=True) + 2.0**-24 / scale
        tolerances.assert_close(got[:, squares], expected, 1.01 * step + expected * 2.0**-20)


def test_whole_numbers_are_exact(device: Device) -> None:
    """Mantissas of nine bits: means that need no more, of any magnitude in range, come back as they were."""
    samples = np.zeros((2, 3, 4), dtype=np.float32)
    samples[0] = [[1, 2, 3, 6], [0, 0, 8, 16], [511, 511, 511, 511]]
    samples[1] = samples[0] * 2.0**-20
    got = pyramid.unpack(packed(device, samples, [0, 1], 2, 1.0))
    assert (got[0, 1:] == samples[0].T).all()
    assert (got[0, 0] == [3, 6, 511]).all()
    assert (got[1] == got[0] * 2.0**-20).all()


def test_rows_that_are_not_named_stay(device: Device) -> None:
    samples = np.full((1, 3, 16), 2.0, dtype=np.float32)
    words = packed(device, samples, [1], 3, 1.0)
    assert not words[[0, 2]].any()
    assert (pyramid.unpack(words[1]) == 2).all()


@pytest.mark.parametrize("value", [0.0, 1e-30, 1.0, 511.0, 511.5, 512.0, 32768.0, 65408.0, 1e9])
def test_edges_of_the_format(device: Device, value: float) -> None:
    """Too small is zero, too large the largest; a mantissa that rounds up to 512 takes the next exponent."""
    got = pyramid.unpack(packed(device, np.full((1, 1, 4), value, np.float32), [0], 1, 1.0))[0]
    expected = min(value, 511 * 2.0**7)
    assert np.abs(got - expected).max() <= expected * pyramid.ROUNDING / 2 + 2.0**-25


def test_they_are_the_parent_sums(device: Device) -> None:
    """psum of the Haar coefficients of a function is its mean over each square (docs/mathematics.md)."""
    samples = np.abs(cases.light_samples("random", 3, 3)).reshape(1, 3, 64).astype(np.float32)
    got = pyramid.unpack(packed(device, samples, [0], 1, 1024.0), 1024.0)[0, : quadtree.n_squares(3)]
    coefficients = reference.haar(samples[0])
    for level in range(3):
        for index in range(4**level):
            mean = reference.ihaar(np.pad(coefficients[:, : 4**level], ((0, 0), (0, 64 - 4**level))))
            run = 64 // 4**level
            at = quadtree.square(level, index)
            assert np.allclose(got[at], mean[:, index * run], rtol=0.01, atol=1e-3)


def test_scale_brings_the_largest_in_range() -> None:
    for largest in (1e-30, 0.3, 1.0, 7.0, 1e20):
        scale = pyramid.scale_for(largest)
        assert np.log2(scale) == round(np.log2(scale))
        assert 2**14 <= largest * scale <= 2**15
    assert pyramid.scale_for(0.0) == 1.0

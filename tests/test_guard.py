"""The guard bands themselves: prefilled with NaN, and a value written beyond an array is found."""

from __future__ import annotations

import numpy as np
import pytest
from guard import guard_bands

import prtcl.compute.device as device_module
from prtcl.compute.device import Device

SOURCE = """
kernel void put(global float *dst, const int at)
{
    if (get_global_id(0) == 0)
        dst[at] = 1.0f;
}
"""


def put(device: Device, monkeypatch: pytest.MonkeyPatch, count: int, at: int) -> None:
    monkeypatch.setattr(device_module, "expand", lambda name: SOURCE)
    kernel = device.kernels("test_guard.cl")["put"]
    with guard_bands(device):
        device.launch(kernel, 1, 1, device.empty((count,)), at)


@pytest.mark.parametrize("at", [0, 6])
def test_writing_inside_is_allowed(device: Device, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    put(device, monkeypatch, 7, at)


@pytest.mark.parametrize("at", [-1, 7, 8, -1024, 1030])
def test_writing_outside_is_found(device: Device, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    with pytest.raises(AssertionError, match=r"bytes outside an array of shape \(7,\) were written"):
        put(device, monkeypatch, 7, at)


def test_arrays_are_prefilled_with_nan_and_the_device_is_restored(any_device: Device) -> None:
    with guard_bands(any_device) as made:
        assert np.isnan(any_device.empty((3, 5)).get()).all()
        x = any_device.array(np.arange(6.0).reshape(2, 3))
        assert (x.get() == np.arange(6.0).reshape(2, 3)).all()
        assert any_device.array(np.zeros((0, 3))).shape == (0, 3)
        assert len(made) == 3
    assert "empty" not in vars(any_device)

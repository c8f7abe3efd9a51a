"""Slices made where and when points need them, kept in one device array of bounded size."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import DeviceError
from prtcl.factors.slices import Materials, ViewTable

Keys = npt.NDArray[np.int64]

BATCH = 32 << 20
"""Bytes of new slices made at a time, beside as many bytes of samples: bounds what making them takes."""


class SliceStore:
    """The slices of some materials at the views of a table, each made when a point first asks for it.

    A sharp material has hundreds of views of which a picture may show a few, and takes up to 0.1 s of a CPU for
    each. Where not all fit, those that are there make way for those that are wanted.

    Parameters
    ----------
    materials, table : whose slices, at which views
    levels : of the coefficients
    limit : bytes that the slices may take
    all_views : make all slices at the first request, where they fit

    Notes
    -----
    A *key* names a slice: material · views of the table + view.
    """

    def __init__(
        self, device: Device, materials: Materials, table: ViewTable, levels: int, limit: int,
        all_views: bool = False,
    ) -> None:  # fmt: skip
        self.device, self.materials, self.table, self.levels = device, materials, table, levels
        count = len(materials.list) * len(table.views)
        self._bytes = materials.channels * 4**levels * np.dtype(device.dtype).itemsize
        self.capacity = min(limit // self._bytes, count)
        self._slot = np.full(count, -1, dtype=np.int32)
        self._used = 0
        self._all_views = all_views and self.capacity == count
        self._rows: Any = None  # device array (slots · channels, 4**levels)

    def keys(self, material: npt.NDArray[np.integer], views: npt.NDArray[np.integer]) -> Keys:
        """Keys (n, k) of the slices of materials (n,) at views (n, k) of the table."""
        return material[:, None].astype(np.int64) * len(self.table.views) + views

    def parts(self, keys: Keys, size: int) -> Iterator[npt.NDArray[np.int64]]:
        """Points in parts of at most `size` whose slices fit the array together.

        Points keep their order if all their slices fit. If not, they are sorted by slice, so that hardly any slice is
        made twice.

        Raises
        ------
        DeviceError
            If not even one point's slices fit.
        """
        order = np.arange(len(keys))
        if np.unique(keys).size > self.capacity:
            order = np.argsort(keys[:, 0], kind="stable")
        waiting = [order[start : start + size] for start in range(0, len(order), size)][::-1]
        while waiting:
            part = waiting.pop()
            needed = np.unique(keys[part]).size
            if needed <= self.capacity:
                yield part
            elif len(part) > 1:
                middle = len(part) // 2
                waiting += [part[middle:], part[:middle]]
            else:
                raise DeviceError(
                    f"{self.device.name}: the {needed} slices of one point need {needed * self._bytes} bytes in one "
                    f"buffer, of which {self.capacity} fit\nuse fewer --levels"
                )

    def take(self, keys: Keys) -> tuple[Any, npt.NDArray[np.int32]]:
        """The device array (slots, channels, 4**levels), and where in it the slices of some keys (n, k) are: (n, k).

        Both hold until the next call. At most `capacity` different keys.
        """
        wanted = np.arange(len(self._slot)) if self._all_views else np.unique(keys)
        missing = wanted[self._slot[wanted] < 0]
        if self._used + missing.size > self.capacity:
            self._slot[:], self._used, missing = -1, 0, wanted
        step = max(1, BATCH // self._bytes)
        with self.device.profile.under("brdf_slices"):
            self._reserve(self._used + missing.size)
            for index in np.unique(missing // len(self.table.views)):
                own = missing[missing // len(self.table.views) == index]
                for start in range(0, len(own), step):
                    self._make(int(index), own[start : start + step])
        return self._rows.reshape(-1, self.materials.channels, 4**self.levels), self._slot[keys]

    @property
    def count(self) -> tuple[int, int]:
        """How many slices there are at most, and how many are stored."""
        return len(self._slot), self._used

    def _make(self, index: int, keys: Keys) -> None:
        channels = self.materials.channels
        views = self.table.views[keys % len(self.table.views)]
        made = self.materials.slices_of(index, views, self.levels)
        self.device.paste(made.reshape(-1, 4**self.levels), self._rows, self._used * channels)
        self._slot[keys] = np.arange(self._used, self._used + len(keys))
        self._used += len(keys)

    def _reserve(self, slots: int) -> None:
        """Room for so many slices, what is used kept; twice what was there, for a picture grows part by part."""
        channels, old = self.materials.channels, self._rows
        have = 0 if old is None else old.shape[0] // channels
        if slots <= have:
            return
        if not self._used:
            old = self._rows = None  # given back before the larger one is asked for
        room = min(self.capacity, max(slots, 2 * have))
        self._rows = self.device.empty((room * channels, 4**self.levels))
        if old is not None:
            self.device.paste(old[: self._used * channels], self._rows, 0)

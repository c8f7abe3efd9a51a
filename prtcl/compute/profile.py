"""Device time by stage, from OpenCL events, and the host's time beside it."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Profile:
    """Seconds by stage. Events are read lazily in batches, so that profiling does not stall the queue."""

    _BATCH = 512

    def __init__(self, enabled: bool = True) -> None:
        self.enabled = enabled
        self._pending: list[tuple[str, Any]] = []
        self._device: defaultdict[str, float] = defaultdict(float)
        self._host: defaultdict[str, float] = defaultdict(float)
        self._bytes: dict[str, int] = {}
        self._under: str | None = None

    def add(self, stage: str, event: Any) -> None:
        """Note an event; its time is read once it is done."""
        if self.enabled and event is not None:
            self._pending.append((self._under or stage, event))
            if len(self._pending) >= self._BATCH:
                self._collect()

    @contextmanager
    def host(self, stage: str) -> Iterator[None]:
        """Count the wall time of a block of host work."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._host[stage] += time.perf_counter() - start

    @contextmanager
    def under(self, stage: str) -> Iterator[None]:
        """Count a block's device time to one stage, such as transforms that are none of the points' own."""
        outer, self._under = self._under, stage
        try:
            yield
        finally:
            self._under = outer

    def per_point(self, stage: str, count: int) -> None:
        """State how many bytes a stage keeps for each point; of several statements the largest holds."""
        self._bytes[stage] = max(count, self._bytes.get(stage, 0))

    def _collect(self) -> None:
        for stage, event in self._pending:
            event.wait()
            self._device[stage] += (event.profile.end - event.profile.start) * 1e-9
        self._pending.clear()

    def device_seconds(self) -> dict[str, float]:
        """Device seconds by stage so far."""
        self._collect()
        return dict(self._device)

    def host_seconds(self) -> dict[str, float]:
        """Wall seconds by stage of host work so far."""
        return dict(self._host)

    def bytes_per_point(self) -> dict[str, int]:
        """Bytes a point by stage, as stated by `per_point`."""
        return dict(self._bytes)

    def reset(self) -> None:
        self._collect()
        self._device.clear()
        self._host.clear()
        self._bytes.clear()

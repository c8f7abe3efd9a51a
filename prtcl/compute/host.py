"""The machine that the device's host program runs on."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

LIMITS = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes")
"""Where Linux says what a container may take, in its second and first way of grouping processes."""


def memory() -> int | None:
    """Bytes of memory that this process may take at most; None where the system does not say."""
    known: list[int] = []
    with suppress(AttributeError, OSError, ValueError):  # not every system has these
        known.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    for path in LIMITS:
        with suppress(OSError, ValueError):  # "max" is no limit
            known.append(int(path.read_text()))
    known = [own for own in known if own > 0]
    return min(known) if known else None


def holds(size: float) -> bool:
    """Whether so many bytes fit, as far as the system says."""
    room = memory()
    return room is None or size <= room

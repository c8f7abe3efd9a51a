"""Reading ahead: an iterator that runs on a thread of its own, a few items before they are asked for."""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterator
from queue import Empty, Full, Queue
from typing import TypeVar

T = TypeVar("T")
POLL = 0.1
"""Seconds after which a thread that waits for room looks whether it is still wanted."""


def ahead(items: Iterator[T], depth: int = 2) -> Generator[T, None, None]:
    """The same items in the same order, made on another thread.

    Parameters
    ----------
    items : run to its end on that thread, or until the generator is closed
    depth : items that are made and not yet taken, at most

    Notes
    -----
    What `items` raises is raised here, in its place. Closed, the generator waits for the item in the making, so no
    thread is left behind.
    """
    queue: Queue[tuple[bool, T | BaseException | None]] = Queue(depth)
    stop = threading.Event()

    def put(last: bool, item: T | BaseException | None) -> bool:
        while not stop.is_set():
            try:
                queue.put((last, item), timeout=POLL)
                return True
            except Full:
                continue
        return False

    def work() -> None:
        try:
            for item in items:
                if not put(False, item):
                    return
            put(True, None)
        except BaseException as error:
            put(True, error)

    thread = threading.Thread(target=work, name="prtcl-ahead", daemon=True)
    thread.start()
    try:
        while True:
            last, item = queue.get()
            if last:
                if isinstance(item, BaseException):
                    raise item
                return
            yield item  # type: ignore[misc]
    finally:
        stop.set()
        while True:  # what waits for nobody is let go
            try:
                queue.get_nowait()
            except Empty:
                break
        thread.join()

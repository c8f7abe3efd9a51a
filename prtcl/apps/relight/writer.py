"""Writes images on a thread of its own, while the next are computed."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from queue import Queue
from types import TracebackType
from typing import Any

from prtcl.apps.relight.folder import Folder
from prtcl.files.image import write_exr, write_png
from prtcl.scene.frames import Frame

WAITING = 4
"""Images that are computed and not yet written, at most."""


class Writer:
    """A queue of images to a folder; use as a context.

    An image is written whole and recorded before the next is begun, in the order in which they come. What goes wrong is
    raised by `put`, or where the context ends.

    Parameters
    ----------
    told : called on the writing thread with each image's entry of the manifest, once it is done

    Attributes
    ----------
    waited : seconds in which `put` had to wait for room
    busy : seconds of writing
    """

    def __init__(
        self, folder: Folder, exposure: float, told: Callable[[int, dict[str, Any]], object]
    ) -> None:
        self.folder, self.exposure, self.told = folder, exposure, told
        self.waited = self.busy = 0.0
        self._queue: Queue[Frame | None] = Queue(WAITING)
        self._failure: BaseException | None = None
        self._dropped = False
        self._thread = threading.Thread(target=self._work, name="prtcl-writer", daemon=True)

    def __enter__(self) -> Writer:
        self._thread.start()
        return self

    def put(self, frame: Frame) -> None:
        """Hand an image over; waits where too many are not yet written."""
        start = time.perf_counter()
        self._queue.put(frame)
        self.waited += time.perf_counter() - start
        self._raise()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # What is computed is written, whatever went wrong since; an interrupt does not wait for it.
        self._dropped = kind is not None and not issubclass(kind, Exception)
        start = time.perf_counter()
        self._queue.put(None)
        self._thread.join()
        self.waited += time.perf_counter() - start
        if kind is None:
            self._raise()

    def _raise(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _work(self) -> None:
        while (frame := self._queue.get()) is not None:
            if self._failure is not None or self._dropped:
                continue  # the queue is emptied, so that nobody waits for room in it
            try:
                start = time.perf_counter()
                self._write(frame)
                self.busy += time.perf_counter() - start
                self.told(frame.job.index, self.folder.manifest["frames"][frame.job.index])
            except BaseException as failure:
                self._failure = failure

    def _write(self, frame: Frame) -> None:
        entry = self.folder.manifest["frames"][frame.job.index]
        about = {key: entry[key] for key in ("environment", "rotation", "material", "view")}

        def exr(path: Path) -> None:
            write_exr(path, frame.image, {"prtcl": json.dumps(about)})

        digests = {entry["file"]: self.folder.write(entry["file"], exr)}
        if "png" in entry:
            digests[entry["png"]] = self.folder.write(
                entry["png"], lambda path: write_png(path, frame.image, self.exposure)
            )
        self.folder.record(frame.job.index, digests)

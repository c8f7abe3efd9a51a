"""A progress bar over points or images, with the time left."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from prtcl.scene.shaders import Notify


@contextmanager
def bar(what: str, quiet: bool, unit: str = " points", scale: bool = True) -> Iterator[Notify | None]:
    """Yield a callback (done, known so far) that moves a bar on standard error; None where `quiet`.

    The total may grow while the job runs: adaptive sampling learns what it needs as it goes.
    """
    if quiet:
        yield None
        return
    from tqdm import tqdm

    lock = threading.Lock()
    with tqdm(
        desc=what, disable=None, unit=unit, unit_scale=scale, total=0, delay=0.5, dynamic_ncols=True
    ) as shown:

        def notify(done: int, known: int) -> None:
            with lock:
                shown.total = known
                shown.update(done - shown.n)

        yield notify

"""Work on many machines: tasks on the workers of a Dask.distributed scheduler, answered as they are done.

`prtcl relight` and `prtcl bake` say what a task is (relight/cluster.py, bake_cluster.py); here is what both need. A
worker is a process with one device: it works on one task at a time, however many threads Dask gave it. Where a worker
dies Dask gives its task, and what that task was made of, to another. Tasks end with the command that sent them:
those that wait are cancelled, and one that runs is told.

What is wrong with a task's input would be wrong at every other try, so errors come back as answers and are not tried
again. A worker must be of the versions that sent the task: bits and images are to be the same wherever they are made.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import metadata
from typing import Any, TypeVar

from prtcl._version import __version__
from prtcl.apps.interrupts import deferred_interrupts
from prtcl.errors import InputError, PrtclError

T = TypeVar("T")

REACHED = 10.0
"""Seconds in which a scheduler has to answer, and to have a worker."""
LOOK = 5.0
"""Seconds after which a command that waits looks whether there is any worker."""
ABSENT = 60.0
"""Seconds without any worker after which a command gives up: time for a nanny to start the dead ones again."""
PATIENCE = 10.0
"""Seconds that a command waits, at its end, for tasks that run to notice it."""

_ONE = threading.Lock()
_run: str | None = None
"""On a worker: whose task it is at, if any."""
_over: set[str] = set()
_kept: tuple[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class Answer:
    """What a task came to; a value that is a `PrtclError` is to be raised."""

    worker: str
    value: Any


# --- on a worker -------------------------------------------------------------------------------------------------


def kept(make: Callable[[], T]) -> T:
    """What this run keeps on this worker from task to task; the first makes it."""
    global _kept
    if _kept is None or _kept[0] != _run:
        _kept = None  # before the next takes its memory
        _kept = str(_run), make()
    value: T = _kept[1]
    return value


def over() -> bool:
    """Whether nobody waits for the task at hand any more."""
    return _run in _over


def versions() -> dict[str, str]:
    """Versions of what bits and images depend on."""
    found = {"prtcl": __version__}
    with suppress(metadata.PackageNotFoundError):
        found["embreex"] = metadata.version("embreex")
    return found


def work(run: str, wanted: dict[str, str], function: Callable[..., Any], *arguments: Any) -> Answer:
    """One task: `function` of its arguments, those of them that are answers opened."""
    global _run
    from distributed import get_worker

    address = get_worker().address
    with _ONE:
        _run = run
        try:
            for argument in arguments:
                if isinstance(argument, Answer) and isinstance(argument.value, PrtclError):
                    return argument
            return Answer(address, _checked(wanted, function, arguments))
        except PrtclError as error:
            kind = InputError if isinstance(error, InputError) else PrtclError
            return Answer(address, kind(f"worker {address}: {error}"))
        except Exception as error:  # such as a driver's, which another try would meet again
            told = (str(error).splitlines() or [""])[0]
            return Answer(address, PrtclError(f"worker {address} failed: {type(error).__name__}: {told}"))
        finally:
            _run = None


def _checked(wanted: dict[str, str], function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
    if over():
        raise PrtclError("its run has ended")
    here = versions()
    if here != wanted:
        name = next(key for key in {**here, **wanted} if here.get(key) != wanted.get(key))
        raise InputError(
            f"has {name} {here.get(name, 'not')}, this command {wanted.get(name, 'not')}; results could differ\n"
            f"install the same {name} there"
        )
    return function(*(own.value if isinstance(own, Answer) else own for own in arguments))


def _same(value: T) -> T:
    """The task of what is shared."""
    return value


async def _end(run: str) -> None:
    """Tell a worker that a run is over, and wait for the task that it is at."""
    global _kept
    _over.add(run)
    last = time.monotonic() + PATIENCE
    while _run == run and time.monotonic() < last:
        await asyncio.sleep(0.02)
    if _run != run and _kept is not None and _kept[0] == run:
        _kept = None


# --- for the command ---------------------------------------------------------------------------------------------


class Workers:
    """The workers of a scheduler, for one run of a command; use `connected`.

    Attributes
    ----------
    address : of the scheduler
    """

    def __init__(self, client: Any, address: str) -> None:
        self.address, self._client, self._run, self._versions = address, client, uuid.uuid4().hex, versions()

    def count(self) -> int:
        """How many there are now."""
        return len(self._client.nthreads())

    def share(self, value: Any) -> Any:
        """A value that workers get once each, from one another; it stands for itself among a task's arguments.

        It is a task as well: were it only on the workers (`Client.scatter`), it would be lost with the last of them.
        """
        import dask

        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
            return self.submit(_same, value, rank=-1)

    def submit(self, function: Callable[..., Any], *arguments: Any, rank: int) -> Any:
        """A task, which `answers` takes, and which stands for its result among another task's arguments.

        Parameters
        ----------
        rank : of several tasks that could run, the one of the lowest rank does
        """
        return self._client.submit(
            work, self._run, self._versions, function, *arguments,
            key=f"prtcl_{function.__name__.strip('_')}-{uuid.uuid4().hex}", pure=False, priority=-rank,
        )  # fmt: skip

    def answers(self, tasks: Iterable[Any]) -> Generator[Answer, None, None]:
        """Answers of tasks as they are done; closed or at its end, nothing of this run is left at work.

        Parameters
        ----------
        tasks : an answer is let go of, here and by its worker, once it was given, where nobody else holds its task

        Raises
        ------
        InputError, PrtclError
            As a task did; or if workers died over one task again and again, all went away, or the scheduler did.
        """
        from distributed import KilledWorker

        left: set[Any] = set()
        try:
            left.update(tasks)
            for answer in self._answers(left):
                if isinstance(answer.value, PrtclError):
                    raise answer.value
                yield answer
        except PrtclError:
            raise
        except KilledWorker as error:
            raise PrtclError(
                f"--scheduler {self.address}: several workers died over one task\n"
                "see their logs, and `dask worker --memory-limit`; the same command makes what is missing"
            ) from error
        except Exception as error:
            if self._client.status != "running" or isinstance(error, CancelledError):
                raise PrtclError(
                    f"--scheduler {self.address}: the scheduler went away\nstart one, and give the same command again"
                ) from error
            raise PrtclError(
                f"--scheduler {self.address}: a worker cannot run this: {type(error).__name__}: "
                f"{(str(error).splitlines() or [''])[0]}\ninstall prtcl {__version__} for the workers"
            ) from error
        finally:
            if self._client.status == "running":
                with suppress(Exception):  # whatever ended the run is told, not that a worker went too
                    self._client.cancel(list(left), force=True)
                    self._client.run(_end, self._run, on_error="ignore")

    def _answers(self, left: set[Any]) -> Iterator[Answer]:
        """Answers of the tasks that are left; Dask waits for workers for ever, this looks whether there are any."""
        from distributed import TimeoutError, as_completed

        met = time.monotonic()
        while left:
            try:
                done = as_completed(left, loop=self._client.loop, with_results=True, timeout=LOOK)
                for future, answer in done:
                    left.discard(future)
                    yield answer
            except TimeoutError:
                now = time.monotonic()
                met = now if self.count() else met
                if now - met > ABSENT:
                    raise PrtclError(
                        f"--scheduler {self.address}: has had no worker for {ABSENT:.0f} s\n"
                        f"start some with `dask worker {self.address} --nthreads 1`, and give the same command again"
                    ) from None


@contextmanager
def connected(address: str | None) -> Iterator[Workers | None]:
    """The workers of the scheduler at an address; None where there is no address.

    Raises
    ------
    InputError
        If Dask.distributed is not installed.
    PrtclError
        If no scheduler answers, or it has no workers.
    """
    if address is None:
        yield None
        return
    try:
        with deferred_interrupts():
            from distributed import Client
    except ImportError as error:
        raise InputError(
            "--scheduler: Dask.distributed is not installed; pip install 'prtcl[cluster]'"
        ) from error
    for name in ("distributed", "distributed.client"):  # errors are told here, in two lines
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=REACHED, set_as_default=False)
    except Exception as error:
        raise PrtclError(
            f"--scheduler {address}: no scheduler answers\nstart one with `dask scheduler`, or leave the option out"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=REACHED)
        except Exception as error:
            raise PrtclError(
                f"--scheduler {address}: has no workers\nstart them with `dask worker {address} --nthreads 1`"
            ) from error
        yield Workers(client, address)

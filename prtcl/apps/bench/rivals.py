"""Other people's programs at the same work, beside the stage that they rival.

A rival is timed by the wall clock, and so is our stage where the two are compared. It is given its own favourite layout
of the same numbers for nothing, and its answer is held against the stage's own oracle.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from prtcl.factors.visibility import threads

LARGEST = 128 << 20
"""Bytes of rows that a rival works on at most: beyond any cache, and its rate is a point's."""


class Missing(Exception):
    """A rival cannot run here; the message says why."""


@dataclass(frozen=True, eq=False)
class RivalJob:
    """A rival made ready.

    Attributes
    ----------
    calls : what it does, in one or several ways by name, of which the fastest counts
    answer : a call's result as the stage would have given it, at least of the first points
    points : of one call
    note : for the row
    """

    calls: dict[str, Callable[[], Any]]
    answer: Callable[[Any], Any]
    points: int
    note: str = ""


PrepareRival = Callable[[str, int, int, int], RivalJob]
"""Of the stage's name, points, levels and channels."""

RIVALS: dict[str, list[tuple[str, PrepareRival]]] = {}
"""By stage: name and what prepares it."""


def rival(name: str, *stages: str) -> Callable[[PrepareRival], PrepareRival]:
    """Enter a function as a rival of some stages."""

    def enter(prepare: PrepareRival) -> PrepareRival:
        for stage in stages:
            RIVALS.setdefault(stage, []).append((name, prepare))
        return prepare

    return enter


def package(module: str, name: str) -> Any:
    """An optional package.

    Raises
    ------
    Missing
        If it is not installed, or does not load.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise Missing(f"{name} is not there ({error}); pip install 'prtcl[bench]'") from error


def bounded(points: int, row: int) -> int:
    """At most so many points of `row` bytes as `LARGEST` holds, 1 at least."""
    return max(1, min(points, LARGEST // row))


def thread_counts() -> tuple[int, ...]:
    """One thread, and all of them."""
    return (1,) if threads() == 1 else (1, threads())


def in_threads(count: int, pieces: list[Any], work: Callable[[Any], Any]) -> list[Any]:
    """`work` over pieces by so many threads."""
    if count == 1:
        return [work(piece) for piece in pieces]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(work, pieces))


def in_torch(torch: Any, function: Callable[..., Any], *arguments: Any) -> dict[str, Callable[[], Any]]:
    """A function of tensors by one thread and by all, compiled where that works on this machine, else as it is.

    Returns
    -------
    calls : by what they are; each sets the number of threads that it was compiled for
    """
    calls: dict[str, Callable[[], Any]] = {}
    for count in thread_counts():
        torch.set_num_threads(count)
        torch.compiler.reset()
        work, how = function, "torch.compile"
        try:
            made = torch.compile(function, dynamic=False)
            made(*arguments)
            work = made
        except Exception as error:  # a missing compiler, an unknown processor: it has many ways to fail
            how = f"eager ({type(error).__name__} while compiling)"

        calls[f"{how}, {threaded(count)}"] = _by_torch(torch, count, work, arguments)
    return calls


def _by_torch(torch: Any, count: int, work: Callable[..., Any], arguments: Any) -> Callable[[], Any]:
    def call() -> Any:
        torch.set_num_threads(count)
        return work(*arguments)

    return call


def in_numba(numba: Any, call: Callable[[], Any]) -> dict[str, Callable[[], Any]]:
    """A call of a parallel function by one thread and by all."""

    def by(count: int) -> Callable[[], Any]:
        def run() -> Any:
            numba.set_num_threads(count)
            return call()

        return run

    return {
        f"fastmath, {threaded(count)}": by(min(count, numba.config.NUMBA_NUM_THREADS))
        for count in thread_counts()
    }


def threaded(count: int) -> str:
    """So many threads, in words."""
    return f"{count} thread{'s' * (count > 1)}"

"""What a case and a trial are to `prtcl stress`, and the list of all cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from prtcl.compute.device import Device

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Size:
    """How far the cases go.

    Attributes
    ----------
    levels : the deepest tree; cases of one depth take the smaller of this and their own
    points : points of identical data
    """

    levels: int = 9
    points: int = 1_000_000


@dataclass(frozen=True, eq=False)
class Trial:
    """One job on the device, what it should give, and how far off it may be.

    Attributes
    ----------
    what : in words; trials of one `what` share a line of the table
    run : does the job; called twice
    expected : float64 answer
    bound : largest |error| that theory allows, in the unit of `expected`; broadcasts against it
    theory : the bound in words
    unit : errors and bounds are stated relative to this; broadcasts likewise
    relative_to : `unit` in words
    at : where in a series of trials this one stands, such as "R = 5"
    rows : whether an error is the 2-norm of a whole row of the last axis; bound and unit then end in an axis of 1
    note : what a user should make of it
    limit : None, or the largest relative error at which `note` explains an error beyond the bound
    before : the same job without what the library does for such data, to show what that is worth
    """

    what: str
    run: Callable[[], Array]
    expected: npt.ArrayLike
    bound: npt.ArrayLike
    theory: str
    unit: npt.ArrayLike = 1.0
    relative_to: str = "1"
    at: str = ""
    rows: bool = False
    note: str = ""
    limit: float | None = None
    before: Callable[[], Array] | None = None


Trials = Callable[[Device, Size], Iterator[Trial]]


@dataclass(frozen=True)
class Case:
    """A family of trials.

    Attributes
    ----------
    name, title : for the command line, for people
    trials : makes them on a device
    precisions : of the device, those in which the case says something
    """

    name: str
    title: str
    trials: Trials
    precisions: tuple[str, ...]


CASES: dict[str, Case] = {}
"""All cases by name, in the order of the table."""

EVERY = ("float32", "mixed", "float64")


def case(name: str, title: str, precisions: tuple[str, ...] = EVERY) -> Callable[[Trials], Trials]:
    """Enter a function into `CASES`."""

    def enter(trials: Trials) -> Trials:
        CASES[name] = Case(name, title, trials, precisions)
        return trials

    return enter

"""The thread that renders for all pages: the most urgent first, only the latest state of each, finer while it rests."""

from __future__ import annotations

import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from prtcl.apps.view.state import State
from prtcl.apps.view.studio import FINE, LADDER, Drawn, Quality, Studio
from prtcl.errors import PrtclError

Deliver = Callable[[State, Quality, Drawn], None]
Saver = Callable[[State, Drawn], None]


WAITING = 3
"""Pictures of one page that may wait to be saved."""


@dataclass(eq=False)
class Seat:
    """A page's place in the loop. Its fields are the loop's.

    Attributes
    ----------
    state : what the page wants to see
    deliver : called on the loop's thread with each picture, and the state it is of
    tell : called on the loop's thread with a text, empty once there is nothing to tell
    rung : of `LADDER`, the next
    """

    state: State
    deliver: Deliver
    tell: Callable[[str], None]
    rung: int = 0
    changed: float = 0.0
    served: float = 0.0
    hurry: bool = False
    stale_tone: bool = False
    shown: tuple[State, Quality, Drawn] | None = None
    saves: deque[tuple[State, Saver]] = field(default_factory=deque)
    told: str = ""


class Loop:
    """Renders for the seats, on one thread that `run` takes; the other methods may come from any thread."""

    def __init__(self, studio: Studio, clock: Callable[[], float] = time.monotonic) -> None:
        self.studio, self._clock = studio, clock
        self._seats: list[Seat] = []
        self._changed = threading.Condition()
        self._stopping = False
        self.notice = ""
        """What all pages are told while there is no fine picture yet."""

    # --- from any thread ------------------------------------------------------------------------------------

    def join(self, state: State, deliver: Deliver, tell: Callable[[str], None]) -> Seat:
        """A new page."""
        seat = Seat(state, deliver, tell, changed=self._clock())
        with self._changed:
            self._seats.append(seat)
            self._changed.notify_all()
        return seat

    def leave(self, seat: Seat) -> None:
        """A page that is gone: nothing is delivered to it any more, but for a call under way."""
        with self._changed:
            if seat in self._seats:
                self._seats.remove(seat)

    def update(self, seat: Seat, change: Callable[[State], State]) -> None:
        """Change what a page wants to see. Only the latest state is rendered."""
        with self._changed:
            before, seat.state = seat.state, change(seat.state)
            if seat.state.drawn != before.drawn:
                # A material under a still camera is quick at full size, if the picture was already fine.
                dressed = replace(before.drawn, looks=seat.state.looks) == seat.state.drawn
                seat.hurry = dressed and (seat.rung >= 2 or (seat.hurry and seat.rung == 1))
                seat.rung, seat.changed = int(seat.hurry), self._clock()
            elif seat.state != before:
                seat.stale_tone = True
            self._changed.notify_all()

    def save(self, seat: Seat, saver: Saver) -> bool:
        """Have the refined picture of a page's state as it is now, once made; False where `WAITING` wait already."""
        with self._changed:
            taken = len(seat.saves) < WAITING
            if taken:
                seat.saves.append((seat.state, saver))
            self._changed.notify_all()
        return taken

    def wake(self) -> None:
        """Look again: something that pictures waited for has come."""
        with self._changed:
            self._changed.notify_all()

    def stop(self) -> None:
        """Let `run` return after the step it is at."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()

    # --- the thread -----------------------------------------------------------------------------------------

    def run(self) -> None:
        """Render until stopped."""
        while True:
            with self._changed:
                if self._stopping:
                    return
                job, wait = self._next()
                latest = max(self._seats, key=lambda seat: seat.changed, default=None)
                state = latest.state if latest is not None else None
            if job is not None:
                self._serve(*job)
            # Before it sleeps, the loop gets ready what cameras do not see yet.
            elif state is None or not self._look_ahead(state):
                with self._changed:
                    job, wait = self._next()
                    if not self._stopping and job is None:
                        self._changed.wait(wait)

    def _next(self) -> tuple[tuple[Seat, State, Quality, bool] | None, float | None]:
        """The most urgent job that is due: (seat, state, quality, whether to save); else how long to wait for one."""
        now, due, wait = self._clock(), [], None
        for seat in self._seats:
            if seat.stale_tone and seat.shown is not None and seat.shown[0].drawn == seat.state.drawn:
                due.append((0, seat.served, seat, seat.state, seat.shown[1], False))
            if seat.saves and self.studio.can(FINE):
                due.append((2, seat.served, seat, seat.saves[0][0], FINE, True))
            if seat.rung < len(LADDER) and self.studio.can(LADDER[seat.rung]):
                quality = LADDER[seat.rung]
                rest = 0.0 if seat.hurry and seat.rung == 1 else quality.rest
                left = seat.changed + rest - now
                if left <= 0.0:
                    # What has waited for seconds counts as if it moved: no page starves another.
                    priority = max(1, (1 if rest == 0.0 else seat.rung + 1) + int(left))
                    due.append((priority, seat.served, seat, seat.state, quality, False))
                else:
                    wait = left if wait is None else min(wait, left)
        if not due:
            return None, wait
        first = min(due, key=lambda job: job[:2])
        return first[2:], None

    def _serve(self, seat: Seat, state: State, quality: Quality, saving: bool) -> None:
        """One step of a job, and what follows from it."""
        drawn: Drawn | None = None
        failure = ""
        shown = seat.shown
        if shown is not None and shown[0].drawn == state.drawn and shown[1] is quality:
            drawn = shown[2]
        else:
            try:
                drawn = self.studio.step(state, quality)
            except PrtclError as error:
                failure = str(error)
            except Exception as error:
                # A page shows it, and the server lives on for the others.
                traceback.print_exc(file=sys.stderr)
                failure = f"{type(error).__name__}: {error}"
        saver = None
        with self._changed:
            seat.served = self._clock()
            if seat not in self._seats:
                return
            current = seat.state.drawn == state.drawn
            if drawn is not None or failure:
                if saving:
                    saver = seat.saves.popleft()[1]
                elif current and LADDER[seat.rung :][:1] == (quality,):
                    seat.rung += 1
            if failure and current:
                seat.rung = len(LADDER)  # not again until something changes
            if drawn is not None and not saving:
                seat.shown, seat.stale_tone = (state, quality, drawn), False
                state = replace(state, exposure=seat.state.exposure)
        if failure:
            self._tell(seat, failure)
        elif drawn is None:
            self._tell(seat, f"Collecting light: {100 * self.studio.left(state):.0f} % of the vertices to go")
        elif saver is not None:
            saver(state, drawn)
        elif current or quality is not FINE:
            # What has been overtaken still shows that something moves; a refined one would come late and jump back.
            seat.deliver(state, quality, drawn)
            self._tell(seat, "" if self.studio.can(FINE) else self.notice)

    def _look_ahead(self, state: State) -> bool:
        try:
            return self.studio.can(FINE) and self.studio.look_ahead(state)
        except Exception:
            traceback.print_exc(file=sys.stderr)
            return False  # a picture that needs it will say so on its page

    def announce(self, notice: str) -> None:
        """Tell all pages that there is no fine picture yet, and why; from any thread."""
        self.notice = notice
        with self._changed:
            seats = list(self._seats)
        for seat in seats:
            self._tell(seat, notice)

    def _tell(self, seat: Seat, text: str) -> None:
        if seat.told != text:
            seat.told = text
            seat.tell(text)

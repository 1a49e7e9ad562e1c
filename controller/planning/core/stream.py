"""Follows set-points by single stages.

A stream is a sequence of set-points of one sender without a pause longer than the tracker's time-out. A cancel, stop,
fault, reset or goal ends the present stream. Only a stream that begins later is followed.
"""

from __future__ import annotations

import logging
import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hyperbit.controller.host.process import Log
from hyperbit.controller.messages.state import SetpointStatus
from hyperbit.controller.motion.decoding.setpoint import decode
from hyperbit.controller.motion.tracking.tracking import GoalTracker, Tracking
from hyperbit.controller.planning.core.arm import ArmState, obstruction
from hyperbit.controller.planning.core.events import SetpointArrived, ToExecutor
from hyperbit.controller.planning.core.parts import Parts, Ticket
from hyperbit.controller.planning.core.premises import Premises
from hyperbit.controller.planning.core.programs import Programs
from hyperbit.controller.planning.core.tasks import Answer, Basis, Failed, Followed, FollowSetpoint
from hyperbit.controller.program import TICK, Setpoint
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

if TYPE_CHECKING:
    from hyperbit.controller.arm.arm import Arm

POLL = 0.005  # [s] between two considerations, at least
ALIVE_EVERY = 0.02  # [s] between unchanged commands, which keep the stream alive
NOTE_EVERY = 1.0  # [s] between changes of the note in `state`
RETRY = 0.1  # [s] after a search without result, which takes longest
SEARCH_TIME = 0.005  # [s] expected for the first search
SMOOTHING = 0.1  # weight of the latest value in running means
LONGEST = 1_000  # characters of a reason
MOST_SENDERS = 16  # of set-points with separately detected pauses
MOST_DELAY = 0.2  # [s] of a set-point between its arrival and the core


class Stream:
    """Follows one stream of set-points at a time.

    Times are monotonic. The tracker compares times with senders' stamps and gets UNIX seconds: monotonic time plus an
    offset that is fixed while a track is alive, so that a change of the wall clock has no effect.
    """

    def __init__(self, arm: Arm, tracking: Tracking, parts: Parts, premises: Premises, programs: Programs) -> None:
        self._view, self._moment, self._jobs, self._act = parts.view, parts.moment, parts.jobs, parts.act
        self._parts, self._premises, self._programs = parts, premises, programs
        self._admission, self._dimension = parts.admission, arm.manipulator.dimension
        self._default_tolerance = self._tolerance = arm.tolerance
        self._tracker, self._timeout = GoalTracker(self._dimension, tracking), tracking.timeout
        self._lead = arm.travel_time + TICK  # longest time of a stage [s]
        self._ticket: Ticket | None = None  # of the first set-point; None: no stream is followed
        self._sender = ""  # of the present stream
        self._senders: dict[str, tuple[Ticket, float]] = {}  # first ticket and last time [s] of each, until it pauses
        self._number, self._offset, self._searching = 0, 0.0, SEARCH_TIME
        self._heard = self._fitted = self._next_look = self._next_alive = self._next_note = self._retry = -math.inf
        self._next_search = -math.inf  # state at the last consideration
        self._job: int | None = None  # number of the search under way
        self._answer: tuple[Basis, Followed] | None = None  # not considered yet
        self._found: tuple[Basis, tuple[bytes, ...]] | None = None  # stages of the last search
        self._interval, self._streams, self._received, self._refused = math.inf, 0, 0, 0
        self._last_refusal: str | None = None
        self._note = ""

    # --- set-points

    def receive_setpoint(self, arrived: SetpointArrived) -> None:
        """Handles a set-point; a refused one is only counted."""
        self._received += 1
        try:
            self._take(arrived)
        except Refusal as refusal:
            self._refused += 1
            self._last_refusal = str(refusal)

    def _take(self, arrived: SetpointArrived) -> None:
        """Assigns a set-point to the present stream, or begins a new one; refuses one of another sender.

        The tracker refuses a set-point that is stale, from the future or out of order.
        """
        now, (payload, arrival, sender) = self._moment.now, arrived
        setpoint = decode(payload, self._dimension, self._default_tolerance)
        if (age := now - arrival.at) > MOST_DELAY:
            raise Refusal(Reason.STALE, age=f"{age:.3f}", most=MOST_DELAY)
        # The ticket is of the first set-point since the sender's last pause. A sender that was refused may follow the
        # present stream without a pause. Then a stop in between bars it, too.
        alive = {name: entry for name, entry in self._senders.items() if self._alive(entry[1])}
        known = alive.pop(sender, None)
        ticket = self._admission.arrive(arrival.number) if known is None else known[0]
        self._senders = dict([*alive.items(), (sender, (ticket, now))][-MOST_SENDERS:])
        if not self._alive(self._heard):
            self._abandon()
            self._streams += 1
            self._ticket, self._sender = ticket, sender
            self._number, self._interval, self._note = 0, math.inf, ""
            self._next_look = self._next_alive = self._next_note = self._retry = -math.inf
        elif sender != self._sender:
            owner, other = (f'"{name}"' if name else "a client without a name" for name in (self._sender, sender))
            raise Refusal(Reason.STREAM_OF_ANOTHER, owner=owner, sender=other, pause=self._timeout)
        else:
            last = now - self._heard
            self._interval = last if math.isinf(self._interval) else running_mean(self._interval, last)
        self._heard = now
        if self._ticket is None or self._admission.stream_ended(self._ticket):
            return
        if not self._alive(self._fitted):
            self._tracker.forget()
            self._offset = self._moment.wall - now
        if self._tracker.measure(setpoint.position, setpoint.stamp, now + self._offset):
            self._fitted, self._tolerance = now, setpoint.tolerance

    # --- commands

    def consider(self) -> None:
        """Commands the arm to the predicted goal; also without a new set-point, because the goal moves."""
        now = self._moment.now
        if now < self._next_look:
            return
        self._next_look = now + POLL
        if not self._alive(self._fitted):
            self._abandon()
            return
        if self._programs.offered is not None:
            return
        ticket, mode = self._ticket, self._premises.locks.mode()[0]
        if ticket is None or mode not in ("ready", "executing") or self._admission.stream_ended(ticket):
            self._abandon()
            self._ticket, self._fitted = None, -math.inf
            self._tracker.forget()
            return
        state = self._view.state
        if state is None or ticket.epoch is None:
            return
        if self._number <= self._programs.last_accepted:  # a stream that continues after a goal counts as a new one
            self._number = self._parts.next_number()
        if self._decide(state) or now >= self._next_alive:
            self._send(state, ticket.epoch)

    @property
    def due(self) -> float:
        if not self._alive(self._fitted):
            return math.inf
        next_search = math.inf if self._job is not None else self._next_search
        return max(self._next_look, min(self._next_alive, next_search))

    def park(self) -> None:
        self._abandon()
        state, ticket = self._view.state, self._ticket
        if state is None or ticket is None or ticket.epoch is None or self._admission.stream_ended(ticket):
            return
        if self._alive(self._fitted) and self._number > self._programs.last_accepted:
            self._send(state, ticket.epoch)

    def _send(self, state: ArmState, epoch: int) -> None:
        """Sends the stages of the last search, or none if they no longer hold.

        Stages are repeated during a search: a command without stages would withdraw those that have not begun.
        """
        self._next_alive = self._moment.now + ALIVE_EVERY
        found, scene, outputs = self._found, self._premises.obstacles.scene, state.snapshot.outputs
        stages = found[1] if found is not None and found[0] == self._premises.basis() else ()
        until, reason = self._fitted + self._timeout, f"following a setpoint{self._note}"[:LONGEST]
        strict = scene is None or not scene.free
        self._act(ToExecutor(Setpoint(self._number, epoch, outputs, stages, until, strict, reason)))

    # --- searches

    def _decide(self, state: ArmState) -> bool:
        """Takes the answer of a search, or starts the next search; returns whether there are new stages."""
        answered, self._answer = self._answer, None
        if answered is None or answered[0] != self._premises.basis():
            if self._job is None:
                self._search(state)
            return False
        basis, answer = answered
        blocked = not answer.found or (bool(answer.note) and not answer.stages)
        self._retry = self._next_search = self._moment.now + (RETRY if blocked else POLL)
        self._stay(answer.note)
        if answer.stages:
            self._found = basis, answer.stages
        return self._found is not None

    def _search(self, state: ArmState) -> None:
        """Starts a search from a state to the predicted goal, unless the arm stays or it is too early to decide."""
        premises, now, free_at = self._premises, self._moment.now, state.snapshot.free_at
        self._next_search = max(free_at - self._searching - TICK, self._retry)
        if now < self._next_search or (basis := premises.basis()) is None:
            return
        if (configuration := state.configuration) is None:
            self._stay(f", which is not possible now: {obstruction(state, *premises.locks.mode())}")
            return
        bias = premises.correction()
        shift = np.zeros(self._dimension) if bias is None else np.array(bias)
        tip = self._view.manipulator.tips(configuration[None])[0, : self._dimension, 3] + shift
        lead = max(free_at - now, self._searching) + self._lead
        goal = self._tracker.next_target(now + self._offset, lead, tip, self._tolerance)
        if goal is None:
            self._stay("")
            return
        task = FollowSetpoint(basis, tuple((goal - shift).tolist()), self._tolerance, bias)
        self._job = self._jobs.start(task, partial(self._receive_answer, basis))

    def _receive_answer(self, basis: Basis, answer: Answer) -> None:
        self._job, self._next_look = None, self._moment.now
        if isinstance(answer, Followed):
            self._searching = running_mean(self._searching, answer.seconds)
            self._answer = basis, answer
        elif isinstance(answer, Failed) and basis == self._premises.basis():
            self._act(Log(logging.ERROR, f"following failed, the arm holds: {answer.reason}"))
            self._ticket = None

    def _stay(self, note: str) -> None:
        """Drops the found stages; `state` shows the note, which changes at most once in NOTE_EVERY."""
        self._found = None
        if note != self._note and self._moment.now >= self._next_note:
            self._note, self._next_note = note, self._moment.now + NOTE_EVERY

    def _abandon(self) -> None:
        self._jobs.abandon(self._job)
        self._job = self._answer = self._found = None

    def _alive(self, last: float) -> bool:
        return self._moment.now - last <= self._timeout

    def status(self) -> SetpointStatus:
        return SetpointStatus(
            streams=self._streams,
            received=self._received,
            refused=self._refused,
            last_refusal=self._last_refusal,
            outliers=self._tracker.track.outliers,
            jumps=self._tracker.track.jumps,
            sender=self._sender if self._alive(self._heard) else None,
            rate=1 / max(self._interval, 1e-3) if self._alive(self._heard) else 0.0,
            alive=self._alive(self._fitted),
        )


def running_mean(mean: float, latest: float) -> float:
    return mean + SMOOTHING * (latest - mean)

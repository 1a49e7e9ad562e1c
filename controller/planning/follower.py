"""Follows a moving goal: tracks set-points and sends single stages to the executor.

A stream is a sequence of set-points without a pause longer than the tracker's time-out. A cancel, stop, fault, reset or
goal ends the present stream. Only a stream that begins later is followed.
"""

import logging
import math
import threading
import time
from collections.abc import Callable

import numpy as np

from controller.config import Arm
from controller.motion.codes import Refusal
from controller.motion.goal_motion import tracking_of
from controller.motion.pacing import PERIOD, Blocked, pace_of
from controller.motion.setpoint import Setpoint, decode
from controller.motion.tracking import GoalTracker
from controller.planning.admission import Admission, Ticket
from controller.planning.arm_state import ArmState, States
from controller.planning.connection import NotConnected
from controller.planning.goal_planning import Bias
from controller.planning.goals import RunningGoals
from controller.planning.keep_out import CollisionAwareSolver
from controller.planning.messages import Payload
from controller.planning.monitor import ArmMonitor
from controller.planning.sending import ProgramNumbers
from controller.planning.workers.setpoints import SEARCH_TIME, SetpointQuery, find, stages_to
from controller.program import Down
from controller.program import Setpoint as SetpointCommand

log = logging.getLogger(__name__)

POLL, IDLE_POLL = 0.005, 0.02  # [s] between two polls for a set-point
ALIVE_EVERY = 0.02  # [s] between commands without stages, which keep the stream alive
NOTE_EVERY = 1.0  # [s] between changes of the note in `state`
RETRY = 0.1  # [s] after a search that found nothing within tolerance, which takes longest
SMOOTHING = 0.1  # weight of the latest value in running means
LONGEST = 1_000  # characters of a reason


class Follower:
    """Follows one stream of set-points at a time. All methods but `status` belong to one thread.

    Times are monotonic. The tracker compares times with senders' stamps and gets UNIX seconds: monotonic time plus an
    offset that is fixed while a track is alive, so that a change of the wall clock has no effect.

    Args:
        arm: the arm that follows.
        solver: not shared.
        monitor: of the arm.
        admission: gives set-points, and decides which streams have ended.
        goals: the running goals.
        numbers: of streams.
        send: sends to the executor; raises NotConnected.
        bias: returns the tip bias, shape (dimension,); None: no tracker.
        wall: UNIX time [s].
    """

    def __init__(
        self,
        arm: Arm,
        solver: CollisionAwareSolver,
        monitor: ArmMonitor,
        admission: Admission,
        goals: RunningGoals,
        numbers: ProgramNumbers,
        send: Callable[[Down], None],
        bias: Bias,
        wall: Callable[[], float] = time.time,
    ) -> None:
        """Builds the tracker, which takes almost a second."""
        self._arm, self._solver, self._monitor, self._admission = arm, solver, monitor, admission
        self._goals, self._numbers, self._send, self._bias = goals, numbers, send, bias
        self._clock, self._wall = monitor.clock, wall
        self._dimension, self._tolerance = arm.manipulator.dimension, arm.tolerance
        tracking = tracking_of(arm.manipulator.length, arm.tolerance)
        self._tracker, self._timeout = GoalTracker(self._dimension, tracking), tracking.timeout
        self._pace = pace_of(arm.settings)
        self._stream: Ticket | None = None  # of the first set-point; None: no stream is followed
        self._number, self._offset, self._searching = 0, 0.0, SEARCH_TIME / 2
        self._heard = self._fitted = self._next_alive = self._next_note = self._retry = -math.inf
        self._interval, self._streams, self._received, self._refused = math.inf, 0, 0, 0
        self._last_refusal: str | None = None
        self._note = ""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="follower", daemon=True)

    # --- the thread

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Ends the thread."""
        self._closing.set()
        self._thread.join(timeout)

    def _run(self) -> None:
        while not self._closing.wait(POLL if self._alive(self._heard) else IDLE_POLL):
            self.step()

    def step(self) -> None:
        """Takes a set-point if one has come, and commands the arm."""
        try:
            if (arrived := self._admission.setpoint()) is not None:
                self.take(*arrived)
            self.consider()
        except Exception:
            if self._stream is not None:
                log.exception("following failed, the arm holds")
            self._stream = None

    # --- the stream

    def take(self, payload: bytes, ticket: Ticket) -> None:
        """Takes a set-point that has arrived; a refused one is only counted."""
        self._received += 1
        try:
            setpoint = decode(payload, self._dimension, self._arm.tolerance)
            now = self._clock()
            self._assign(now, ticket)
            if self._stream is not None and not self._admission.stream_ended(self._stream):
                self._measure(setpoint, now)
        except Refusal as refusal:
            self._refused += 1
            self._last_refusal = str(refusal)

    def _assign(self, now: float, ticket: Ticket) -> None:
        """Assigns a set-point to the present stream, or begins a new one."""
        if self._alive(self._heard):
            last = now - self._heard
            self._interval = last if math.isinf(self._interval) else running_mean(self._interval, last)
        else:
            self._streams += 1
            self._stream, self._number, self._interval, self._note = ticket, 0, math.inf, ""
            self._next_alive = self._next_note = self._retry = -math.inf
        self._heard = now

    def _measure(self, setpoint: Setpoint, now: float) -> None:
        """Passes a set-point to the tracker.

        Raises:
            Refusal: the set-point is stale, from the future or out of order.
        """
        if not self._alive(self._fitted):
            self._tracker.forget()
            self._offset = self._wall() - now
        if self._tracker.measure(setpoint.position, setpoint.stamp, now + self._offset):
            self._fitted, self._tolerance = now, setpoint.tolerance

    def consider(self) -> None:
        """Commands the arm to the predicted goal; also without a new set-point, because the goal moves."""
        state, now = self._monitor.state, self._clock()
        if not self._alive(self._fitted):
            return
        if self._goals.offered:
            return
        if self._number <= self._goals.last_accepted:  # a stream that continues after a goal counts as a new one
            self._number = self._numbers.next()
        # A goal accepted from now on has a greater number, and the executor then ignores this stream.
        stream, mode = self._stream, self._monitor.mode()[0]
        if stream is None or mode not in ("ready", "executing") or self._admission.stream_ended(stream):
            self._stream, self._fitted = None, -math.inf
            self._tracker.forget()
            return
        epoch = self._admission.epoch(stream, 0.0)
        if state is None or epoch is None:
            return
        stages = self._stages_now(state, now)
        if stages is None and now < self._next_alive:
            return
        self._next_alive = now + ALIVE_EVERY
        packed = () if stages is None else tuple(state.pack(stages))
        until, reason = self._fitted + self._timeout, f"following a setpoint{self._note}"[:LONGEST]
        strict = not self._solver.now()[1].free
        try:
            self._send(SetpointCommand(self._number, epoch, state.snapshot.outputs, packed, until, strict, reason))
        except NotConnected:
            self._stream = None

    def _stages_now(self, state: ArmState, now: float) -> States | None:
        """Returns the stages (k, A) from a state to the goal; None: stay, or it is too early to decide."""
        free_at = state.snapshot.free_at
        if now < max(free_at - self._searching - PERIOD, self._retry):
            return None
        solver, keep_out = self._solver.now()
        try:
            start = self._monitor.start(state, solver.manipulator)
        except Refusal as refusal:
            self._set_note(f", which is not possible now: {refusal}", now)
            return None
        bias, tolerance = self._bias(), self._tolerance
        shift = np.zeros(self._dimension) if bias is None else bias
        tip = solver.manipulator.tip(start)[: self._dimension, 3] + shift
        lead = max(free_at - now, self._searching) + self._pace.lead
        goal = self._tracker.next_target(now + self._offset, lead, tip, tolerance)
        if goal is None:
            self._set_note("", now)
            return None
        began = time.perf_counter()
        # Half the tolerance: see GoalTracker.next_target.
        query = SetpointQuery(solver, keep_out, state.commanded, start, goal - shift, tolerance / 2)
        found = find(query, self._arm.settings.method)
        self._searching = running_mean(self._searching, time.perf_counter() - began)
        if found.error > tolerance:
            where = ", ".join(f"{x:.4f}" for x in goal)
            self._set_note(f", which {found.reach} at ({where}): {found.error:.4f} away, tolerance {tolerance:g}", now)
            self._retry = now + RETRY
            return None
        stages, note = None, ""
        if found.switches:
            try:
                stages = stages_to(query, found.configuration, self._arm, self._pace)
            except Blocked as blocked:
                self._retry, note = now + RETRY, f", but the transition to it is blocked: {blocked}"
        self._set_note(note, now)
        return stages

    def _set_note(self, note: str, now: float) -> None:
        """Sets the note that `state` shows on the stream, at most once in NOTE_EVERY."""
        if note != self._note and now >= self._next_note:
            self._note, self._next_note = note, now + NOTE_EVERY

    def _alive(self, last: float) -> bool:
        """Returns whether the given time of the last set-point is within the time-out."""
        return self._clock() - last <= self._timeout

    def status(self) -> Payload:
        """Returns the state of the stream for `diagnostics`. For any thread."""
        return {
            "streams": self._streams,
            "received": self._received,
            "refused": self._refused,
            "last_refusal": self._last_refusal,
            "outliers": self._tracker.outliers,
            "jumps": self._tracker.jumps,
            "rate": 1 / max(self._interval, 1e-3) if self._alive(self._heard) else 0.0,
            "alive": self._alive(self._fitted),
        }


def running_mean(mean: float, latest: float) -> float:
    """Returns the running mean updated with the latest value."""
    return mean + SMOOTHING * (latest - mean)

"""Following a moving goal: set-points, tracked, and made into single stages for the executor.

A stream is all set-points without a pause of the tracker's time-out. A cancel, stop, fault, reset or goal ends the
stream that runs: only a stream that begins later is followed.
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
from controller.planning.setpoint_search import SEARCH_TIME, Query, SetpointSearch
from controller.program import Down
from controller.program import Setpoint as SetpointCommand

log = logging.getLogger(__name__)

POLL, IDLE_POLL = 0.005, 0.02  # [s] between two looks for a set-point
WORD_EVERY = 0.02  # [s] between two commands that only say: the stream is alive
SENTENCE_EVERY = 1.0  # [s]; the sentence on a goal out of reach changes no more often
RETRY = 0.1  # [s] after a search that found nothing within reach, which takes longest
SMOOTHING = 0.1  # share of the latest in running means
LONGEST = 1_000  # characters of a sentence


class Follower:
    """Follows one stream of set-points at a time; all but `status` belongs to one thread.

    Times are monotonic. The tracker, which compares with senders' stamps, gets UNIX seconds: the same clock moved by an
    offset that stays while a track is alive, so that a change of the wall clock moves nothing.

    Args:
        arm: whose goals move.
        solver: used by nobody else.
        monitor: of the arm.
        admission: gives set-points, and knows which streams have ended.
        goals: that run.
        numbers: of streams.
        send: sends to the executor, raises NotConnected.
        bias: returns what the tip is beside the computed one, shape (dimension,); None: no tracker.
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
        """Builds the tracker, which takes most of a second."""
        self._arm, self._solver, self._monitor, self._admission = arm, solver, monitor, admission
        self._goals, self._numbers, self._send, self._bias = goals, numbers, send, bias
        self._clock, self._wall = monitor.clock, wall
        self._dimension, self._tolerance = arm.manipulator.dimension, arm.tolerance
        tracking = tracking_of(arm.manipulator.length, arm.tolerance)
        self._tracker, self._timeout = GoalTracker(self._dimension, tracking), tracking.timeout
        self._pace = pace_of(arm.settings)
        self._search = SetpointSearch(arm, self._pace)
        self._stream: Ticket | None = None  # of its first set-point; None: there is none, or it is followed no more
        self._number, self._offset, self._searching = 0, 0.0, SEARCH_TIME / 2
        self._heard = self._fitted = self._next_word = self._next_sentence = self._retry = -math.inf
        self._interval, self._received, self._refused = math.inf, 0, 0
        self._last_refusal: str | None = None
        self._note = ""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="follower", daemon=True)

    # --- the thread

    def start(self) -> None:
        """Starts the thread that takes the set-points."""
        self._thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Ends the thread."""
        self._closing.set()
        self._thread.join(timeout)

    def _run(self) -> None:
        while not self._closing.wait(POLL if self._alive(self._heard) else IDLE_POLL):
            self.step()

    def step(self) -> None:
        """Takes a set-point if one has come, and commands what the goal asks for now."""
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
        """Takes a set-point that has arrived; one that is refused is only counted."""
        self._received += 1
        try:
            setpoint = decode(payload, self._dimension, self._arm.tolerance)
            now = self._clock()
            self._belongs(now, ticket)
            if self._stream is not None and not self._admission.stream_ended(self._stream):
                self._measure(setpoint, now)
        except Refusal as refusal:
            self._refused += 1
            self._last_refusal = str(refusal)

    def _belongs(self, now: float, ticket: Ticket) -> None:
        """Counts a set-point to the stream that runs, or begins one with it."""
        if self._alive(self._heard):
            last = now - self._heard
            self._interval = last if math.isinf(self._interval) else mixed(self._interval, last)
        else:
            self._stream, self._number, self._interval, self._note = ticket, 0, math.inf, ""
            self._next_word = self._next_sentence = self._retry = -math.inf
        self._heard = now

    def _measure(self, setpoint: Setpoint, now: float) -> None:
        """Gives a set-point to the tracker.

        Raises:
            Refusal: it is stale, from the future or out of order.
        """
        if not self._alive(self._fitted):
            self._tracker.forget()
            self._offset = self._wall() - now
        if self._tracker.measure(setpoint.position, setpoint.stamp, now + self._offset):
            self._fitted, self._tolerance = now, setpoint.tolerance

    def consider(self) -> None:
        """Commands what the goal asks for now, which changes without a new set-point, too, for it moves."""
        state, now = self._monitor.state, self._clock()
        if not self._alive(self._fitted):
            return
        if self._goals.offered:
            return
        if self._number <= self._goals.taken:  # a stream that goes on after a goal counts as a new one
            self._number = self._numbers.next()
        # A goal that is taken from here on has a greater number, and the executor follows this stream no more.
        stream, mode = self._stream, self._monitor.mode()[0]
        if stream is None or mode not in ("ready", "executing") or self._admission.stream_ended(stream):
            self._stream, self._fitted = None, -math.inf
            self._tracker.forget()
            return
        epoch = self._admission.epoch(stream, 0.0)
        if state is None or epoch is None:
            return
        stages = self._wanted(state, now)
        if stages is None and now < self._next_word:
            return
        self._next_word = now + WORD_EVERY
        packed = () if stages is None else tuple(state.pack(stages))
        until, reason = self._fitted + self._timeout, f"following a setpoint{self._note}"[:LONGEST]
        strict = not self._solver.now()[1].free
        try:
            self._send(SetpointCommand(self._number, epoch, state.snapshot.outputs, packed, until, strict, reason))
        except NotConnected:
            self._stream = None

    def _wanted(self, state: ArmState, now: float) -> States | None:
        """Returns the stages (k, A) to switch to from a state; None: stay, or it is too early to tell."""
        free_at = state.snapshot.free_at
        if now < max(free_at - self._searching - PERIOD, self._retry):
            return None
        solver, keep_out = self._solver.now()
        try:
            start = self._monitor.start(state, solver.manipulator)
        except Refusal as refusal:
            self._say(f", which is not possible now: {refusal}", now)
            return None
        bias, tolerance = self._bias(), self._tolerance
        shift = np.zeros(self._dimension) if bias is None else bias
        tip = solver.manipulator.tip(start)[: self._dimension, 3] + shift
        lead = max(free_at - now, self._searching) + self._pace.lead
        goal = self._tracker.wants(now + self._offset, lead, tip, tolerance)
        if goal is None:
            self._say("", now)
            return None
        began = time.perf_counter()
        query = Query(
            solver, keep_out, state.commanded, start, goal - shift, tolerance / 2
        )  # half: see GoalTracker.wants
        found = self._search.find(query)
        self._searching = mixed(self._searching, time.perf_counter() - began)
        if found.error > tolerance:
            where = ", ".join(f"{x:.4f}" for x in goal)
            self._say(f", which is out of reach at ({where}): {found.error:.4f} away, tolerance {tolerance:g}", now)
            self._retry = now + RETRY
            return None
        stages, note = None, ""
        if found.switches:
            try:
                stages = self._search.stages(query, found.configuration)
            except Blocked as blocked:
                self._retry, note = now + RETRY, f", the way to which is barred: {blocked}"
        self._say(note, now)
        return stages

    def _say(self, note: str, now: float) -> None:
        """Takes a note on the stream, unless the last is too young."""
        if note != self._note and now >= self._next_sentence:
            self._note, self._next_sentence = note, now + SENTENCE_EVERY

    def _alive(self, last: float) -> bool:
        """Returns whether the last set-point came within the time-out."""
        return self._clock() - last <= self._timeout

    def status(self) -> Payload:
        """Returns how the stream fares; from any thread."""
        return {
            "received": self._received,
            "refused": self._refused,
            "last_refusal": self._last_refusal,
            "outliers": self._tracker.outliers,
            "jumps": self._tracker.jumps,
            "rate": 1 / max(self._interval, 1e-3) if self._alive(self._heard) else 0.0,
            "alive": self._alive(self._fitted),
        }


def mixed(mean: float, latest: float) -> float:
    """Returns a running mean with the latest value in it."""
    return mean + SMOOTHING * (latest - mean)

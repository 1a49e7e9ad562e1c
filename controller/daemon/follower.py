"""Following a moving goal: setpoints from Zenoh, tracked, and made into configurations for the control loop.

A stream is all setpoints without a pause of the tracker's time-out. Whatever ends following (a cancel, a stop, a
fault, a reset, a goal) ends it for the stream that runs: only one that begins later is followed.
"""

import logging
import math
import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from controller.config import Arm
from controller.daemon.arrivals import Arrivals
from controller.daemon.avoidance import Avoidance, Guarded, Kept, keeping
from controller.daemon.events import Follow, Payload
from controller.daemon.loop import PERIOD, ControlLoop
from controller.daemon.tip import Bias
from controller.manipulator.held import carried
from controller.manipulator.manipulator import Configuration
from controller.motion.codes import Refusal
from controller.motion.pacing import Blocked, Pace
from controller.motion.plan import sweep_for
from controller.motion.setpoint import Setpoint, decode
from controller.motion.tracking import GoalTracker, Tracking
from controller.search.solution import Solution
from controller.search.solver import Solver

log = logging.getLogger(__name__)

SEARCH_TIME = 0.01  # [s] for one search; it is never worse than IPOP
POLL, IDLE_POLL = 0.005, 0.02  # [s] between two looks for a setpoint
WORD_EVERY = 0.02  # [s] between two words to the loop that only say: the stream is alive
SENTENCE_EVERY = 1.0  # [s]; what is said of a goal out of reach changes no more often
RETRY = 0.1  # [s] after a search that found nothing within reach, which takes longest
FAR = 10.0  # tolerances; among 2000 positions that the arm reaches, IPOP misses none by more than 2
MOST_WAITING = 16  # events of a loop that is behind: it needs no more of them
ASIDE, OTHERS = 0.05, 16  # [s] for other configurations where the way to the cheapest is barred, and how many
SMOOTHING = 0.1  # share of the latest in running means

Vector = NDArray[np.float64]
# A configuration (B,), and the actuator states that each stage on the way there ends in, (k, A), where that matters.
Way = tuple[Configuration, NDArray[np.uint8] | None]


class Follower:
    """Follows one stream of setpoints at a time; all but `status` belongs to one thread.

    Times are the control loop's. The tracker, which compares with senders' stamps, gets UNIX seconds: the same clock
    moved by an offset that stays while a track is alive, so that a change of the wall clock moves nothing.

    Args:
        arm: whose goals move.
        solver: used by nobody else.
        loop: to move the arm.
        clock: of the loop [s].
        wall: UNIX time [s].
        bias: returns what the tip is beside the computed one, shape (dimension,), None where it is not measured.
        avoidance: what is to be kept clear of; the regions of the arm's file if absent.
    """

    def __init__(
        self,
        arm: Arm,
        solver: Solver,
        loop: ControlLoop,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
        bias: Callable[[], Bias | None] = lambda: None,
        avoidance: Avoidance | None = None,
    ) -> None:
        """Builds the tracker, which takes most of a second."""
        self._bias = bias
        tracking = Tracking()
        self._arm, self._loop, self._clock, self._wall = arm, loop, clock, wall
        self._guarded = Guarded(arm, solver, avoidance or Avoidance(keeping(arm)))
        self._dimension, self._tolerance = arm.manipulator.dimension, arm.tolerance
        self._tracker, self._timeout = GoalTracker(self._dimension, tracking), tracking.timeout
        self._settling = arm.settings.travel_time + PERIOD
        self._pace = Pace(self._settling, arm.settings.inrush, arm.settings.rest_time)
        self._stream, self._offset, self._searching = 0, 0.0, SEARCH_TIME / 2
        self._heard = self._fitted = self._next_word = self._next_sentence = self._retry = -math.inf
        self._interval, self._received, self._refused = math.inf, 0, 0
        self._last_refusal: str | None = None
        self._note, self._given_up = "", -1
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def use(self, solver: Solver) -> None:
        """Searches with another solver from now on: of the arm as it is left by the actuators held."""
        self._guarded.use(solver)

    # --- the thread

    def listen(self, arrivals: Arrivals) -> None:
        """Starts the thread that takes the setpoints."""
        self._thread = threading.Thread(target=self._run, args=(arrivals,), name="follower", daemon=True)
        self._thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Ends the thread."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout)

    def _run(self, arrivals: Arrivals) -> None:
        while not self._closing.wait(POLL if self._alive(self._heard) else IDLE_POLL):
            try:
                if (arrived := arrivals.setpoint()) is not None:
                    sample, arrival = arrived
                    if str(sample.key_expr).endswith("/setpoint"):  # wildcards move nothing
                        self.take(sample.payload.to_bytes(), arrival)
                self.consider()
            except Exception:
                self._give_up()

    def _give_up(self) -> None:
        """Follows the stream no more after a defect, told once."""
        if self._given_up != self._stream:
            log.exception("following failed, the arm holds")
        self._given_up = self._stream

    # --- the stream

    def take(self, payload: bytes, arrival: int) -> None:
        """Takes a setpoint that has arrived; what is wrong with one is only counted."""
        self._received += 1
        try:
            setpoint = decode(payload, self._dimension, self._arm.tolerance)
            now = self._clock()
            self._belongs(now, arrival)
            if not self._over():
                self._measure(setpoint, now)
        except Refusal as refusal:
            self._refused += 1
            self._last_refusal = str(refusal)

    def _belongs(self, now: float, arrival: int) -> None:
        """Counts a setpoint to the stream that runs, or begins one with it."""
        if self._alive(self._heard):
            last = now - self._heard
            self._interval = last if math.isinf(self._interval) else mixed(self._interval, last)
        else:
            self._stream, self._interval, self._note = arrival, math.inf, ""
            self._next_word = self._next_sentence = self._retry = -math.inf
        self._heard = now

    def _measure(self, setpoint: Setpoint, now: float) -> None:
        """Gives a setpoint to the tracker.

        Raises:
            Refusal: it is stale, from the future or out of order.
        """
        if not self._alive(self._fitted):
            self._tracker.forget()
            self._offset = self._wall() - now
        if self._tracker.measure(setpoint.position, setpoint.stamp, now + self._offset):
            self._fitted, self._tolerance = now, setpoint.tolerance

    def consider(self) -> None:
        """Tells the loop what the goal asks for now, which changes without a new setpoint, too, for it moves."""
        previous, free_at, now = self._loop.commanded, self._loop.free_at, self._clock()
        if not self._alive(self._fitted):
            return
        if self._over():
            self._tracker.forget()
            self._fitted = -math.inf
            return
        if self._loop.inbox.waiting() > MOST_WAITING:
            return
        wanted = None if previous is None else self._wanted(previous, free_at, now)
        if wanted is not None or now >= self._next_word:
            self._next_word = now + WORD_EVERY
            until, reason = self._fitted + self._timeout, f"following a setpoint{self._note}"
            configuration, stages = wanted or (None, None)
            self._loop.inbox.put(Follow(self._stream, previous, configuration, until, reason, stages))

    def _wanted(self, previous: Configuration, free_at: float, now: float) -> Way | None:
        """Returns how to switch from the previous configuration; None: stay, or it is too early to tell."""
        if now < max(free_at - self._searching - PERIOD, self._retry):
            return None
        manipulator, tolerance = self._arm.manipulator, self._tolerance
        bias = self._bias()
        aside = np.zeros(self._dimension) if bias is None else bias
        tip = manipulator.tip(previous)[: self._dimension, 3] + aside
        lead = max(free_at - now, self._searching) + self._settling
        goal = self._tracker.wants(now + self._offset, lead, tip, tolerance)
        if goal is None:
            self._say("", now)
            return None
        began, (solver, kept) = time.perf_counter(), self._guarded.now()
        try:
            start = carried(previous, manipulator, solver.manipulator)
        except ValueError:  # what is held has changed, and this solver does not go by that yet
            return None
        found = self._search(solver, goal - aside, start, tolerance / 2)  # half: see GoalTracker.wants
        self._searching = mixed(self._searching, time.perf_counter() - began)
        if found.error > tolerance:
            where = ", ".join(f"{x:.4f}" for x in goal)
            self._say(f", which is out of reach at ({where}): {found.error:.4f} away, tolerance {tolerance:g}", now)
            self._retry = now + RETRY
            return None
        if not found.switches:
            self._say("", now)
            return None
        try:
            way = self._way(solver, kept, goal - aside, start, found.configuration, tolerance / 2)
        except Blocked as blocked:
            self._say(f", the way to which is barred: {blocked}", now)
            self._retry = now + RETRY
            return None
        self._say("", now)
        return way

    def _way(
        self, solver: Solver, kept: Kept, goal: Vector, start: Configuration, end: Configuration, tolerance: float
    ) -> Way:
        """Returns how the solver's arm gets from a configuration (B,) to another, or to others within the tolerance.

        Raises:
            Blocked: no way was found on which nothing is touched.
        """
        whole, left = self._arm.manipulator, solver.manipulator
        if kept.free:
            return carried(end, left, whole), None
        until, barred = time.perf_counter() + ASIDE, None
        for configuration in (end, *solver.candidates(goal, start, tolerance, OTHERS)[0]):
            try:
                sweep = sweep_for(solver)
                stages = self._pace.staged(left, start, configuration, None, False, sweep, patience=0.0).stages
                if (touched := kept.touched(left.actuator_states(start), stages)) is None:
                    return carried(configuration, left, whole), stages
                barred = barred or Blocked(touched)
            except Blocked as blocked:
                barred = barred or blocked
            if time.perf_counter() > until:
                break
        raise barred or Blocked("no way was found")

    def _search(self, solver: Solver, goal: NDArray[np.float64], previous: Configuration, tolerance: float) -> Solution:
        """Returns what the arm's method finds, or IPOP where that misses by far: a longer search would, too."""
        method = self._arm.settings.method
        if method == "minimum-switch":
            first = solver.solve(goal, previous, tolerance, "ipop-previous", patience=SEARCH_TIME)
            if first.error > FAR * tolerance:
                return first
        return solver.solve(goal, previous, tolerance, method, SEARCH_TIME, patience=SEARCH_TIME)

    def _say(self, note: str, now: float) -> None:
        """Takes a note on the stream, unless the last is too young."""
        if note != self._note and now >= self._next_sentence:
            self._note, self._next_sentence = note, now + SENTENCE_EVERY

    def _over(self) -> bool:
        """Returns whether the stream is followed no more."""
        return self._stream <= max(self._loop.follow_after, self._given_up)

    def _alive(self, last: float) -> bool:
        """Returns whether what came last did so within the time-out."""
        return self._clock() - last <= self._timeout

    # --- for diagnostics

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

"""Motion supervision: whether the actuators did what they were commanded, as their end-stops read."""

from collections.abc import Sequence
from typing import NamedTuple

from controller.executor.arm import WORDS
from controller.executor.bits import indices, merged
from drivers.canopen.faults import Fault
from drivers.canopen.master import Master

MOST_MISSED = 3  # commands one after the other that an actuator may miss, each called back before its verdict
ASK_EVERY = 0.01  # [s] between two questions to a board


class Finding(NamedTuple):
    """A fault and the index of its actuator."""

    actuator: int
    fault: Fault


class MotionSupervision:
    """Commanded against measured states of A actuators.

    A verdict needs an answer: an actuator that has not arrived in time is "stuck" only after its board was asked for
    its inputs once more, and has answered or let the question time out.

    Args:
        boards: the master.
        places: actuator and wiring of each actuator, for messages, shape (A,).
        travel: longest time of an actuator from end-stop to end-stop [s].
        margin: added to it before an actuator counts as late [s].
    """

    def __init__(self, boards: Master, places: Sequence[str], travel: float, margin: float) -> None:
        self._boards, self._places, self._travel, self._margin = boards, places, travel, margin
        self._switched_at = [0.0] * len(places)
        self._ask_at = [0.0] * len(places)
        self._missed = [0] * len(places)
        self.reset(0, 0)

    def reset(self, measured: int, known: int) -> None:
        """Forgets all motions and reports; the measured states are right from now on, where known."""
        self._commanded, self._commanded_known = measured, known
        self._pending = self._confirms = self._reported = self._suspect = self._final = 0
        self._last = measured
        self._missed = [0] * len(self._places)

    def accept(self, measured: int, known: int) -> None:
        """Takes the measured states as right; actuators on their way stay so, they cannot stop between the ends."""
        self._commanded = merged(self._pending, self._commanded, measured)
        self._commanded_known = merged(self._pending, self._commanded_known, known)

    def switched(self, mask: int, states: int, measured: int, clock: float, now: float) -> None:
        """Notes that the actuators of a mask were switched to `states`.

        Args:
            mask: of the actuators.
            states: of all actuators.
            measured: before the switch.
            clock: see `tick` [s].
            now: for a question [s].
        """
        self._count_missed(mask, measured, clock, now)
        self._commanded = merged(mask, states, self._commanded)
        self._commanded_known |= mask
        self._pending |= mask
        self._final &= ~mask
        # An actuator called back halfway has not left its end-stop; only the travel time can tell when it is there.
        self._confirms = merged(mask, self._boards.sensed & (measured ^ states), self._confirms)
        for k in indices(mask):
            self._switched_at[k] = clock
            self._ask_at[k] = clock + self._travel

    def moving(self, measured: int, clock: float) -> bool:
        """Whether a switched actuator has not arrived, by its end-stop or else by the travel time."""
        if self._pending & self._confirms & (measured ^ self._commanded):
            return True
        unconfirmed = self._pending & ~self._confirms
        return any(clock - self._switched_at[k] < self._travel for k in indices(unconfirmed))

    def tick(self, measured: int, known: int, clock: float, now: float) -> list[Finding]:
        """Asks the boards of late actuators for their inputs, and compares commanded with measured states.

        Args:
            measured: states.
            known: mask of the actuators whose board is up.
            clock: time that the executor was awake [s]: a stall of its loop is no delay of an actuator.
            now: for the questions [s].

        Returns:
            "stuck" for each actuator that did not arrive, "unexpected-motion" for each that moved by itself; one for an
            actuator until `reset`.
        """
        readable = self._boards.sensed & known & self._commanded_known
        wrong = readable & (measured ^ self._commanded)
        self._forgive(measured)
        stuck = self._overdue(wrong, clock, now) | self._unreliable(readable)
        stray = wrong & ~self._pending & ~self._reported & ~stuck
        stuck &= ~self._reported
        self._reported |= stuck | stray
        return [self._stuck(k, measured) for k in indices(stuck)] + [self._stray(k, measured) for k in indices(stray)]

    def _overdue(self, wrong: int, clock: float, now: float) -> int:
        """Asks after actuators that should have arrived; returns the mask of those that have not, for certain."""
        stuck = 0
        for k in indices(self._pending):
            bit, late = 1 << k, clock - self._switched_at[k] - self._travel
            if not wrong & bit:  # it has arrived, or nobody can tell
                if late >= self._margin:
                    self._pending &= ~bit
            elif self._final & bit:
                if not self._boards.questioning(self._boards.board_of[k]):
                    stuck |= bit
            elif late >= 0 and clock >= self._ask_at[k]:
                self._ask(k, clock, now)
                if late >= self._margin:
                    self._final |= bit
        self._pending &= ~stuck
        return stuck

    def _unreliable(self, readable: int) -> int:
        """Returns the mask of the actuators that missed too many commands, once their boards have answered."""
        asked = [k for k in indices(self._suspect & readable) if not self._boards.questioning(self._boards.board_of[k])]
        mask = sum(1 << k for k in asked)
        self._suspect &= ~mask
        self._pending &= ~mask
        return mask

    def _count_missed(self, mask: int, measured: int, clock: float, now: float) -> None:
        """Counts commands that are called back after the travel time, before a verdict, with the end-stop unchanged."""
        for k in indices(mask & self._pending & self._confirms & (measured ^ self._commanded) & ~self._reported):
            if clock - self._switched_at[k] >= self._travel:
                self._missed[k] += 1
                if self._missed[k] >= MOST_MISSED and not self._suspect >> k & 1:
                    self._suspect |= 1 << k
                    self._boards.question(self._boards.board_of[k], now)

    def _forgive(self, measured: int) -> None:
        """Forgets the missed commands of the actuators whose end-stop has changed: they move."""
        for k in indices(measured ^ self._last):
            self._missed[k] = 0
            self._suspect &= ~(1 << k)
        self._last = measured

    def _ask(self, actuator: int, clock: float, now: float) -> None:
        board = self._boards.board_of[actuator]
        self._ask_at[actuator] = clock + max(self._margin / 3, ASK_EVERY)
        if not self._boards.questioning(board):
            self._boards.question(board, now)

    def _stuck(self, k: int, measured: int) -> Finding:
        reads, should = WORDS[measured >> k & 1], WORDS[self._commanded >> k & 1]
        limit, place = self._travel + self._margin, self._places[k]
        if self._missed[k] >= MOST_MISSED:
            text = f"actuator {place} missed {self._missed[k]} commands; its end-stop reads {reads} all the time"
        else:
            text = f"actuator {place} was to be {should} within {limit:g} s; its end-stop still reads {reads}"
        return Finding(k, Fault("stuck", place, text))

    def _stray(self, k: int, measured: int) -> Finding:
        reads, should = WORDS[measured >> k & 1], WORDS[self._commanded >> k & 1]
        place = self._places[k]
        text = f"the end-stop of actuator {place} reads {reads}, and it was not commanded: it should be {should}"
        return Finding(k, Fault("unexpected-motion", place, text))

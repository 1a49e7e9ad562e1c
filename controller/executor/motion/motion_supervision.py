"""Motion supervision: compares the commanded states with the end-stops."""

from collections.abc import Sequence

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.executor.arm.kinds import Ends, Kinds, indices, mask_of, merged
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.master import Master

MOST_MISSED = 3  # successive commands that an actuator may miss, each reversed before it counts as stuck
ASK_EVERY = 0.01  # [s] between two questions to a board


class MotionSupervision:
    """Compares the commanded states of A actuators with their end-stops.

    An end-stop reads 1 only while the actuator is at its end. An actuator has arrived when the end-stop at its new end
    reads 1 and the one at its old end reads 0. At an end without an end-stop, the travel time decides. One wrong
    reading is not yet a fault: a contact may bounce, and a TPDO may be lost. First the board of the actuator is asked
    for its inputs by SDO; the fault waits for the answer or its time-out.

    `clock`: awake time of the executor [s]; a stall of its loop is no delay of an actuator. `now`: for questions [s].
    `places`: label and wiring of each actuator for messages, shape (A,).
    """

    def __init__(self, master: Master, places: Sequence[str], kinds: Kinds) -> None:
        self._master, self._inputs, self._places, self._kinds = master, master.inputs, places, kinds
        self._switched_at = [0.0] * len(places)
        self._ask_at = [0.0] * len(places)
        self._missed = [0] * len(places)
        self.reset(0, 0, 0.0)

    @property
    def _ends(self) -> Ends:
        return self._kinds.ends(self._inputs.ends)

    def reset(self, states: int, known: int, clock: float) -> None:
        """Forgets all motions and reports; `states` are commanded where known.

        An actuator between its two end-stops counts as moving.
        """
        ends = self._ends
        self._commanded, self._commanded_known = states, known
        self._reported = self._suspect = self._final = self._doubtful = 0
        self._strayed = 0  # mask of actuators that seem to move without a command; their boards were asked
        self._last = ends
        self._missed = [0] * len(self._places)
        self._pending = self._confirms = self._late(ends) & ~ends.extended & ~ends.contracted & known
        for k in indices(self._pending):
            self._switched_at[k] = clock
            self._ask_at[k] = clock + self._travel(k)

    def accept(self, states: int, known: int) -> None:
        """Sets `states` as commanded, except for moving actuators: those cannot stop between their ends."""
        self._commanded = merged(self._pending, self._commanded, states)
        self._commanded_known = merged(self._pending, self._commanded_known, known)

    def record_switched(self, mask: int, states: int, clock: float, now: float) -> None:
        ends = self._ends
        # A command that is reversed after the travel time, although the end-stop has not changed, was missed.
        missed = (self._confirms & self._awaited(ends)) | self._at_other_end(ends)
        for k in indices(mask & self._pending & missed & ~self._reported):
            if clock - self._switched_at[k] >= self._travel(k):
                self._missed[k] += 1
                if self._missed[k] >= MOST_MISSED and not self._suspect >> k & 1:
                    self._suspect |= 1 << k
                    self._question(k, now)
        self._commanded = merged(mask, states, self._commanded)
        self._commanded_known |= mask
        self._pending |= mask
        self._final &= ~mask
        # An actuator reversed halfway may not have left its end-stop; then only the travel time tells its arrival.
        self._confirms = merged(mask, self._awaited(ends), self._confirms)
        for k in indices(mask):
            self._switched_at[k] = clock
            self._ask_at[k] = clock + self._travel(k)

    def await_anew(self, states: int, clock: float, now: float) -> None:
        """Expects a motion to `states` of actuators that did not follow their outputs before a reset.

        Their outputs already have the states of the stage, so nothing switches.
        """
        behind = (states ^ self._commanded) & self._commanded_known & ~self._pending
        if behind:
            self.record_switched(behind, states, clock, now)

    def moving(self, clock: float) -> bool:
        """Returns whether a switched actuator has not arrived, by its end-stop or by the travel time."""
        if not self._pending:
            return False
        if self._pending & self._confirms & self._late(self._ends):
            return True
        unconfirmed = self._pending & ~self._confirms
        return any(clock - self._switched_at[k] < self._travel(k) for k in indices(unconfirmed))

    @property
    def resting(self) -> bool:
        """Whether nothing moves, and no end-stop contradicts the commanded state but as reported."""
        ends = self._ends
        wrong = (self._late(ends) & self._inputs.known & self._commanded_known) | (ends.extended & ends.contracted)
        return not (wrong & ~self._reported or self._pending or self._suspect or self._strayed or self._doubtful)

    def decided(self) -> bool:
        """Returns whether no end-stop contradicts the commanded state in a way that may still become a fault."""
        contradicted = self._strayed | self._doubtful | (self._pending and self._pending & self._late(self._ends))
        return not contradicted & self._inputs.known & self._commanded_known

    def tick(self, clock: float, now: float) -> list[tuple[int, ArmFault]]:
        """Compares commanded states with the end-stops, and asks the boards of late actuators for their inputs.

        Returns faults with the index of their actuator: "end-stops" for each with both end-stops at 1, "stuck" for each
        that did not arrive, and "unexpected-motion" for each that moved without a command; at most one until `reset`.
        """
        ends, known = self._ends, self._inputs.known
        readable = known & self._commanded_known
        late = self._late(ends) & readable
        both = ends.extended & ends.contracted
        if ends != self._last:  # the missed commands of actuators whose end-stops have changed are forgotten
            for k in indices((ends.extended ^ self._last.extended) | (ends.contracted ^ self._last.contracted)):
                self._missed[k] = 0
                self._suspect &= ~(1 << k)
            self._last = ends
        if not (late | both | self._pending | self._suspect | self._strayed | self._doubtful):
            return []  # at rest
        broken, self._doubtful = self._confirm(both, self._doubtful, now)
        broken &= ~self._reported
        doubtful = self._doubtful | broken
        stuck = (self._find_stuck(late, clock, now) | self._find_unreliable(readable)) & ~doubtful
        strayed = late & ~self._pending & ~self._reported & ~stuck & ~doubtful
        stray, self._strayed = self._confirm(strayed, self._strayed, now)
        stuck &= ~self._reported
        self._reported |= stuck | stray | broken
        return [
            *((k, self._broken(k)) for k in indices(broken)),
            *((k, self._stuck(k, ends)) for k in indices(stuck)),
            *((k, self._stray(k, ends)) for k in indices(stray)),
        ]

    def _travel(self, k: int) -> float:
        return self._kinds.travel[k][self._commanded >> k & 1]

    def _awaited(self, ends: Ends) -> int:
        """Returns the mask of the actuators whose end-stop at the commanded end reads 0."""
        extended = self._kinds.ends_extended & ~ends.extended
        contracted = self._kinds.ends_contracted & ~ends.contracted
        return merged(self._commanded, extended, contracted)

    def _at_other_end(self, ends: Ends) -> int:
        """Returns the mask of the actuators whose end-stop at the other end still reads 1."""
        return merged(self._commanded, ends.contracted, ends.extended)

    def _late(self, ends: Ends) -> int:
        """Returns the mask of the actuators whose end-stops contradict the commanded state."""
        extended = (self._kinds.ends_extended & ~ends.extended) | ends.contracted
        contracted = (self._kinds.ends_contracted & ~ends.contracted) | ends.extended
        return merged(self._commanded, extended, contracted)

    def _confirm(self, suspects: int, asked: int, now: float) -> tuple[int, int]:
        """Asks the boards of actuators with unexpected end-stop readings for their inputs, once.

        Returns the mask of the actuators that read the same after the answer, and of those that wait for it.
        """
        for k in indices(suspects & ~asked & ~self._reported):
            self._question(k, now)
        certain = mask_of(k for k in indices(suspects & asked) if not self._questioning(k))
        return certain, suspects & ~certain

    def _find_stuck(self, late: int, clock: float, now: float) -> int:
        """Asks the boards of overdue actuators; returns the mask of the stuck ones, which are no longer moving."""
        stuck = 0
        for k in indices(self._pending):
            bit, over = 1 << k, clock - self._switched_at[k] - self._travel(k)
            margin = self._kinds.margin[k]
            if not late & bit:  # it has arrived, or no end-stop can tell
                if over >= margin:
                    self._pending &= ~bit
            elif self._final & bit:
                if not self._questioning(k):
                    stuck |= bit
            elif over >= 0 and clock >= self._ask_at[k]:
                self._ask_at[k] = clock + max(margin / 3, ASK_EVERY)
                for board in self._master.input_boards_of[k]:
                    if not self._master.boards[board].questioning:
                        self._master.question(board, now)
                if over >= margin:
                    self._final |= bit
        self._pending &= ~stuck
        return stuck

    def _find_unreliable(self, readable: int) -> int:
        """Returns the mask of the actuators that missed MOST_MISSED commands and whose boards have answered."""
        mask = mask_of(k for k in indices(self._suspect & readable) if not self._questioning(k))
        self._suspect &= ~mask
        self._pending &= ~mask
        return mask

    def _question(self, actuator: int, now: float) -> None:
        """Asks the boards of an actuator's end-stops for their inputs, again after running questions."""
        for board in self._master.input_boards_of[actuator]:
            self._master.question(board, now)

    def _questioning(self, actuator: int) -> bool:
        return any(self._master.boards[board].questioning for board in self._master.input_boards_of[actuator])

    def _stuck(self, k: int, ends: Ends) -> ArmFault:
        should, other = STATES[self._commanded >> k & 1], STATES[1 - (self._commanded >> k & 1)]
        place, limit = self._places[k], self._travel(k) + self._kinds.margin[k]
        reads = f"its end-stop does not read {should}"
        if self._at_other_end(ends) >> k & 1:
            reads = f"its end-stop still reads {other}"
        elif self._kinds.ends_extended & self._kinds.ends_contracted & 1 << k:
            reads = f"it has left its {other} end, and neither end-stop reads"
        text = f"actuator {place} did not become {should} within {limit:g} s; {reads}"
        if self._missed[k] >= MOST_MISSED:
            text = f"actuator {place} missed {self._missed[k]} commands; its end-stop did not change"
        return ArmFault("stuck", place, text)

    def _stray(self, k: int, ends: Ends) -> ArmFault:
        should, other = STATES[self._commanded >> k & 1], STATES[1 - (self._commanded >> k & 1)]
        place = self._places[k]
        reads = f"reads {other}" if self._at_other_end(ends) >> k & 1 else f"does not read {should} any more"
        text = f"actuator {place} moved without a command: its end-stop {reads}; check it, then reset"
        return ArmFault("unexpected-motion", place, text)

    def _broken(self, k: int) -> ArmFault:
        place = self._places[k]
        text = f"both end-stops of actuator {place} read 1 at once: check their wires and switches, then reset"
        return ArmFault("end-stops", place, text)

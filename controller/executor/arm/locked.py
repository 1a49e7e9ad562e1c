"""Locked actuators: which actuators cannot move, and in which state."""

from collections.abc import Iterator, Sequence

from hyperbit.controller.armfile.locks import STATES, lock_warning, locks_in_words
from hyperbit.controller.executor.arm.kinds import first, indices, merged
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.drivers.canopen.faults import ArmFault


class LockedActuators:
    """The locked actuators of one arm: their mask, and their states, 0 elsewhere. `number` grows with each change.

    An actuator is locked by the arm's file, by a request, or after a stuck fault. An end-stop reading overrides a
    declared state. `lock_as_measured` locks the actuators of the mask `stuck`.
    """

    def __init__(self, labels: Sequence[str], mask: int = 0, states: int = 0) -> None:
        self.mask, self.states = mask, states & mask
        self.stuck, self._labels = 0, labels

    def refusal(self, actuator: int, state: int, measured: int, readable: int) -> Refusal | None:
        """Returns why an actuator cannot be locked in a state, or unlocked with state -1; None if it can.

        `readable`: mask of the actuators with a readable end-stop.
        """
        if actuator >= len(self._labels):
            return Refusal(Reason.NO_SUCH_ACTUATOR, count=len(self._labels), index=actuator)
        reading = measured >> actuator & 1
        if state >= 0 and readable >> actuator & 1 and reading != state:
            return Refusal(Reason.END_STOP_CONTRADICTS, actuator=self._labels[actuator], state=STATES[reading])
        return None

    def change(self, actuator: int, state: int) -> None:
        """Locks an actuator in a state, 0 or 1, or unlocks it with -1."""
        bit = 1 << actuator
        self.stuck &= ~bit
        self._set(merged(bit, -1 if state >= 0 else 0, self.mask), merged(bit, -1 if state > 0 else 0, self.states))

    def lock_as_measured(self, measured: int, readable: int) -> None:
        """Locks the stuck actuators. Locked actuators with a readable end-stop get the measured state."""
        mask = self.mask | self.stuck
        self._set(mask, merged((mask & readable) | self.stuck, measured, self.states))
        self.stuck = 0

    def aligned(self, states: int) -> int:
        return merged(self.mask, self.states, states)

    def realigned(self, outputs: int, most: int) -> int:
        """Returns the states after a stage of at most `most` switches that brings locked actuators to their states."""
        return outputs ^ first(outputs ^ self.aligned(outputs), most)

    def faults(self) -> tuple[ArmFault, ...]:
        """Returns the warning "degraded" for each locked actuator."""
        return tuple(ArmFault("degraded", label, lock_warning(label, state)) for label, state in self._locks())

    def sentence(self) -> str:
        """Returns e.g. "locked: 5.left (contracted)"."""
        return locks_in_words(self._locks())

    def _locks(self) -> Iterator[tuple[str, int]]:
        return ((self._labels[k], self.states >> k & 1) for k in indices(self.mask))

    def _set(self, mask: int, states: int) -> None:
        self.mask, self.states = mask, states & mask

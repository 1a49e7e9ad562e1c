"""The changes of a boot on a board. A refused boot takes them back."""

from __future__ import annotations

from hyperbit.drivers.canopen.sdo.client import SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.procedure import Order, Procedure, Step
from hyperbit.drivers.canopen.wire.cia301 import Command, State

_COMMANDS = {State.OPERATIONAL: Command.START, State.STOPPED: Command.STOP}


class Undo:
    """Records the changes of a boot. Objects of the index `spared`, the outputs, are never written back.

    Nothing must be energised.
    """

    def __init__(self, spared: int) -> None:
        self.pins_known = False  # whether 6200h has the known levels of the pins, so that START changes none
        self._spared = spared
        self._seen: dict[tuple[int, int], bytes] = {}  # last value of each object
        self._state_known = False  # the initial NMT state is recorded, or was pre-operational
        self._back: list[Transfer | Order] = []  # steps that undo each change

    def recorded(self, procedure: Procedure) -> Procedure:
        """Runs a procedure, and records its writes. Reads an object of unknown value before its write."""
        outcome: SdoOutcome | None = None
        while True:
            try:
                step = next(procedure) if outcome is None else procedure.send(outcome)
            except StopIteration:
                return
            if isinstance(step, Transfer) and step.data is not None and (step.index, step.sub) not in self._seen:
                self._see(step.index, step.sub, (yield Transfer(step.index, step.sub)).data)
            outcome = yield step
            self._note(step, outcome)

    def left(self, before: State | None) -> None:
        """Records that a command of the boot moves the board from an NMT state to pre-operational."""
        if before in _COMMANDS and not self._state_known:
            self._back.append(Order(_COMMANDS[before]))

    def begin_again(self) -> None:
        """Continues the record after the board has stopped during the boot: its pins may have changed."""
        self.pins_known, self._state_known = False, bool(self._back)

    def restore(self) -> Procedure:
        """Takes the changes back, the last one first. Ends early if the board does not answer."""
        for step in reversed(self._back):
            if step == Order(Command.START) and not self.pins_known:
                continue
            if (yield step).silence is not None:
                return

    def _note(self, step: Step, outcome: SdoOutcome) -> None:
        if isinstance(step, Order) and step.command is Command.START:
            self._back.append(Order(Command.PRE_OPERATIONAL))
        if not isinstance(step, Transfer) or outcome.abort is not None:
            return
        if step.data is None:
            self._see(step.index, step.sub, outcome.data)
        elif step.index != self._spared:  # also after silence: the board may have taken the value
            before = self._seen.get((step.index, step.sub), step.data)[: len(step.data)]
            if before != step.data:
                self._back.append(Transfer(step.index, step.sub, before))
            self._seen[step.index, step.sub] = step.data

    def _see(self, index: int, sub: int, data: bytes | None) -> None:
        if data is not None:
            self._seen[index, sub] = data

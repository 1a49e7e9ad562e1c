"""The object dictionary of one board as a procedure sees it: the only store of its values, and the only way to it."""

from __future__ import annotations

from collections.abc import Generator, Iterable

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.sdo.client import TRIES, SdoOutcome, Transfer
from hyperbit.drivers.canopen.sdo.objects import ABSENT, BUSY, Need, Place, abort_words
from hyperbit.drivers.canopen.sdo.procedure import Ask, BoardError, Order, Procedure, Step, Wait
from hyperbit.drivers.canopen.wire.cia301 import Command, State

_BUSY_PAUSE = 0.2  # [s] between two attempts
_COMMANDS = {State.OPERATIONAL: Command.START, State.STOPPED: Command.STOP}  # back to a state


class Dictionary:
    """The objects of one board. Its generators are steps of a procedure.

    A subclass may replace `transfer` and `refuse`: then the same procedures serve another purpose than a boot. If
    `refuse` returns, the procedure goes on as if the need were met.

    Args:
        board: name for messages, e.g. "can0/5".
        patience: time for which transfers are repeated in all that the board refuses for its present state [s].
        spared: index of an object that is never written back, the outputs: nothing must be energised.
    """

    def __init__(self, board: str, patience: float = 0.0, spared: int | None = None) -> None:
        self.board = board
        self.values: dict[Place, int] = {}  # unsigned, as last read or written
        self.pins_known = False  # whether the outputs have the known levels of the pins, so that START changes none
        self._patience, self._spared = patience, spared
        self._back: list[Transfer | Order] = []  # steps that undo each change
        self._state_known = False  # the initial NMT state is recorded, or was pre-operational

    def transfer(self, step: Transfer | Ask) -> Generator[Step, SdoOutcome, SdoOutcome]:
        """Talks to the board. A write is repeated only while the object has the value that was known before it."""
        outcome = yield step
        it = step.transfer if isinstance(step, Ask) else step
        while outcome.abort == BUSY and self._patience > 0:
            self._patience -= _BUSY_PAUSE
            yield Wait(lambda: False, _BUSY_PAUSE)
            if it.data is not None and (known := self.values.get(it.place)) is not None:
                again = yield Transfer(*it.place, fresh=True)
                if again.data is None or known != int.from_bytes(again.data[: len(it.data)], "little"):
                    break
            outcome = yield step
        return outcome

    def refuse(self, code: str, text: str, *places: Place) -> None:
        """Raises BoardError. `places`: the objects at fault, the likely cause first."""
        raise BoardError(ArmFault(code, self.board, text))

    def answered(self, transfer: Transfer) -> Generator[Step, SdoOutcome, SdoOutcome]:
        """Returns the outcome of a transfer; refuses the board after silence.

        Some boards give no answer for an object that they lack: then 1000h, which each board has, is answered.
        """
        control = not transfer.staged and transfer.index != 0x1000  # a staged write is asked once
        for _ in range(1 + control):
            outcome = yield from self.transfer(transfer)
            if outcome.silence is None:
                return outcome
            control = control and (yield Transfer(0x1000, 0, tries=1, fresh=True)).silence is None
            if not control:
                break
        place = f"{transfer.index:04X}h sub {transfer.sub}"
        if control:
            text = f"board {self.board} answers to 1000h, but not to {place}: {outcome.silence}"
            advice = "does it give no answer for an object that it lacks, where CiA 301 asks for an abort?"
            self.refuse("sdo-unanswered", f"{text}; {advice}", transfer.place)
        self.refuse("board-missing", f"board {self.board} does not answer to {place}: {outcome.silence}")
        return outcome

    def take(self, index: int, sub: int, size: int, outcome: SdoOutcome) -> int:
        """Stores and returns the value of an answer; refuses the board after an abort, or a value of another size."""
        place = f"{index:04X}h sub {sub}"
        if outcome.data is None:
            text = f"board {self.board} refuses to read {place}: {abort_words(outcome.abort or 0)}"
            self.refuse("sdo-refused", text, (index, sub))
        elif len(outcome.data) not in (size, 4):  # some boards send four bytes for any number
            text = f"board {self.board} answers {len(outcome.data)} bytes to {place}; {size} are needed"
            self.refuse("wrong-device", text, (index, sub))
        else:
            self.values[index, sub] = int.from_bytes(outcome.data[:size], "little")
        return self.values[index, sub]

    def read(self, index: int, sub: int, size: int = 1, fresh: bool = False) -> Generator[Step, SdoOutcome, int]:
        """Reads an unsigned value of `size` bytes. `fresh`: a late answer to an earlier read must not count."""
        outcome = yield from self.answered(Transfer(index, sub, fresh=fresh))
        return self.take(index, sub, size, outcome)

    def find(self, index: int, sub: int, size: int = 1) -> Generator[Step, SdoOutcome, int | None]:
        """Reads an unsigned value like `read`; returns None if the board has no such object."""
        outcome = yield from self.answered(Transfer(index, sub))
        return None if outcome.abort in ABSENT else self.take(index, sub, size, outcome)

    def check(self, need: Need) -> Procedure:
        """Reads an object unless it is known; refuses the board if it is required and absent, or wrong and fixed."""
        if need.at not in self.values:
            yield from self.find(*need.at, need.size)
        if (present := self.values.get(need.at)) is None:
            if need.required is not None:
                text = f"board {self.board} has no {need.place}; {need.words(need.value)} is needed there"
                self.refuse("wrong-device", f"{text}: {need.required}", need.at)
        elif need.fixed is not None and not need.met(present):
            text = f"board {self.board} has {need.words(present)} in {need.place}"
            needed = need.words(need.corrected(present))
            self.refuse("wrong-device", f"{text}; {needed} is needed: {need.fixed}", need.at)

    def unmet(self, needs: Iterable[Need]) -> list[Need]:
        """Returns the unmet needs of objects that the board has."""
        return [need for need in needs if need.at in self.values and not need.met(self.values[need.at])]

    def meet(self, needs: Iterable[Need]) -> Procedure:
        """Writes the values that differ, and reads them back."""
        for need in self.unmet(needs):
            yield from self.ensure(need)

    def ensure(self, need: Need, staged: bool = False) -> Procedure:
        """Writes the needed value over the known one, and reads it back; refuses the board if it has another one."""
        present = self.values[need.at]
        value = need.corrected(present)
        abort = yield from self.write(*need.at, value, need.size, staged)
        if abort is not None:
            text = f"board {self.board} has {need.words(present)} in {need.place}; {need.words(value)} is needed"
            self.refuse("sdo-refused", f"{text}, which it refuses: {abort_words(abort)}", need.at)
            return
        confirmed = yield from self.read(*need.at, need.size, fresh=True)
        if not need.met(confirmed):
            text = f"board {self.board} has {need.words(confirmed)} in {need.place} after {need.words(value)}"
            self.refuse("sdo-refused", f"{text} was written: does another program write to it?", need.at)

    def write(
        self, index: int, sub: int, value: int, size: int, staged: bool = False
    ) -> Generator[Step, SdoOutcome, int | None]:
        """Writes a value, a staged one once; returns None or the abort code. Records the way back.

        An object of unknown value is read before.
        """
        if (index, sub) not in self.values:
            data = (yield from self.transfer(Transfer(index, sub))).data
            if data is not None:
                self.values[index, sub] = int.from_bytes(data[:size], "little")
        before = self.values.get((index, sub), value)
        changes = before != value and index != self._spared
        if changes:  # it stays after silence: the board may have taken the value
            self._back.append(Transfer(index, sub, before.to_bytes(size, "little")))
        tries = 1 if staged else TRIES
        write = Transfer(index, sub, value.to_bytes(size, "little"), tries=tries, staged=staged)
        outcome = yield from self.answered(write)
        if outcome.abort is None:
            self.values[index, sub] = value
        elif changes:
            self._back.pop()
        return outcome.abort

    def order(self, command: Command, before: State | None = None) -> Procedure:
        """Gives the board an NMT command. `before`: the state that the command ends, and to which `undo` leads back."""
        if before in _COMMANDS and not self._state_known:
            self._back.append(Order(_COMMANDS[before]))
        outcome = yield Order(command)
        if outcome.data is None:
            text = f"board {self.board} could not be told to change its state: {outcome.silence}"
            self.refuse("board-missing", text)
        if command is Command.START:
            self._back.append(Order(Command.PRE_OPERATIONAL))

    def forget(self) -> None:
        """Forgets all values, but not the way back: the board has stopped, and its pins may have changed."""
        self.values.clear()
        self.pins_known, self._state_known = False, bool(self._back)

    def undo(self) -> Procedure:
        """Takes the changes back, the last one first. Ends early if the board does not answer."""
        for step in reversed(self._back):
            if step == Order(Command.START) and not self.pins_known:
                continue
            if (yield step).silence is not None:
                return

"""The boards of the world: boards and actuators, their faults, and the changes of their outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame, State
from hyperbit.drivers.canopen.wiring import Timing, Wiring
from hyperbit.drivers.simulation.variants import Variant
from tests.simulation.agenda import Agenda
from tests.simulation.buses.boards import AttachedBoards
from tests.simulation.buses.bus_model import OnItsWay
from tests.simulation.statements.account import Account
from tests.simulation.statements.arm import merged
from tests.simulation.statements.motions import Energised, Switch, Sync

FOREIGN_START = "foreign START"


class BoardSide(AttachedBoards):
    """All boards of an arm, seen by the account.

    Attributes:
        names: mask of the actuators of each board, by the board's name.
        silent: whether a board is disconnected from its bus.
        opened: names of the open interlocks.
    """

    def __init__(
        self,
        wiring: Wiring,
        timing: Timing,
        variants: Mapping[str, Variant],
        agenda: Agenda,
        send: Callable[[str, Frame], None],
        account: Account,
    ) -> None:
        self.names: dict[str, int] = {}
        self._masks = dict.fromkeys((bus.name for bus in wiring.buses), 0)
        for k, channel in enumerate(wiring.channels):
            name = f"{channel.bus}/{channel.node}"
            self.names[name] = self.names.get(name, 0) | 1 << k
            self._masks[channel.bus] |= 1 << k
        self.silent = False
        self._account = account
        self._read = True  # whether end-stops may have changed
        self._paired = sum(1 << k for k in wiring.paired)
        self._drives, self._coils = -1, 0  # unknown
        self._interlocks = tuple(lock.name for lock in wiring.interlocks)
        self.opened: set[str] = set()
        super().__init__(wiring, timing, variants, agenda, send)
        self._drives = self._valves()
        self._actuators = list(self.simulated.actuators.values())
        self._levels = [(c.input is not None, c.input_contracted is not None, c.inverted) for c in wiring.channels]
        for actuator in self._actuators:
            actuator.observers.append(self._end_stop_changed)
        account.pins.drive(self._drives)
        self._read_ends()

    def _end_stop_changed(self) -> None:
        self._read = True

    def _read_ends(self) -> None:
        extended = contracted = 0
        for k, (actuator, (has, has_contracted, inverted)) in enumerate(
            zip(self._actuators, self._levels, strict=True)
        ):
            extended |= (has and actuator.reads(1) ^ ("input" in inverted)) << k
            contracted |= (has_contracted and actuator.reads(0) ^ ("input_contracted" in inverted)) << k
        self._account.see("reads", extended, contracted)
        self._read = False

    def drives(self) -> int:
        """Returns the end to which each actuator is driven, or was driven last, as a mask."""
        return self._drives

    def coils(self) -> int:
        """Returns the mask of the actuators with two coils that have a coil on."""
        return self._coils

    def both_on(self) -> list[int]:
        """Returns how often both coils of each actuator were on at once, shape (A,)."""
        return self.simulated.both_on()

    def _valves(self) -> int:
        return sum(drive << k for k, drive in enumerate(self.simulated.drives()))

    def _driven(self, coils: list[tuple[int, int]], cause: str) -> int:
        """Returns the ends to which the actuators are driven; with two coils, by the last coil that was on.

        A pulse that a fault has cut short may have switched no valve.
        """
        before, after = self._drives, self._valves() & ~self._paired
        if cause == "fault":
            before = merged(self._coils, self._valves(), before)
        for k, (on, off) in enumerate(coils):
            if self._paired >> k & 1:
                after |= (on if on != off else before >> k & 1) << k
        return after

    def door(self, name: str, is_open: bool) -> None:
        verb = "open" if is_open else "close"
        super().fault(verb, name)
        self._account.see("fault", verb, name)
        (self.opened.add if is_open else self.opened.discard)(name)

    def positions(self) -> int:
        """Returns the nearer end of each actuator, as a mask."""
        return sum(round(position) << k for k, position in enumerate(self.simulated.positions()))

    def hear(self, bus: str, sent: OnItsWay, lost: bool) -> None:
        """Takes a sent frame of the executor; `lost` if the boards do not receive it."""
        frame = sent.frame
        boards = {name: mask for name, mask in self.names.items() if name.split("/")[0] == bus}
        deaf = self.deaf_to(bus, frame)
        missing = sum(mask for name, mask in boards.items() if lost or name == deaf or not self.takes_part(name))
        self._account.see("leaves", bus, frame, missing)
        if not lost:
            self.receive(bus, frame, _words(frame), sent.belongs_to)

    def hear_tool(self, bus: str, frame: Frame) -> None:
        """Takes a frame of another program; its effects are faults."""
        self.receive(bus, frame, FOREIGN_START if frame.data[:1] == bytes([Command.START]) else "fault")

    def fault(self, verb: str, name: str, *numbers: float | str) -> None:
        if verb == "power_on" and self.simulated.board(name).state is not None:
            return
        self._account.see("fault", verb, name)
        super().fault(verb, name, *numbers)
        self._read = True  # of an end-stop that reads otherwise since the fault
        self.see("fault")
        self.silent = any(self.simulated.board(board).silent for board in self.names)

    def emergency(self, board: str, code: int) -> None:
        self.simulated.board(board).send_emergency(code.to_bytes(2, "little") + bytes([1, 0, 0, 0, 0, 0]))

    def mend(self) -> None:
        for board in self.names:
            if self._mute(board):
                self.fault("power_cut", board)
            self.fault("power_on", board)
            self.fault("unsilence", board)
        for label in self.simulated.labels:
            self.fault("release", label)
            self.fault("slow", label, 1)
            self.fault("restore_sensor", label)
        for name in self._interlocks:
            self.door(name, is_open=False)

    def _mute(self, name: str) -> bool:
        """Returns whether a board is stopped and has no heartbeat time: it answers nothing until a power-cycle."""
        board = self.simulated.board(name)
        return board.state == State.STOPPED and not board.objects.number(0x1017, 0)

    def takes_part(self, name: str) -> bool:
        """Returns whether a board is operational and connected."""
        board = self.simulated.board(name)
        return not board.silent and board.state == State.OPERATIONAL

    def see(self, cause: str, belongs_to: object = None) -> None:
        """Records the changes of the outputs since the last call."""
        if self._drives < 0:
            return
        sync = belongs_to if isinstance(belongs_to, Sync) else None
        coils = self.simulated.coils()
        after = self._driven(coils, cause)
        on = sum(1 << k for k, pair in enumerate(coils) if self._paired >> k & 1 and any(pair))
        was_on, came = self._coils, on & ~self._coils | on & (after ^ self._drives)
        self._coils = on
        changed, self._drives = after ^ self._drives, after
        if self._read:
            self._read_ends()
        for bus, mask in self._masks.items():
            if changed & mask:
                self._account.see("switches", Switch(changed & mask, after, cause, bus, sync))
            coils_of_bus = Energised(came & mask, on & mask, came & mask & ~changed, cause, bus, sync)
            if came & mask or (on ^ was_on) & mask:
                self._account.see("energises", coils_of_bus)


def _words(frame: Frame) -> str:
    if frame.id == cia301.NMT and frame.data[:1] == bytes([Command.START]):
        return "START"
    return "SYNC" if frame.id == cia301.SYNC else f"frame {frame.id:03X}h"

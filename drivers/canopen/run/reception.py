"""The reception of frames: passes the frames of one bus to its boards."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.board import Station
from hyperbit.drivers.canopen.run.outputs import OutputLines
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wiring import MASTER


class Reception:
    """Passes the frames of one bus to its boards.

    Args:
        bus: name of the bus.
        outputs: tells which frames are RPDOs of the master.
        stations: boards of all buses.
        rebooted: called with each restarted board.
        report: takes faults.
    """

    def __init__(
        self,
        bus: str,
        outputs: OutputLines,
        stations: Iterable[Station],
        rebooted: Callable[[Station, float], None],
        report: Callable[[ArmFault], None],
    ) -> None:
        self._bus, self._rebooted, self._report = bus, rebooted, report
        self._stations = {s.board.layout.node: s for s in stations if s.board.layout.bus == bus}
        self._masters = {cia301.NMT: "NMT", cia301.SYNC: "SYNC", cia301.HEARTBEAT + MASTER: "the master's heartbeat"}
        self._outputs = outputs

    def receive_frame(self, frame: Frame, now: float) -> bool:
        """Takes a frame of another node; returns whether it was understood."""
        cob_id, data = frame
        what = self._masters.get(cob_id) or ("an RPDO" if self._outputs.sends(self._bus, cob_id) else None)
        if what is not None:
            text = f"another master sends on {self._bus} ({what}, frame {cob_id:03X}h): stop it, only one may switch"
            self._report(ArmFault("foreign-master", self._bus, f"{text} the boards"))
            if cob_id == cia301.NMT and len(data) == 2:
                self._obey(data[0], data[1], now)
            return True
        if not 0 <= cob_id <= 0x7FF or (station := self._stations.get(cob_id & 0x7F)) is None:
            return False
        function, board, boots = cob_id & 0x780, station.board, station.board.boots
        understood = board.receive_frame(cob_id, data, now)
        if function == cia301.SDO_ANSWER and understood:
            station.runner.receive_sdo(data, now)
        if board.boots != boots:
            self._rebooted(station, now)
        station.runner.check(now)
        return understood

    def _obey(self, command: int, node: int, now: float) -> None:
        """Takes an NMT command of another program. After START a boot begins again: the pins are as 6200h says."""
        for station in self._stations.values():
            if node in (0, station.board.layout.node):
                station.board.obey(command)
                if command == Command.START:
                    self._rebooted(station, now)

    def echoed(self, frame: Frame, now: float) -> None:
        """Takes the echo of a sent frame: the procedure of a board may wait for its NMT command."""
        if frame.id == cia301.NMT and (station := self._stations.get(frame.data[1])) is not None:
            station.runner.check(now)

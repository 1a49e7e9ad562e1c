"""All buses and boards of an arm, and the states that are known of them."""

from __future__ import annotations

from collections.abc import Callable

from drivers.canopen.board import Board, StateImage
from drivers.canopen.cia301 import Frame
from drivers.canopen.faults import Fault, FaultLog
from drivers.canopen.layout import Layout, lay_out
from drivers.canopen.link import Link
from drivers.canopen.load import worst_case
from drivers.canopen.outputs import Outputs
from drivers.canopen.station import Station
from drivers.canopen.status import Status
from drivers.canopen.wiring import Timing, Wiring


class Network:
    """Buses, boards and actuator states.

    Attributes:
        layout: of the process data.
        links: the buses, by name.
        stations: the boards.
        outputs: of all boards.
        image: states from the end-stops, and which states are known.
        log: faults that were not taken yet.
        sensed: mask of the actuators that have an end-stop.

    Args:
        wiring: buses, boards and actuators.
        timing: times of boards and actuators.
        send: hands out a frame for a bus, by its name.
    """

    def __init__(self, wiring: Wiring, timing: Timing, send: Callable[[str, Frame], None]) -> None:
        self.layout: Layout = lay_out(wiring)
        self.sensed = sum(board.sensed for board in self.layout.boards)
        self._everything = (1 << len(wiring.channels)) - 1
        self.image, self.log, self.outputs = StateImage(), FaultLog(), Outputs(self.layout)
        stuck_after = 0.8 * (timing.heartbeat_timeout - timing.heartbeat)  # before the boards miss the master
        self.links = {bus.name: Link(bus, send, stuck_after) for bus in wiring.buses}
        self.stations = [
            Station(i, Board(board, self.image, self.log.report), self.links[board.bus])
            for i, board in enumerate(self.layout.boards)
        ]
        self._worst_case = {bus.name: worst_case(self.layout, timing, bus) for bus in wiring.buses}

    @property
    def all_known(self) -> bool:
        """Whether all boards are up."""
        return self.image.known == self._everything

    @property
    def ready(self) -> bool:
        """Whether all boards are up, and all buses are armed."""
        return self.all_known and all(link.armed for link in self.links.values())

    @property
    def measured(self) -> int:
        """States from the end-stops, else from the outputs; 0 where unknown."""
        return (self.image.ends | self.outputs.states & ~self.sensed) & self.image.known

    def refusal(self) -> str | None:
        """Returns why nothing may be switched, or None."""
        for link in self.links.values():
            if not link.armed:
                return f"{link.name} is {link.state} or was lost: nothing is sent until its boards are booted"
        if not self.all_known:
            name = next(station.board.name for station in self.stations if not station.board.ready)
            return f"board {name} is not up: nothing is sent until it is booted"
        return None

    def rearm(self) -> dict[str, Fault]:
        """Arms all buses; returns a fault for each that is not usable, by its name."""
        return {name: fault for name, link in self.links.items() if (fault := link.rearm()) is not None}

    def back(self, now: float) -> bool:
        """Whether frames leave on all buses, and all boards are heard."""
        fit = all(link.fit(now) for link in self.links.values())
        return fit and all(station.board.heard for station in self.stations)

    def probe_silent(self, now: float) -> None:
        """Asks the boards that are not heard."""
        for station in self.stations:
            if not station.board.heard and self.links[station.board.layout.bus].usable:
                station.probe(now)

    def forget(self, bus: str | None = None) -> None:
        """Takes the states of all boards, or of the boards of one bus, as unknown until they are booted."""
        for station in self.stations:
            if bus in (None, station.board.layout.bus):
                station.cancel()
                station.board.ready = False

    def tick(self, now: float, heartbeat_timeout: float) -> None:
        """Does what time brings to the boards; `now` stands still while the loop stalls [s]."""
        for station in self.stations:
            station.board.tick(now, heartbeat_timeout)
            station.runner.tick(now)

    def status(self, now: float) -> Status:
        """State and counters for diagnostics."""
        return Status(
            buses=tuple(link.status(self._worst_case[name]) for name, link in self.links.items()),
            boards=tuple(station.board.status(now) for station in self.stations),
        )

"""The buses and boards of an arm, and what is known of the boards' outputs and inputs."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.drivers.canopen.faults import ArmFault, FaultLog
from hyperbit.drivers.canopen.layout import Layout, lay_out
from hyperbit.drivers.canopen.pdo import union
from hyperbit.drivers.canopen.run.board import Board, StateImage, Station
from hyperbit.drivers.canopen.run.outputs import Key, OutputLines
from hyperbit.drivers.canopen.run.reception import Reception
from hyperbit.drivers.canopen.status import MasterStatus
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.link import Link
from hyperbit.drivers.canopen.wire.load import worst_case
from hyperbit.drivers.canopen.wiring import Timing, Wiring


class Boards:
    """The buses and boards of an arm.

    Attributes:
        layout: layout of the process data.
        links: the buses by name.
        stations: the boards.
        outputs: output lines of all boards.
        image: levels of the input lines, and which are known.
        log: faults that the caller has not taken yet.
        sensed: mask of the actuators that have an end-stop.
        pulsed: mask of the output lines that are on for a pulse only.

    Args:
        wiring: buses, boards and actuators.
        timing: times of boards and actuators.
        send: hands out a frame for a bus, by its name.
    """

    def __init__(self, wiring: Wiring, timing: Timing, send: Callable[[str, Frame], None]) -> None:
        self.layout: Layout = lay_out(wiring)
        channels = wiring.channels
        ended = [c.input is not None or c.input_contracted is not None for c in channels]
        self.sensed = sum(1 << k for k, has in enumerate(ended) if has)
        self.pulsed = sum(
            1 << k | 1 << len(channels) + i for i, k in enumerate(wiring.paired) if channels[k].pulse is not None
        )
        self.image, self.log, self.outputs = StateImage(), FaultLog(), OutputLines(self.layout, self.pulsed)
        stuck_after = 0.8 * (timing.heartbeat_timeout - timing.heartbeat)  # before the boards lose the master
        self.links = {bus.name: Link(bus, send, stuck_after) for bus in wiring.buses}
        self.stations = [
            Station(i, Board(board, self.image, self.log.report), self.links[board.bus])
            for i, board in enumerate(self.layout.boards)
        ]
        self._worst_case = {bus.name: worst_case(self.layout, timing, bus) for bus in wiring.buses}

    @property
    def all_known(self) -> bool:
        """Whether all boards are ready."""
        return all(station.board.ready for station in self.stations)

    @property
    def ready(self) -> bool:
        """Whether all boards are ready, and all buses are armed."""
        return self.all_known and all(link.armed for link in self.links.values())

    def refusal(self, lines: int | None = None) -> str | None:
        """Returns why nothing may be switched now, or None.

        Args:
            lines: mask of lines that only go off: a lost board may still hear, so it counts only whether its bus
                sends frames, armed or not. None: any.
        """
        stations = [s for s in self.stations if lines is None or s.board.layout.output_lines & lines]
        buses = self.links if lines is None else {station.board.layout.bus for station in stations}
        for link in (self.links[bus] for bus in buses):
            if not (link.armed if lines is None else link.usable):
                return f"{link.name} is {link.state} or was lost: nothing is sent until its boards are booted"
        for station in stations if lines is None else ():
            if not station.board.ready:
                return f"board {station.board.name} is not ready: nothing is sent until it is booted"
        return None

    def frames_of(self, bus: str, keys: list[Key], lines: int | None) -> list[Key | Frame]:
        """Returns the frames for ready boards, after NMT commands for lost boards to leave operational.

        A SYNC would also switch a lost board that is operational and has latched a frame. A lost board of `lines`,
        which only go off, gets its frame like a ready one.
        """
        lost = self.left_out(bus, lines)
        orders = [cia301.command(Command.PRE_OPERATIONAL, self.stations[i].board.layout.node) for i in sorted(lost)]
        return [*orders, *(key for key in keys if not self.outputs.takers(key) <= lost)]

    def left_out(self, bus: str, lines: int | None) -> set[int]:
        """Returns the indices of the boards of a bus that are not ready and have none of the `lines` that go off."""
        here = [s for s in self.stations if s.board.layout.bus == bus and not s.board.ready]
        return {s.index for s in here if not s.board.layout.output_lines & (lines or 0)}

    def released(self, lines: int) -> tuple[int, int]:
        """Returns what a release of lines switches.

        The release leaves out boards that have restarted: their outputs are off, and their frames could switch others
        on. Doubtful lines of the same boards go off too: their levels are unknown, and a release switches nothing on.

        Args:
            lines: mask of lines to switch off.

        Returns:
            Levels of all lines after it, and the mask of the lines that go off.
        """
        states, doubtful = self.outputs.states, self.outputs.doubtful
        boards = [s.board for s in self.stations if s.board.layout.output_lines & lines]
        off = (states | doubtful) & lines & union(b.layout.output_lines for b in boards if not b.restarted)
        touched = union(b.layout.output_lines for b in boards if b.layout.output_lines & off)
        return states & ~off & ~(doubtful & touched), off

    def warnings(self) -> tuple[ArmFault, ...]:
        """Returns the warnings: error-passive buses; limits of boards, and outputs written off before the start."""
        passive = tuple(fault for link in self.links.values() if (fault := link.passive()) is not None)
        boards = [station.board for station in self.stations if station.board.ready]
        limits = (
            ArmFault("board-limits", b.name, f"board {b.name}: {'; '.join(b.warnings)}") for b in boards if b.warnings
        )
        text = "outputs may have been switched off by the board; written off before start"
        released = (ArmFault("outputs-off", b.name, f"{b.name}: {text}") for b in boards if b.released)
        return (*passive, *limits, *released)

    def rearm(self) -> dict[str, ArmFault]:
        """Arms all buses; returns a fault for each unusable bus, by its name."""
        return {name: fault for name, link in self.links.items() if (fault := link.rearm()) is not None}

    def back(self, now: float) -> bool:
        """Returns whether all buses send frames, and all boards are heard."""
        fit = all(link.fit(now) for link in self.links.values())
        return fit and all(station.board.heard for station in self.stations)

    def receptions(self, rebooted: Callable[[Station, float], None]) -> dict[str, Reception]:
        """Returns a reception for each bus, by its name; `rebooted` is called with each restarted board."""
        return {bus: Reception(bus, self.outputs, self.stations, rebooted, self.log.report) for bus in self.links}

    def probe_silent(self, now: float) -> None:
        """Asks each silent board for its device type."""
        for station in self.stations:
            if not station.board.heard and self.links[station.board.layout.bus].usable:
                station.probe(now)

    def forget(self, bus: str | None = None) -> None:
        """Marks the states of all boards, or of those of one bus, as unknown until their boot."""
        for station in self.stations:
            if bus in (None, station.board.layout.bus):
                station.cancel()
                station.board.ready, station.board.held = False, None

    def tick(self, now: float, heartbeat_timeout: float, stalled: bool) -> None:
        """Handles the timeouts of all boards, and finds two boards with one node id.

        Args:
            now: time that stands still while the loop stalls [s].
            heartbeat_timeout: longest silence of a board [s].
            stalled: whether the loop has just stalled, so that frames of a longer time come at once.
        """
        for station in self.stations:
            station.board.tick(now, heartbeat_timeout)
            station.runner.tick(now)
            twice = station.board.beats.twice(now, stalled) or station.runner.answered_twice
            if twice and station.board.ready:
                name = station.board.name
                text = f"two boards answer as {name}: give each its own node id, then reset"
                station.board.fail(ArmFault("duplicate-node", name, text))

    def status(self, now: float) -> MasterStatus:
        """Returns state and counters for diagnostics."""
        return MasterStatus(
            buses=tuple(link.status(self._worst_case[name]) for name, link in self.links.items()),
            boards=tuple(station.board.status(now) for station in self.stations),
        )

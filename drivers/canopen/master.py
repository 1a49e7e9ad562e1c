"""The CANopen master of an arm: frames and time in; frames, actuator states and faults out."""

from __future__ import annotations

from collections.abc import Callable

from drivers.canopen import cia301
from drivers.canopen.board import Board
from drivers.canopen.booting import Booting
from drivers.canopen.cia301 import Frame
from drivers.canopen.commit import Commit
from drivers.canopen.events import Changed, Echoed, Event, Ignored, Received
from drivers.canopen.faults import Busy, Fault, FaultLog
from drivers.canopen.heartbeat import BEAT, Heartbeat
from drivers.canopen.layout import lay_out
from drivers.canopen.link import Link
from drivers.canopen.load import worst_case
from drivers.canopen.outputs import Outputs
from drivers.canopen.reception import Reception
from drivers.canopen.state_image import StateImage
from drivers.canopen.station import Station
from drivers.canopen.status import Status
from drivers.canopen.wiring import Timing, Wiring

_LONGEST_STEP = 0.05  # [s] that one tick counts for at most in time-outs: a stall of the loop alone ends none


class Master:
    """All boards of an arm, on all its buses.

    It is pure: no I/O, no clock, no threads, and nothing waits. Actuator k is bit k of an integer of states or of a
    mask. `now` is CLOCK_MONOTONIC [s], or any clock that never goes back. No event raises.

    Args:
        wiring: buses, boards and actuators.
        timing: times of boards and actuators.
        send: hands out a frame for a bus, by its name; must not call the master. It never fails: the fate of the frame
            comes back as `echoed` or `send_failed`, and `send_failed` before the next `tick`.

    Attributes:
        board_of: index of each actuator's board.
        boards: name of each board, e.g. "can0/5".
        sensed: mask of the actuators that have an end-stop.
    """

    def __init__(self, wiring: Wiring, timing: Timing, send: Callable[[str, Frame], None]) -> None:
        layout = lay_out(wiring)
        self.board_of = layout.board_of
        self.boards = tuple(board.name for board in layout.boards)
        self.sensed = sum(board.sensed for board in layout.boards)
        self._all = (1 << len(wiring.channels)) - 1
        self._timing = timing
        self._image = StateImage()
        self._log = FaultLog()
        self._outputs = Outputs(layout)
        stuck_after = 0.8 * (timing.heartbeat_timeout - timing.heartbeat)  # before the boards miss the master
        self._links = {bus.name: Link(bus, send, stuck_after) for bus in wiring.buses}
        self._worst_case = {bus.name: worst_case(layout, timing, bus) for bus in wiring.buses}
        self._stations = [
            Station(i, Board(board, self._image, self._log.report), self._links[board.bus])
            for i, board in enumerate(layout.boards)
        ]
        self._booting = Booting(self._stations, self._outputs, wiring, timing)
        self._receptions = {
            bus.name: Reception(bus.name, layout.frames, self._stations, self._booting.rebooted, self._log.report)
            for bus in wiring.buses
        }
        self._heartbeat = Heartbeat(self._links.values(), timing)
        self._switched: list[tuple[int, float]] = []
        longest = timing.heartbeat_timeout / 2
        self._commit = Commit(self._links, self._outputs, self._refusal, self._note_switched, longest)
        self._ticked: float | None = None  # real time of the last tick
        self._halt_reported: float | None = None  # of the last tick before a halt
        self._now = 0.0  # time that stands still while the loop stalls, as of the last tick

    # --- events

    def take(self, event: Event, now: float) -> None:
        """Takes an event of a bus: calls one of the five methods below."""
        if isinstance(event, Received):
            self.receive(event.bus, event.frame, now)
        elif isinstance(event, Echoed):
            self.echoed(event.bus, event.frame, now)
        elif isinstance(event, Ignored):
            self.ignore(event.bus, event.bits, now)
        elif isinstance(event, Changed):
            self.bus_changed(event.bus, event.state, event.why, event.errors, now)
        else:
            self.send_failed(event.bus, event.frame, event.why, now)

    def receive(self, bus: str, frame: Frame, now: float) -> None:
        """Takes a standard data frame of another node."""
        link = self._links[bus]
        link.received(len(frame.data))
        if not self._receptions[bus].receive(frame, self._time(now)):
            link.ignored()

    def ignore(self, bus: str, bits: int, now: float) -> None:
        """Counts a frame of another kind, of so many bits on the wire."""
        self._links[bus].ignored(bits)

    def echoed(self, bus: str, frame: Frame, now: float) -> None:
        """Takes a frame that left this computer; one that is not ours counts as received."""
        time = self._time(now)
        if not self._links[bus].echoed(frame, time):
            self.receive(bus, frame, now)
            return
        if self._commit.under_way:
            self._commit.left(bus, frame, now, time)
        if frame.id == cia301.NMT and (station := self._receptions[bus].stations.get(frame.data[1])) is not None:
            station.runner.check(time)

    def send_failed(self, bus: str, frame: Frame, why: str, now: float) -> None:
        """Notes that a frame of ours was not sent."""
        self._links[bus].send_failed(frame, self._time(now))
        self._commit.send_failed(bus, frame, why)
        if frame == BEAT:
            self._heartbeat.failed(bus)

    def bus_changed(self, bus: str, state: str | None, why: str, errors: tuple[int, int] | None, now: float) -> None:
        """Notes the state of a bus (None: as before) and its error counters (None: as before)."""
        if (fault := self._links[bus].changed(state, why, errors, self._time(now))) is not None:
            self._lose(fault)

    def tick(self, now: float) -> None:
        """Does what time brings; to be called every 10 ms.

        It sends the master's heartbeat, which no other method does: boards of a hanging executor become safe. It ends
        time-outs of SDO transfers, boot and commit, and finds lost boards and stuck buses. A late call alone ends no
        time-out.
        """
        if (fault := self.halted(now)) is not None:
            self._log.report(fault)
        self._now = time = self._time(now)
        self._ticked = now
        for link in self._links.values():
            if (fault := link.tick(time, now)) is not None:
                self._lose(fault)
        self._heartbeat.tick(now, time)
        self._commit.tick(now, time)
        timeout = self._timing.heartbeat_timeout
        for station in self._stations:
            station.board.tick(time, timeout)
            station.runner.tick(time)

    def halted(self, now: float) -> Fault | None:
        """Returns a fault if `tick` was not called for so long that the boards were without their master.

        The states of all boards are unknown from then on, until `boot`. A boot under way begins again instead, without
        a fault. To be called before anything is acted on; `tick` and `commit` look as well.
        """
        if self._halt_reported == self._ticked or (pause := self._heartbeat.halted(now)) is None:
            return None
        self._halt_reported = self._ticked
        if self._booting.under_way:
            self.boot(now)
            return None
        for station in self._stations:
            station.board.ready = False  # what they did meanwhile is unknown
        text = f"the executor was halted for {pause:.2f} s, and the boards were without it: the arm holds"
        return Fault("halted", "executor", text)

    # --- commands

    def boot(self, now: float) -> None:
        """Boots all boards of all buses in parallel; switches no output.

        Boards that are operational and configured as they should be are left alone. It may be called at any time, also
        while booting: then it starts again. Faults so far are forgotten.
        """
        self._log.clear()
        self._commit.forget()
        lost = {name: fault for name, link in self._links.items() if (fault := link.rearm()) is not None}
        self._booting.begin(lost, self._time(now))

    def commit(self, states: int, now: float) -> None:
        """Switches all actuators to `states`, on each bus at one instant: RPDOs, and when all have left, SYNC.

        Nothing is sent if nothing changes. The end shows in `committing`, `commit_failed` and `take_switched`.

        Raises:
            Busy: a commit is under way, or a bus or a board is not up.
            ValueError: not states of this many actuators.
        """
        if not 0 <= states <= self._all:
            raise ValueError(f"states {states:#x} are not of {len(self.board_of)} actuators")
        if (fault := self.halted(now)) is not None:
            self._log.report(fault)
        if self._commit.under_way:
            raise Busy("frames of the commit before are still on their way")
        if not (due := self._outputs.due(states)):
            self._commit.failed = None
            return
        if (refusal := self._refusal()) is not None:
            raise Busy(refusal)
        self._commit.begin(states, due, now, self._time(now))

    def question(self, board: int, now: float) -> None:
        """Asks a board for its inputs by SDO; see `questioning`."""
        if not self._booting.under_way:
            self._stations[board].question(self._time(now))

    def probe_silent(self, now: float) -> None:
        """Asks boards that were lost whether they are back; see `back`. To be called once a second or so."""
        for station in self._stations:
            if not station.board.heard and self._links[station.board.layout.bus].usable:
                station.probe(self._time(now))

    # --- queries

    @property
    def booting(self) -> bool:
        """Whether a boot is under way."""
        return self._booting.under_way

    @property
    def boot_faults(self) -> list[Fault]:
        """Faults of the last boot: one for each board or bus that is not up; empty if all are up."""
        return self._booting.faults

    @property
    def ready(self) -> bool:
        """Whether all boards are up with known states, and all buses are armed."""
        return self._image.known == self._all and all(link.armed for link in self._links.values())

    @property
    def back(self) -> bool:
        """Whether `boot` may succeed: frames leave on all buses, and all boards are heard."""
        fit = all(link.fit(self._now) for link in self._links.values())
        return fit and all(station.board.heard for station in self._stations)

    @property
    def committing(self) -> bool:
        """Whether a commit is under way."""
        return self._commit.under_way

    @property
    def commit_failed(self) -> str | None:
        """Why the last commit failed, as a sentence; None if it did not. Nothing of it is sent later."""
        return self._commit.failed

    @property
    def outputs(self) -> int:
        """States as of the last SYNC that is known to have left, or as read back by `boot`."""
        return self._outputs.states

    @property
    def outputs_known(self) -> bool:
        """Whether `outputs` are known: all boards are up, and no SYNC is on its way."""
        return self._image.known == self._all and not self._commit.unknown

    @property
    def measured(self) -> int:
        """States from the end-stops, else from the outputs; 0 where unknown."""
        image = self._image
        return (image.ends | self._outputs.states & ~self.sensed) & image.known

    @property
    def known(self) -> int:
        """Mask of the actuators whose board is up."""
        return self._image.known

    def questioning(self, board: int) -> bool:
        """Whether a question to a board is neither answered nor timed out."""
        return self._stations[board].questioning

    def take_faults(self) -> list[Fault]:
        """Returns the faults since the last call; each code and source once until the next `boot`."""
        return self._log.take()

    def take_switched(self) -> list[tuple[int, float]]:
        """Returns the switches since the last call: a mask of actuators, and when their SYNC was known to have left."""
        switched, self._switched = self._switched, []
        return switched

    def warnings(self) -> tuple[Fault, ...]:
        """Returns a warning for each bus that is error-passive."""
        return tuple(fault for link in self._links.values() if (fault := link.passive()) is not None)

    def status(self) -> Status:
        """Returns state and counters for diagnostics."""
        return Status(
            buses=tuple(link.status(self._worst_case[name]) for name, link in self._links.items()),
            boards=tuple(station.board.status(self._now) for station in self._stations),
        )

    def _time(self, now: float) -> float:
        """Time that stands still while the loop stalls [s]."""
        if self._ticked is None:
            return self._now
        return self._now + min(max(now - self._ticked, 0.0), _LONGEST_STEP)

    def _refusal(self) -> str | None:
        """Why nothing may be switched, None if it may."""
        for link in self._links.values():
            if not link.armed:
                return f"{link.name} is {link.state} or was lost: nothing is sent until its boards are booted"
        if self._image.known != self._all:
            name = next(s.board.name for s in self._stations if not s.board.ready)
            return f"board {name} is not up: nothing is sent until it is booted"
        return None

    def _note_switched(self, mask: int, clock: float) -> None:
        self._switched.append((mask, clock))

    def _lose(self, fault: Fault) -> None:
        """Takes the fault of a lost bus."""
        for station in self._stations:
            if station.board.layout.bus == fault.source:
                station.cancel()
                station.board.ready = False  # the bus is at fault, not each of its boards
        self._commit.bus_lost(fault.source)
        self._booting.bus_lost(fault)
        self._log.report(fault)

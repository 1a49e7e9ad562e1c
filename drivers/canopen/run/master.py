"""The CANopen master of an arm: takes frames and time; gives frames, states and faults."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from hyperbit.drivers.canopen.boards.board import Board, InputLines
from hyperbit.drivers.canopen.boards.outputs import OutputLines
from hyperbit.drivers.canopen.boot.booting import Booting
from hyperbit.drivers.canopen.faults import ArmFault, FaultLog
from hyperbit.drivers.canopen.layout import lay_out, worst_case
from hyperbit.drivers.canopen.run.error_reads import ErrorReads
from hyperbit.drivers.canopen.run.heartbeat import Heartbeat, LoopClock
from hyperbit.drivers.canopen.run.intruders import find_intruder
from hyperbit.drivers.canopen.run.switching import OutputSwitching
from hyperbit.drivers.canopen.run.verification import InputWatch, Verification
from hyperbit.drivers.canopen.status import MasterStatus
from hyperbit.drivers.canopen.wire import cia301, events
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame, wire_bits
from hyperbit.drivers.canopen.wire.link import Link
from hyperbit.drivers.canopen.wiring import Interlock, Timing, Wiring


class Master:
    """All boards of an arm, on all its buses.

    The master has no I/O, no clock and no threads, and no method blocks. Actuator k is bit k of integers of states and
    of masks. So is line k of outputs and inputs; output lines 0 to A - 1 belong to the A actuators.
    `now` is CLOCK_MONOTONIC [s], or any clock that never goes back. No event raises an exception.
    `send` hands out a frame for a bus, by its name; it must not call the master and never fails. `FrameEchoed` or
    `SendFailed` tell whether the frame was sent, `SendFailed` before the next `tick`.

    Attributes:
        board_of: index of the board with the outputs of each actuator.
        input_boards_of: indices of the boards with the end-stops of each actuator; none without end-stops.
        outputs, inputs: what is known of the lines.
        boards, links: the parts of the arm, by index and by name of the bus.
        switching: commits and releases; tells which are under way, what has switched, and what failed.
        booting: the boot of all boards, and its faults.
        faults: faults since the last `drain`; each code and source once until the next `boot`.
        heartbeat: the master's heartbeat, which tells when it is due next.
        errors: reads of the boards' errors; a boot that is under way ends first.
    """

    def __init__(self, wiring: Wiring, timing: Timing, send: Callable[[str, Frame], None]) -> None:
        layout = lay_out(wiring)
        self.board_of, self.input_boards_of = layout.board_of, layout.input_boards_of
        outputs_of = zip(wiring.channels, wiring.outputs_of, strict=True)
        pulsed = sum(lines for channel, lines in outputs_of if channel.pulse is not None)
        self._timing, self._clock = timing, LoopClock()
        self.faults, self.inputs, self.outputs = FaultLog(), InputLines(), OutputLines(layout, pulsed)
        stuck_after = 0.8 * (timing.heartbeat_timeout - timing.heartbeat)  # before the boards lose the master
        self.links = {bus.name: Link(bus, send, stuck_after) for bus in wiring.buses}
        self._worst_case = {bus.name: worst_case(layout, timing, bus) for bus in wiring.buses}
        self.boards = [
            Board(i, board, self.links[board.bus], self.inputs, self.faults.report)
            for i, board in enumerate(layout.boards)
        ]
        self._by_id = {(board.layout.bus, board.layout.node): board for board in self.boards}
        self.booting = Booting(self.boards, self.outputs, timing)
        links = tuple(self.links.values())
        self.heartbeat = Heartbeat(links, self.boards, timing)
        self._input_watch = InputWatch(self.boards, links, wiring)
        self.switching = OutputSwitching(self.boards, self.links, self.outputs, timing)
        self._verification = Verification(self.boards, self.outputs, self.switching.commits)
        self.errors = ErrorReads(self.boards, self.switching.commits)

    def receive_event(self, event: events.Event, now: float) -> None:
        """Takes an event of a bus."""
        link, time = self.links[event.bus], self._clock.at(now)
        match event:
            case events.FrameReceived(bus, frame):
                link.received(wire_bits(len(frame.data)))
                came = time if event.at is None else min(time, self._clock.at(event.at))
                if not self._receive_frame(bus, frame, came):
                    link.ignored += 1
            case events.FrameEchoed(bus, frame):
                if not (sent := link.echoed(frame, time)):  # another program of this computer has sent it
                    self.receive_event(events.FrameReceived(bus, frame, None), now)
                for each in sent:
                    self.switching.sent(bus, each, now, time)
                    if each.id == cia301.NMT and (board := self._by_id.get((bus, each.data[1]))) is not None:
                        board.runner.check(time)  # its procedure may wait for the NMT command
            case events.FrameIgnored(_, bits):
                link.received(bits)
                link.ignored += 1
            case events.BusChanged(_, state, why, errors):
                if (fault := link.changed(state, why, errors, time)) is not None:
                    self._lose(fault)
            case events.BusOverrun(bus):
                link.overruns += 1
                if not self.booting.under_way:
                    self._input_watch.hurry(bus, time)
            case events.SendFailed(bus, frame, why):
                link.send_failed(frame, time)
                self.switching.send_failed(bus, frame, why)
                self.heartbeat.send_failed(bus, frame)

    def tick(self, now: float) -> None:
        """Sends heartbeats, ends timeouts, and finds lost boards and stuck buses. Call it every 10 ms, see `rest`.

        Only this method sends the master's heartbeat, so that the boards of a hanging executor become safe.
        """
        self._report_pause(now)
        time = self._clock.tick(now)
        for link in self.links.values():
            if (fault := link.tick(time, now)) is not None:
                self._lose(fault)
        self.heartbeat.tick(now, time)
        self.switching.tick(now, time)
        for board in self.boards:
            board.tick(time, self._timing.heartbeat_timeout, self._clock.stalled)
        if not self.booting.under_way:
            self._verification.tick(time)
            self._input_watch.tick(time)
            self.errors.tick(time)

    def rest(self, period: float) -> None:
        """Tells that the next tick comes after `period` [s]; it may be longer than 10 ms while `resting`."""
        self._clock.period = period

    @property
    def resting(self) -> bool:
        """Whether no commit, boot or hurried read is under way, and all buses send: frames may wait for a tick."""
        waits = self.switching.under_way or self.booting.under_way or self.outputs.unread or self.outputs.doubtful
        return not waits and all(link.armed and not link.failing for link in self.links.values())

    def find_pause(self, now: float) -> ArmFault | None:
        """Returns a fault if `tick` was not called for so long that the boards lost their master; each pause once.

        After a pause the states of all boards are unknown until `boot`. A running boot begins again, without a fault.
        Call this before any event is handled. `tick`, `commit` and `release` check it as well, and report it.
        """
        if (fault := self.heartbeat.find_pause(now)) is None:
            return None
        self._forget(self.boards)  # their states are unknown after the pause
        if self.booting.under_way:
            self.boot(now)
            return None
        return fault

    def boot(self, now: float) -> None:
        """Boots all boards of all buses in parallel; switches no output.

        Correctly configured boards are not written to. A running boot begins again. Earlier faults are forgotten.
        """
        time = self._clock.at(now)
        self.faults.clear()
        self.switching.forget()
        self._verification.begin()
        self._input_watch.begin(time)
        lost = {name: fault for name, link in self.links.items() if (fault := link.rearm()) is not None}
        self.booting.begin(lost, time)

    def commit(self, outputs: int, now: float) -> None:
        """Switches output lines to `outputs`; `switching` tells the result.

        Raises:
            Busy: frames of the last commit were not sent yet, or a bus or a board is not ready.
            ValueError: `outputs` has a bit that is no line.
        """
        self._report_pause(now)
        self.switching.commit(outputs, now, self._clock.at(now))

    def release(self, off: int, now: float) -> None:
        """Switches output lines off, in every state of boards and buses, see `OutputSwitching.release`."""
        self._report_pause(now)
        self.switching.release(off, now, self._clock.at(now))

    def question(self, board: int, now: float) -> None:
        """Asks a board for its inputs by SDO; see `Board.questioning`."""
        if not self.booting.under_way:
            self.boards[board].question(self._clock.at(now))

    def probe_silent(self, now: float) -> None:
        """Asks lost boards whether they are back; see `back`. Call about once a second."""
        for board in self.boards:
            if not board.heard and board.link.usable:
                board.probe(self._clock.at(now))

    @property
    def back(self) -> bool:
        """Whether `boot` may succeed: all buses send, and all boards are heard."""
        fit = all(link.fit(self._clock.now) for link in self.links.values())
        return fit and all(board.heard for board in self.boards)

    @property
    def calm(self) -> bool:
        """Whether no commit, boot, read or question is under way. Only then can the master be pickled."""
        waits = self.switching.under_way or self.booting.under_way
        return not (waits or any(board.runner.running for board in self.boards))

    @property
    def outputs_known(self) -> bool:
        """Whether `outputs.commanded` is known: all boards are ready, and no SYNC is being sent."""
        return not self.switching.unknown and all(board.ready for board in self.boards)

    def unanswered(self, lock: Interlock) -> str | None:
        """Returns why the object of an interlock is unknown, so that it counts as open; None: it is known."""
        return self._by_id[lock.bus, lock.node].unread.get(lock.watched) if lock.watched else None

    def warnings(self) -> tuple[ArmFault, ...]:
        """Returns the warnings: error-passive buses; limits of boards, and outputs written off before the start."""
        passive = tuple(fault for link in self.links.values() if (fault := link.passive()) is not None)
        boards = [board for board in self.boards if board.ready]
        limits = (
            ArmFault("board-limits", b.name, f"board {b.name}: {'; '.join(b.warnings)}") for b in boards if b.warnings
        )
        text = "outputs may have been switched off by the board; written off before start"
        released = (ArmFault("outputs-off", b.name, f"{b.name}: {text}") for b in boards if b.released)
        return (*passive, *limits, *released)

    def status(self) -> MasterStatus:
        return MasterStatus(
            buses=tuple(link.status(self._worst_case[name]) for name, link in self.links.items()),
            boards=tuple(board.status(self._clock.now) for board in self.boards),
        )

    def _receive_frame(self, bus: str, frame: Frame, time: float) -> bool:
        """Takes a frame of another node; returns whether it was understood."""
        cob_id, data = frame
        if (fault := find_intruder(bus, frame, is_rpdo=(bus, cob_id) in self.outputs.frames)) is not None:
            self.faults.report(fault)
            if cob_id == cia301.NMT and len(data) == 2:
                self._obey(bus, data[0], data[1], time)
            return True
        board = self._by_id.get((bus, cob_id & 0x7F))
        if board is None or not 0 <= cob_id <= 0x7FF:
            return False
        boots = board.boots
        understood = board.receive_frame(cob_id, data, time)
        if board.boots != boots:
            self.booting.rebooted(board, time)
        elif cob_id & ~0x7F == cia301.HEARTBEAT:
            self.heartbeat.answered(board, time)
        board.runner.check(time)
        return understood

    def _obey(self, bus: str, command: int, node: int, time: float) -> None:
        """Takes another program's NMT command to a node, or to all nodes of a bus: 0."""
        here = [board for board in self.boards if board.layout.bus == bus]
        for each in (board for board in here if node in (0, board.layout.node)):
            each.obey(command)
            if command == Command.START:  # the pins now match 6200h, so its boot begins again
                self.booting.rebooted(each, time)

    def _report_pause(self, now: float) -> None:
        if (fault := self.find_pause(now)) is not None:
            self.faults.report(fault)

    def _lose(self, fault: ArmFault) -> None:
        self._forget(b for b in self.boards if b.layout.bus == fault.source)  # one fault for the bus, not for each
        self.switching.bus_lost(fault.source)
        self.booting.bus_lost(fault)
        self.faults.report(fault)

    def _forget(self, boards: Iterable[Board]) -> None:
        """Marks the states of boards as unknown until their boot."""
        for board in boards:
            board.cancel()
            board.ready, board.held = False, None

"""The CANopen master of an arm: takes frames and time; gives frames, states and faults."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.drivers.canopen.boot.booting import Booting
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.boards import Boards
from hyperbit.drivers.canopen.run.heartbeat import Heartbeat, LoopClock
from hyperbit.drivers.canopen.run.input_watch import InputWatch
from hyperbit.drivers.canopen.run.switching import OutputSwitching
from hyperbit.drivers.canopen.run.verification import Verification
from hyperbit.drivers.canopen.status import MasterStatus
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import (
    BusChanged,
    BusOverrun,
    Event,
    FrameEchoed,
    FrameIgnored,
    FrameReceived,
    SendFailed,
)
from hyperbit.drivers.canopen.wire.link import BITS
from hyperbit.drivers.canopen.wiring import Timing, Wiring


class Master:
    """All boards of an arm, on all its buses.

    The master has no I/O, no clock and no threads, and no method blocks. Actuator k is bit k of integers of states and
    of masks. So is line k of outputs and inputs; output lines 0 to A - 1 belong to the A actuators.
    `now` is CLOCK_MONOTONIC [s], or any clock that never goes back. No event raises an exception.

    Args:
        wiring: buses, boards and actuators.
        timing: times of boards and actuators.
        send: hands out a frame for a bus, by its name; must not call the master and never fails. `FrameEchoed` or
            `SendFailed` tell whether the frame was sent, `SendFailed` before the next `tick`.

    Attributes:
        board_of: index of the board with the outputs of each actuator.
        input_boards_of: indices of the boards with the end-stops of each actuator; none without end-stops.
        boards: name of each board, e.g. "can0/5".
        sensed: mask of the actuators that have an end-stop.
    """

    def __init__(self, wiring: Wiring, timing: Timing, send: Callable[[str, Frame], None]) -> None:
        self._boards = boards = Boards(wiring, timing, send)
        self.board_of = boards.layout.board_of
        self.input_boards_of = boards.layout.input_boards_of
        self.boards = tuple(board.name for board in boards.layout.boards)
        self.sensed = boards.sensed
        self._links, self._clock, self._timing = boards.links, LoopClock(), timing
        self._booting = Booting(boards.stations, boards.outputs, wiring, timing)
        self._receptions = boards.receptions(self._booting.rebooted)
        self._heartbeat = Heartbeat(boards.links.values(), boards.stations, timing)
        interlocks = sum(1 << line for line in wiring.interlock_lines)
        self._inputs = InputWatch(boards.stations, boards.links.values(), interlocks)
        self._switching = OutputSwitching(boards, self._booting, timing.heartbeat_timeout / 2)
        self._verification = Verification(boards, self._switching)

    def receive_event(self, event: Event, now: float) -> None:
        """Takes an event of a bus."""
        link, time = self._links[event.bus], self._clock.at(now)
        match event:
            case FrameReceived(bus, frame):
                link.received(BITS[min(len(frame.data), 8)])
                if not self._receptions[bus].receive_frame(frame, time):
                    link.ignored += 1
            case FrameEchoed(bus, frame):
                if not (sent := link.echoed(frame, time)):  # another program of this computer has sent it
                    self.receive_event(FrameReceived(bus, frame, None), now)
                for each in sent:
                    self._switching.sent(bus, each, now, time)
                    self._receptions[bus].echoed(each, time)
            case FrameIgnored(_, bits):
                link.received(bits)
                link.ignored += 1
            case BusChanged(_, state, why, errors):
                if (fault := link.changed(state, why, errors, time)) is not None:
                    self._lose(fault)
            case BusOverrun(bus):
                link.overruns += 1
                if not self._booting.under_way:
                    self._inputs.hurry(bus, time)
            case SendFailed(bus, frame, why):
                link.send_failed(frame, time)
                self._switching.send_failed(bus, frame, why)
                self._heartbeat.send_failed(bus, frame)

    def tick(self, now: float) -> None:
        """Sends heartbeats, ends timeouts, and finds lost boards and stuck buses. Call every 10 ms.

        Only this method sends the master's heartbeat, so that the boards of a hanging executor become safe.
        """
        self._report_pause(now)
        time = self._clock.tick(now)
        for link in self._links.values():
            if (fault := link.tick(time, now)) is not None:
                self._lose(fault)
        self._heartbeat.tick(now, time)
        self._switching.tick(now, time)
        self._boards.tick(time, self._timing.heartbeat_timeout, self._clock.stalled)
        if not self._booting.under_way:
            self._verification.tick(time)
            self._inputs.tick(time)

    def find_pause(self, now: float) -> ArmFault | None:
        """Returns a fault if `tick` was not called for so long that the boards lost their master; each pause once.

        After a pause the states of all boards are unknown until `boot`. A running boot begins again, without a fault.
        Call this before any event is handled. `tick` and `commit` check it as well, and report to `drain_faults`.
        """
        if (fault := self._heartbeat.find_pause(now)) is None:
            return None
        self._boards.forget()  # the boards' states are unknown after the pause
        if self._booting.under_way:
            self.boot(now)
            return None
        return fault

    def boot(self, now: float) -> None:
        """Boots all boards of all buses in parallel; switches no output.

        Correctly configured boards are not written to. A running boot begins again. Earlier faults are forgotten.
        """
        self._boards.log.clear()
        self._switching.forget()
        self._verification.begin()
        self._inputs.begin(self._clock.at(now))
        self._booting.begin(self._boards.rearm(), self._clock.at(now))

    def commit(self, outputs: int, now: float, release: bool = False) -> None:
        """Switches output lines. `committing`, `commit_failed` and `drain_switched` tell the result.

        Args:
            outputs: levels of all lines.
            now: see above.
            release: only switch lines off, see `OutputSwitching.release`; otherwise see `OutputSwitching.commit`.

        Raises:
            Busy: a commit is running, or a bus or a board is not ready.
            ValueError: `outputs` has a bit that is no line.
        """
        self._report_pause(now)
        switch = self._switching.release if release else self._switching.commit
        switch(outputs, now, self._clock.at(now))

    def give_up(self, why: str) -> None:
        """Gives up a commit, see `OutputSwitching.give_up`; only the lines of `leaving` still switch."""
        self._switching.give_up(why)

    def question(self, board: int, now: float) -> None:
        """Asks a board for its inputs by SDO; see `questioning`."""
        if not self._booting.under_way:
            self._boards.stations[board].question(self._clock.at(now))

    def probe_silent(self, now: float) -> None:
        """Asks lost boards whether they are back; see `back`. Call about once a second."""
        self._boards.probe_silent(self._clock.at(now))

    @property
    def booting(self) -> bool:
        """Whether a boot is running."""
        return self._booting.under_way

    @property
    def boot_faults(self) -> list[ArmFault]:
        """Faults of the last boot: one for each board or bus that is not ready."""
        return self._booting.faults

    @property
    def ready(self) -> bool:
        """Whether all boards are ready, and all buses are armed."""
        return self._boards.ready

    @property
    def back(self) -> bool:
        """Whether `boot` may succeed: all buses send, and all boards are heard."""
        return self._boards.back(self._clock.now)

    @property
    def calm(self) -> bool:
        """Whether no commit, boot, read or question is under way. Only then the master can be pickled."""
        return not (self.committing or self.booting) and not any(s.runner.running for s in self._boards.stations)

    @property
    def committing(self) -> bool:
        """Whether a commit is running."""
        return self._switching.under_way

    @property
    def collecting(self) -> bool:
        """Whether the commit still waits for the echo of RPDOs; only the last of them changes anything."""
        return self._switching.collecting

    @property
    def leaving(self) -> int:
        """Mask of the lines that frames already handed out will switch: SYNCs, and RPDOs of boards without SYNC."""
        return self._switching.leaving

    @property
    def commit_failed(self) -> str | None:
        """Why the last commit failed, as a sentence; None after a success. Nothing of it is sent later."""
        return self._switching.failed

    @property
    def outputs(self) -> int:
        """Levels of the output lines after the last SYNC that was sent, or as read back by `boot`."""
        return self._boards.outputs.states

    @property
    def doubtful(self) -> int:
        """Mask of the output lines that may be on, see `OutputLines.doubtful`."""
        return self._boards.outputs.doubtful

    @property
    def released(self) -> int:
        """Mask of the output lines whose pulse has ended, and was not read back off."""
        return self._verification.released

    @property
    def unread(self) -> int:
        """Mask of the output lines that were switched and not read back, and that no end-stop tells of."""
        return self._verification.unread

    @property
    def outputs_known(self) -> bool:
        """Whether `outputs` are known: all boards are ready, and no SYNC is being sent."""
        return self._boards.all_known and not self._switching.unknown

    @property
    def ends(self) -> int:
        """Levels of the input lines; 0 where unknown."""
        return self._boards.image.ends & self._boards.image.up

    @property
    def inputs_known(self) -> int:
        """Mask of the input lines whose board is ready."""
        return self._boards.image.up

    @property
    def boots(self) -> tuple[int, ...]:
        """Number of boot-up messages of each board so far."""
        return tuple(station.board.boots for station in self._boards.stations)

    @property
    def known(self) -> int:
        """Mask of the actuators whose boards are all ready: that of the outputs and those of the end-stops."""
        return self._boards.image.known

    def questioning(self, board: int) -> bool:
        """Returns whether a question to a board still waits for its answer."""
        return self._boards.stations[board].questioning

    def drain_faults(self) -> list[ArmFault]:
        """Returns the faults since the last call; each code and source once until the next `boot`."""
        return self._boards.log.drain()

    def drain_switched(self) -> list[tuple[int, float]]:
        """Returns the switches since the last call: mask of lines, and time when their SYNC was known as sent [s]."""
        switched = list(self._switching.switched)
        self._switching.switched.clear()
        return switched

    def drain_missed(self) -> int:
        """Returns the output lines without end-stops whose pulse was over before it was read, since the last call."""
        return self._verification.drain_missed()

    def warnings(self) -> tuple[ArmFault, ...]:
        """Returns the warnings of buses and boards."""
        return self._boards.warnings()

    def status(self) -> MasterStatus:
        """Returns state and counters for diagnostics."""
        return self._boards.status(self._clock.now)

    def _report_pause(self, now: float) -> None:
        if (fault := self.find_pause(now)) is not None:
            self._boards.log.report(fault)

    def _lose(self, fault: ArmFault) -> None:
        self._boards.forget(fault.source)  # one fault for the bus, not one for each board
        self._switching.bus_lost(fault.source)
        self._booting.bus_lost(fault)
        self._boards.log.report(fault)

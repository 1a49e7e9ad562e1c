"""The CANopen master of an arm: frames and time in; frames, actuator states and faults out."""

from __future__ import annotations

from collections.abc import Callable

from drivers.canopen import cia301
from drivers.canopen.booting import Booting
from drivers.canopen.cia301 import Frame
from drivers.canopen.commit import Commit
from drivers.canopen.events import Changed, Echoed, Event, Ignored, Received
from drivers.canopen.faults import Busy, Fault
from drivers.canopen.heartbeat import BEAT, Heartbeat, LoopClock
from drivers.canopen.load import BITS
from drivers.canopen.network import Network
from drivers.canopen.reception import receptions
from drivers.canopen.status import Status
from drivers.canopen.verification import Verification
from drivers.canopen.wiring import Timing, Wiring


class Master:
    """All boards of an arm, on all its buses.

    It has no I/O, no clock and no threads, and nothing waits. Actuator k is bit k of an integer of states or of a mask;
    so is line k of outputs and inputs. Without `output_off`, output line k is actuator k.
    `now` is CLOCK_MONOTONIC [s], or any clock that never goes back. No event raises.

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
        self._network = network = Network(wiring, timing, send)
        self.board_of = network.layout.board_of
        self.boards = tuple(board.name for board in network.layout.boards)
        self.sensed = network.sensed
        self._links, self._clock, self._timing = network.links, LoopClock(), timing
        self._booting = Booting(network.stations, network.outputs, wiring, timing)
        self._receptions = receptions(network, self._booting.rebooted)
        self._heartbeat = Heartbeat(network.links.values(), network.stations, timing)
        self._verification = Verification(network)
        self._commit = Commit(network.links, network.outputs, self._verification.switched, timing.heartbeat_timeout / 2)
        self._halt_reported: float | None = None  # real time of the last tick before a halt

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
        link.received(BITS[min(len(frame.data), 8)])
        if not self._receptions[bus].receive(frame, self._clock.at(now)):
            link.ignored()

    def ignore(self, bus: str, bits: int, now: float) -> None:
        """Counts a frame of another kind, of so many bits on the wire."""
        self._links[bus].received(bits)
        self._links[bus].ignored()

    def echoed(self, bus: str, frame: Frame, now: float) -> None:
        """Takes a frame that left this computer; one that is not ours counts as received."""
        time = self._clock.at(now)
        if not self._links[bus].echoed(frame, time):
            self.receive(bus, frame, now)
            return
        if self._commit.under_way:
            self._commit.left(bus, frame, now, time)
        if frame.id == cia301.NMT and (station := self._receptions[bus].stations.get(frame.data[1])) is not None:
            station.runner.check(time)

    def send_failed(self, bus: str, frame: Frame, why: str, now: float) -> None:
        """Notes that a frame of ours was not sent."""
        self._links[bus].send_failed(frame, self._clock.at(now))
        self._commit.send_failed(bus, frame, why)
        if frame == BEAT:
            self._heartbeat.failed(bus)

    def bus_changed(self, bus: str, state: str | None, why: str, errors: tuple[int, int] | None, now: float) -> None:
        """Notes the state of a bus (None: as before) and its error counters (None: as before)."""
        if (fault := self._links[bus].changed(state, why, errors, self._clock.at(now))) is not None:
            self._lose(fault)

    def tick(self, now: float) -> None:
        """Does what time brings; to be called every 10 ms.

        Only this method sends the master's heartbeat: boards of a hanging executor become safe. It ends time-outs, and
        finds lost boards and stuck buses. A late call alone ends no time-out.
        """
        self._look_halted(now)
        time = self._clock.tick(now)
        for link in self._links.values():
            if (fault := link.tick(time, now)) is not None:
                self._lose(fault)
        self._heartbeat.tick(now, time)
        self._commit.tick(now, time)
        self._network.tick(time, self._timing.heartbeat_timeout)
        if not self._booting.under_way:
            self._verification.tick(time)

    def halted(self, now: float) -> Fault | None:
        """Returns a fault if `tick` was not called for so long that the boards were without their master.

        The states of all boards are unknown then until `boot`; a boot under way begins again instead, without a fault.
        To be called before anything is acted on; `tick` and `commit` look as well, and report it in `take_faults`.
        """
        if self._halt_reported == self._clock.ticked or (pause := self._heartbeat.halted(now)) is None:
            return None
        self._halt_reported = self._clock.ticked
        if self._booting.under_way:
            self.boot(now)
            return None
        self._network.forget()  # what the boards did meanwhile is unknown
        text = f"the executor was halted for {pause:.2f} s, and the boards were without it: the arm holds"
        return Fault("halted", "executor", text)

    def boot(self, now: float) -> None:
        """Boots all boards of all buses in parallel; switches no output.

        Boards that are operational and rightly configured are left alone. A boot under way begins again. Faults so far
        are forgotten.
        """
        self._network.log.clear()
        self._commit.forget()
        self._verification.begin()
        self._booting.begin(self._network.rearm(), self._clock.at(now))

    def commit(self, outputs: int, now: float, release: bool = False) -> None:
        """Switches all output lines to `outputs`, on each bus at one instant: RPDOs, and when all have left, SYNC.

        Nothing is sent if nothing changes. The end shows in `committing`, `commit_failed` and `take_switched`. The
        first commit since a boot ends when boards without end-stops were read back.

        Args:
            outputs: levels of all lines.
            now: see above.
            release: only switches lines off, also of boards that are not up; a commit whose RPDOs wait is given up.

        Raises:
            Busy: a commit is under way, or a bus or a board is not up.
            ValueError: a bit of `outputs` is no line's.
        """
        self._look_halted(now)
        if release and self._booting.under_way:  # a board that has started anew would take over what it had before
            raise Busy("the boards are being booted")
        if release:
            self._commit.give_up("an output had to be switched off first")
        if self._commit.under_way:
            raise Busy("frames of the commit before are still on their way")
        if self._verification.blocking and not release:
            raise Busy("the boards are asked whether they have switched")
        lines = self._network.outputs.states ^ outputs if release else None
        due = self._network.outputs.due(outputs, only_changed=release)
        self._verification.failed = None
        if not due:
            self._commit.failed = None
            return
        if (refusal := self._network.refusal(lines)) is not None:
            raise Busy(refusal)
        frames = {bus: self._network.frames_of(bus, keys, lines) for bus, keys in due.items()}
        self._commit.begin(outputs, frames, lambda: self._network.refusal(lines), now, self._clock.at(now))

    def question(self, board: int, now: float) -> None:
        """Asks a board for its inputs by SDO; see `questioning`."""
        if not self._booting.under_way:
            self._network.stations[board].question(self._clock.at(now))

    def probe_silent(self, now: float) -> None:
        """Asks boards that were lost whether they are back; see `back`. To be called once a second or so."""
        self._network.probe_silent(self._clock.at(now))

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
        return self._network.ready

    @property
    def back(self) -> bool:
        """Whether `boot` may succeed: frames leave on all buses, and all boards are heard."""
        return self._network.back(self._clock.now)

    @property
    def committing(self) -> bool:
        """Whether a commit is under way."""
        return self._commit.under_way or bool(self._verification.blocking)

    @property
    def collecting(self) -> bool:
        """Whether the commit waits for RPDOs to leave: the next that leaves brings no news but the last."""
        return self._commit.collecting

    @property
    def commit_failed(self) -> str | None:
        """Why the last commit failed, as a sentence; None if it did not. Nothing of it is sent later."""
        return self._commit.failed or self._verification.failed

    @property
    def outputs(self) -> int:
        """Levels of the output lines as of the last SYNC that is known to have left, or as read back by `boot`."""
        return self._network.outputs.states

    @property
    def outputs_known(self) -> bool:
        """Whether `outputs` are known: all boards are up, and no SYNC is on its way."""
        return self._network.all_known and not self._commit.unknown

    @property
    def ends(self) -> int:
        """Levels of the input lines; 0 where unknown."""
        return self._network.image.ends & self._network.image.up

    @property
    def inputs_known(self) -> int:
        """Mask of the input lines whose board is up."""
        return self._network.image.up

    @property
    def boots(self) -> tuple[int, ...]:
        """Boot-up messages heard of each board so far."""
        return tuple(station.board.boots for station in self._network.stations)

    @property
    def measured(self) -> int:
        """States of plain actuators from the end-stops, else from the outputs; 0 where unknown."""
        return self._network.measured

    @property
    def known(self) -> int:
        """Mask of the actuators whose board is up."""
        return self._network.image.known

    def questioning(self, board: int) -> bool:
        """Whether a question to a board is neither answered nor timed out."""
        return self._network.stations[board].questioning

    def take_faults(self) -> list[Fault]:
        """Returns the faults since the last call; each code and source once until the next `boot`."""
        return self._network.log.take()

    def take_switched(self) -> list[tuple[int, float]]:
        """Returns the switches since the last call: a mask of lines, and when their SYNC was known to have left."""
        switched, self._commit.switched = self._commit.switched, []
        return switched

    def warnings(self) -> tuple[Fault, ...]:
        """Returns a warning for each bus that is error-passive, and what is to be known of boards."""
        passive = tuple(fault for link in self._links.values() if (fault := link.passive()) is not None)
        return passive + self._network.warnings()

    def status(self) -> Status:
        """Returns state and counters for diagnostics."""
        return self._network.status(self._clock.now)

    def _look_halted(self, now: float) -> None:
        if (fault := self.halted(now)) is not None:
            self._network.log.report(fault)

    def _lose(self, fault: Fault) -> None:
        """Takes the fault of a lost bus."""
        self._network.forget(fault.source)  # the bus is at fault, not each of its boards
        self._commit.bus_lost(fault.source)
        self._booting.bus_lost(fault)
        self._network.log.report(fault)

"""The world of an executor: one clock, its buses, boards and clients, and faults of them all, drawn from one seed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from random import Random

from controller.executor.events import Client
from controller.program import Up, unpack
from drivers.canopen import cia301
from drivers.canopen.cia301 import Frame, State
from drivers.canopen.events import Event
from drivers.simulation.buses import SimulatedBuses
from tests.simulation.agenda import Agenda
from tests.simulation.arms import draw_arm
from tests.simulation.bus_model import BusModel
from tests.simulation.invariants import INVARIANTS, Violation, require
from tests.simulation.planner import ScriptedPlanner
from tests.simulation.process import ExecutorProcess
from tests.simulation.record import Commit, Record, Step, Switch
from tests.simulation.trouble import LONGEST_STALL, Trouble

PATIENCE = 4.0  # [s] beyond the boards' boot time until the arm is ready after all trouble


class World:
    """One arm, its executor, its boards and its clients.

    Attributes:
        agenda: time and events.
        record: what happened.
        trouble: faults.

    Args:
        seed: of everything that is drawn.
        remembered: events that are kept for a person to read.
    """

    def __init__(self, seed: int, remembered: int = 200) -> None:
        random = Random(seed)
        self.arm = draw_arm(random)
        self.agenda = Agenda()
        self.record = Record(self.arm, self.agenda)
        self.events: deque[tuple[float, object]] = deque(maxlen=remembered)
        self.most = len(self.arm.actuators) if self.arm.inrush is None else self.arm.inrush
        self.buses = {
            bus.name: BusModel(bus.name, bus.bitrate, self.agenda, Random(seed + k), self._to_boards, self._to_executor)
            for k, bus in enumerate(self.arm.wiring.buses, 1)
        }
        self.boards = SimulatedBuses(self.arm.wiring, self.arm.timing, self._from_board)
        self.executor = ExecutorProcess(self.arm, self.agenda, Random(seed + 3), self.buses, self._to_client, self)
        self.planner = ScriptedPlanner(self.arm, self.agenda, Random(seed + 4), self.executor)
        self.trouble = Trouble(self, Random(seed + 5))
        self.epoch_before, self.mode_before = 0, "starting"
        self.boards_silent = False
        self._random = Random(seed + 6)
        self._drives = 0
        self._masks = {
            bus: sum(1 << k for k, channel in enumerate(self.arm.wiring.channels) if channel.bus == bus)
            for bus in self.buses
        }
        self._timer = float("inf")
        self._counts: list[int] = []
        self._actuators = self._actuators_by_board()
        self._step_boards()
        self.executor.start()

    # --- it runs

    def run(self, steps: int) -> None:
        """Goes on for so many steps, in turns with trouble and without.

        Raises:
            Violation: something does not hold.
        """
        end = self.agenda.steps + steps
        self._calm()
        while self.agenda.steps < end:
            self.planner.be_calm(False)
            self.trouble.begin()
            self._pass(self._random.uniform(2.0, 15.0))
            self._calm()

    def _pass(self, seconds: float) -> None:
        until = self.agenda.now + seconds
        while self.agenda.now < until:
            self._step()

    def _step(self) -> None:
        self.record.step = Step()
        self.epoch_before, self.mode_before = self.record.epoch, self.record.mode
        self.agenda.step()
        for holds in INVARIANTS:
            holds(self)

    def _calm(self) -> None:
        """Ends all trouble; the arm becomes ready, runs a program, and everything agrees."""
        self.trouble.end()
        self.planner.be_calm(True)
        self._wait(lambda: self.executor.awake and self.planner.awake, "awake", LONGEST_STALL)
        key = self._ask_for_motion()
        if not self.record.programs[key].final:
            self.planner.die()
        self._wait(lambda: key in self.record.results, f"at the end of program {key[1]}", 30.0)
        self._wait(self._settled, "ready", self.arm.timing.boot_timeout + PATIENCE)
        self._check_agreement()

    def _ask_for_motion(self) -> tuple[int, int]:
        """Has the planner ask for a program, again if the first was planned from an old snapshot; returns its key."""
        for _ in range(3):
            self._wait(self._settled, "ready", self.arm.timing.boot_timeout + PATIENCE)
            key = self.record.instance, self.planner.ask_for_motion()
            self._pass(0.1)
            if key in self.record.programs:
                return key
        raise Violation(f"program {key[1]} was not accepted")

    def _wait(self, holds: Callable[[], bool], text: str, patience: float) -> None:
        until = self.agenda.now + patience
        while not holds():
            snapshot = self.planner.snapshot
            shown = snapshot and (snapshot.mode, snapshot.reason, snapshot.faults)
            require(self.agenda.now < until, f"it is not {text} after {patience:g} s: {shown}")
            self._step()

    def _settled(self) -> bool:
        snapshot = self.planner.snapshot
        if snapshot is None or snapshot.mode != "ready" or snapshot.moving or not self.executor.awake:
            return False
        return not unpack(snapshot.locked) & ~self.arm.locked

    def _check_agreement(self) -> None:
        """Compares the last snapshot, the boards, the journal and the results."""
        snapshot, record = self.planner.snapshot, self.record
        assert snapshot is not None
        drives, outputs = self.drives(), unpack(snapshot.outputs)
        agree = (drives ^ outputs) & ~record.suspect == 0
        require(agree, f"the boards drive {drives:b}, the executor says {outputs:b}")
        positions = sum(round(p) << k for k, p in enumerate(self.boards.positions()))
        sensed, measured = unpack(snapshot.sensed), unpack(snapshot.measured)
        require((positions ^ measured) & sensed == 0, f"the actuators are at {positions:b}, measured is {measured:b}")
        accepted = {key for key in record.programs if key[0] == record.instance}
        without = sorted(number for key in accepted - set(record.results) for number in key[1:])
        require(not without, f"programs {without} have no result")
        require(self.intended == 0, "the journal waits for nothing")

    # --- the executor's surroundings

    def _to_executor(self, event: Event) -> None:
        self.executor.post(event)

    def _to_client(self, client: Client, message: Up) -> None:
        self.planner.deliver(client, message)

    def _from_board(self, bus: str, frame: Frame) -> None:
        self.buses[bus].from_board(frame)

    def _to_boards(self, bus: str, frame: Frame, lost: bool) -> None:
        self.note(("boards hear", bus, frame, "lost" if lost else ""))
        missing = 0
        for name, mask in self._actuators.items():
            board = self.boards.board(name)
            if name.split("/")[0] == bus and (lost or board.silent or board.state != State.OPERATIONAL):
                missing |= mask
        commit = self.record.arrives(bus, frame, missing)
        if not lost:
            self.boards.step(self.agenda.now)
            self._see("time")
            self.boards.receive(bus, frame, self.agenda.now)
            self._see("SYNC" if frame.id == cia301.SYNC else f"frame {frame.id:03X}h", commit)
            self._set_timer()

    # --- the boards

    def fault(self, verb: str, name: str, *numbers: float) -> None:
        """Causes a fault of a board or an actuator, or ends one."""
        self._step_boards()
        if verb == "power_on" and self.boards.board(name).state is not None:
            return
        getattr(self.boards, verb)(name, *numbers)
        self._see("fault")
        self._set_timer()
        self._look_for_silence()

    def emergency(self, board: str, code: int) -> None:
        """Has a board send an emergency."""
        self.boards.board(board)._send_emergency(code.to_bytes(2, "little") + bytes([1, 0, 0, 0, 0, 0]))

    def drives(self) -> int:
        """Whether each actuator's drive is on, as a mask."""
        return sum(drive << k for k, drive in enumerate(self.boards.drives()))

    def _actuators_by_board(self) -> dict[str, int]:
        masks: dict[str, int] = {}
        for k, channel in enumerate(self.arm.wiring.channels):
            name = f"{channel.bus}/{channel.node}"
            masks[name] = masks.get(name, 0) | 1 << k
        return masks

    def _look_for_silence(self) -> None:
        self.boards_silent = any(self.boards.board(name).silent for name in self._actuators)

    def _step_boards(self) -> None:
        self.boards.step(self.agenda.now)
        self._see("time")
        self._set_timer()

    def _set_timer(self) -> None:
        due = self.boards.next_due()
        if due < self._timer - 1e-12:
            self._timer = due
            self.agenda.at(due, lambda: self._timer_rings(due))

    def _timer_rings(self, due: float) -> None:
        if due == self._timer:
            self._timer = float("inf")
            self._step_boards()

    def _see(self, cause: str, commit: Commit | None = None) -> None:
        """Compares the outputs with those of before."""
        after = self.drives()
        changed, self._drives = after ^ self._drives, after
        for bus, here in self._masks.items():
            if changed & here:
                self.note(("switched", f"{changed & here:b} -> {after:b}", cause))
                self.record.switch(Switch(changed & here, after, cause, bus, commit), self.intended)

    # --- for trouble

    def stall(self, seconds: float) -> None:
        """Lets the executor stand still [s]."""
        self.executor.stall(seconds)

    def restart(self) -> None:
        """Starts the executor, if it is dead."""
        self.executor.start()

    def mend(self) -> None:
        """Ends all faults at once."""
        for bus in self.buses.values():
            bus.restore()
        for name in self._actuators:
            self.fault("power_on", name)
            self.fault("unsilence", name)
        for label in self.arm.actuators:
            self.fault("release", label)
            self.fault("slow", label, 1)
            self.fault("restore_sensor", label)
        self.executor.recover()

    # --- what the invariants ask, and a person

    @property
    def intended(self) -> int:
        """Mask of the switches that the journal has noted and not counted yet."""
        return self.executor.journal._intended

    def journal_changed(self) -> bool:
        """Whether the journal's counts have changed since the last call."""
        before, self._counts = self._counts, list(self.executor.journal.counts)
        return before != self._counts

    def note(self, event: object) -> None:
        """Keeps an event for a person to read."""
        self.events.append((self.agenda.now, event))

    def story(self) -> str:
        """Returns the last events, a line each."""
        return "\n".join(f"{time - 1000:.6f} {event}" for time, event in self.events)

    # --- what the executor does; see `process.Witness`

    def started(self) -> None:
        self.note("the executor starts")
        self.record.started()

    def killed(self) -> None:
        self.note("the executor is killed")
        self.record.killed()
        self.planner.cut_off()

    def told(self, event: Event) -> None:
        self.note(("executor takes", event))
        self.record.told(event)

    def sends(self, bus: str, frame: Frame) -> None:
        self.record.sends(bus, frame)

    def refused(self, bus: str, frame: Frame) -> None:
        self.record.refused(bus, frame)

    def says(self, message: Up) -> None:
        self.note(("executor says", message))
        self.record.says(message)

    def logs(self, level: int, text: str) -> None:
        self.note(("executor logs", text))
        self.record.logs(level, text)


__all__ = ["Violation", "World"]

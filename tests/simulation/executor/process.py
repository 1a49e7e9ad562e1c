"""The executor's process: its event loop, its end and its next start."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from random import Random

from controller.executor.core.arm import ExecutedArm
from controller.executor.core.core import Executor
from controller.executor.core.events import (
    Action,
    ClientGone,
    ClientId,
    Event,
    ExecutorTick,
    FromClient,
    SendFrame,
    ToClient,
)
from controller.executor.process.switch_journal import MemoryJournal
from controller.flight_recorder import FlightRecorder
from controller.host.process import Log, Notify, Quit
from controller.program import TICK, Up
from drivers.canopen.wire.cia301 import Frame
from drivers.canopen.wire.events import BusChanged, SendFailed
from tests.simulation.agenda import Agenda
from tests.simulation.buses.bus_model import BusModel

WAKE_UP = 0.0002  # [s], longest wake-up time of a process that is not stalled


class Witness:
    """Sees what an executor takes and does; by default it sees nothing."""

    def started(self) -> None:
        """Is called after the start of a process."""

    def killed(self) -> None:
        """Is called after the end of a process."""

    def told(self, event: Event) -> None:
        """Is called before an event is handled."""

    def sends(self, bus: str, frame: Frame) -> object:
        """Called before a frame is handed out; returns the commit of the frame."""

    def says(self, message: Up) -> None:
        """Is called before a message to a client is sent."""

    def logs(self, level: int, text: str) -> None:
        """Is called with each line of the log."""

    def notifies(self, text: str) -> None:
        """Is called with each message for systemd."""


class ExecutorProcess:
    """Runs an executor on the simulated clock, like its event loop.

    Attributes:
        journal: the switch journal, which survives the process.
        core: core of the present process; None between a kill and the next start.
        instances: number of processes so far.
        recorder: records the events of all processes; None: they are not recorded.

    Args:
        arm: the arm.
        agenda: time and events.
        random: for delays.
        buses: the buses by name.
        witness: sees events and actions.
    """

    def __init__(
        self,
        arm: ExecutedArm,
        agenda: Agenda,
        random: Random,
        buses: Mapping[str, BusModel],
        witness: Witness,
    ) -> None:
        self.journal = MemoryJournal(len(arm.actuators))
        self.core: Executor | None = None
        self.instances = 0
        self.recorder: FlightRecorder | None = None
        self._arm, self._agenda, self._random, self._buses = arm, agenda, random, buses
        self._witness = witness
        self._to_client: Callable[[ClientId, Up], None] = lambda client, message: None
        self._dies: Callable[[], None] = lambda: None
        self._at_start: Callable[[], None] = lambda: None
        self._events: deque[Event] = deque()
        self._awake_at = self._started_at = 0.0
        self._woken = self._ticked = False
        self._next_tick = 0.0
        self._clients: set[ClientId] = set()
        self._actions_left: int | None = None

    # --- its life

    def start(self) -> None:
        """Starts a process if none runs, and opens the buses."""
        if self.core is not None:
            return
        self.instances += 1
        self._events.clear()
        self.core = Executor(self._arm, self.journal, self.instances)
        if self.recorder is not None:
            core = self.core
            self.recorder.begin(core, lambda count: core.calm)
        self._next_tick = self._agenda.now
        self._ticked = False
        self._started_at = self._agenda.now
        self._witness.started()
        for name, bus in self._buses.items():
            self.post(BusChanged(name, bus.state, "", None))
        self._tick_later(self.instances)
        happen, self._at_start = self._at_start, lambda: None
        happen()

    @property
    def awake(self) -> bool:
        """Whether a process runs and is not stalled."""
        return self.core is not None and self._agenda.now >= self.awake_since

    @property
    def awake_since(self) -> float:
        """Time when the process was started, or its last stall ended [s]."""
        return max(self._awake_at, self._started_at)

    def recover(self) -> None:
        """Cancels a planned kill; a stall continues to its end."""
        self._actions_left = None

    def kill(self) -> None:
        """Ends the process at once, and starts it again later. Frames that it has handed out stay in the controller."""
        if self.core is not None:
            self.core = None
            self._actions_left = None
            self._clients.clear()
            self._witness.killed()
            self._dies()
            self._agenda.after(self._random.choice([0.05, 0.2, 1.0]), self.start)

    def quit(self) -> None:
        """Asks the process to end in order."""
        self.post(Quit())

    def at_next_start(self, happen: Callable[[], None]) -> None:
        """Calls a function once, after the next start of a process."""
        self._at_start = happen

    def kill_after(self, actions: int) -> None:
        """Kills the process after `actions` further actions, perhaps in the middle of a step."""
        self._actions_left = actions

    def stall(self, seconds: float) -> None:
        """Stalls the process for a time [s]."""
        self._awake_at = max(self._awake_at, self._agenda.now + seconds)

    # --- its clients

    def connect(self, to_client: Callable[[ClientId, Up], None], dies: Callable[[], None]) -> None:
        """Sets the functions that take messages for clients, and the end of the process."""
        self._to_client, self._dies = to_client, dies

    def hear(self, client: ClientId, event: FromClient | ClientGone) -> bool:
        """Takes an event of a client; returns whether the process knows the connection."""
        if isinstance(event, ClientGone):
            if client not in self._clients:
                return False
            self._clients.discard(client)
        else:
            self._clients.add(client)
        self.post(event)
        return True

    # --- its event loop

    def post(self, event: Event) -> None:
        """Queues an event for the process."""
        if self.core is not None:
            self._events.append(event)
            self._wake()

    def _wake(self) -> None:
        if not self._woken:
            self._woken = True
            delay = self._random.uniform(0.0, WAKE_UP)
            self._agenda.at(max(self._awake_at, self._agenda.now + delay), self._run)

    def _tick_later(self, instance: int) -> None:
        def due() -> None:
            if self.core is None or instance != self.instances:
                return
            if self._agenda.now < self._awake_at:
                self._agenda.at(self._awake_at, due)
                return
            # `select` promises no order of file descriptors; buses are opened before the first tick.
            first = self._random.random() < 0.5 and self._ticked
            self._ticked = True
            (self._events.appendleft if first else self._events.append)(ExecutorTick())
            self._run_now()
            late = int((self._agenda.now - self._next_tick) / TICK)
            self._next_tick += (1 + late) * TICK
            self._agenda.at(self._next_tick, due)

        self._agenda.at(self._next_tick, due)

    def _run(self) -> None:
        self._woken = False
        if self._agenda.now < self._awake_at:
            self._wake()
        else:
            self._run_now()

    def _run_now(self) -> None:
        while self._events and self.core is not None:
            event = self._events.popleft()
            self._witness.told(event)
            actions = self.core.step(event, self._agenda.now)
            if self.recorder is not None:
                self.recorder(event, self._agenda.now, None, actions)
            for action in actions:
                if self.core is not None:
                    self._do(action)
            if self.core is not None and self.core.ended:
                self.kill()

    def _do(self, action: Action) -> None:
        if self._actions_left is not None:
            self._actions_left -= 1
            if self._actions_left < 0:
                self.kill()
                return
        match action:
            case SendFrame(bus, frame):
                why = self._buses[bus].send_frame(frame, self._witness.sends(bus, frame))
                if why is not None:
                    self._events.appendleft(SendFailed(bus, frame, why))
            case ToClient(client, message):
                self._witness.says(message)
                self._to_client(client, message)
            case Log(level, text):
                self._witness.logs(level, text)
            case Notify(text):
                self._witness.notifies(text)

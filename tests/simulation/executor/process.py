"""The executor's process: its event loop, its end and its next start."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import (
    Action,
    ClientGone,
    ClientId,
    Event,
    ExecutorTick,
    FaultPlayed,
    FromClient,
    Health,
    SendFrame,
    ToClient,
    ToSimulation,
)
from hyperbit.controller.executor.process.journal_file import FileJournal
from hyperbit.controller.flight_recorder import FlightRecorder
from hyperbit.controller.host.process import Log, Notify, Quit
from hyperbit.controller.messages.state import LoopTimes
from hyperbit.controller.program import TICK, FaultVerb, Goodbye, PlayableFaults, Up
from hyperbit.drivers.canopen.wire.events import (
    BusChanged,
    BusOverrun,
    FrameEchoed,
    FrameIgnored,
    FrameReceived,
    SendFailed,
)
from tests.simulation.agenda import Agenda
from tests.simulation.buses.bus_model import BusModel
from tests.simulation.statements.statement import Witness

MEMORY = Path("/dev/shm")
SOON = 0.001  # [s] before diagnostics are due at which a tick asks for the figures of the process
LOOP_FAILS = "the simulated loop fails"  # text of a defect that the world draws
OF_BUSES = FrameReceived, FrameEchoed, FrameIgnored, BusChanged, BusOverrun, SendFailed
FIRST_COUNT = 16  # offset of the first count in a record of the journal
WAKE_UP = 0.0002  # [s], longest wake-up time of a process that is not stalled
FORGOTTEN = 0.2  # share of the ends of a process after which somebody deletes the files of its journal
BEAT = 0.4  # [s], the watchdog time of the simulated unit
VERB = FaultVerb("silence", "board", "", "the board sends nothing")
PLAYABLE = PlayableFaults((VERB,), ("can0/1",), ("can0",), ())
PLAYED = "done: it is played"


class Habits:
    """The drawn habits of the processes of one world.

    Attributes:
        watchdog: systemd's watchdog time [s]; None without a watchdog.
        simulation: faults that can be played in the boards; None: the boards count as real.
        problem: what is wrong with the switch journal; None: nothing.
        forgets: whether the files of the switch journal are lost between some processes.
    """

    def __init__(self, random: Random) -> None:
        self.watchdog = random.choice([None, BEAT])
        self.simulation = random.choice([None, PLAYABLE])
        self.problem: str | None = None
        self.forgets = False
        self.dropped = 0
        self._random = random

    def forgets_now(self) -> bool:
        return self.forgets and self._random.random() < FORGOTTEN

    def figures(self) -> Event | None:
        """Returns the figures that the loop passes to its core, or None if it is too late for them."""
        if self._random.random() < 0.1:
            return None
        loop = LoopTimes(ticks=self._random.randint(1, 100), late_worst=self._random.random())
        return Health(loop, self.dropped, self.problem)

    def play(self, action: ToSimulation) -> FaultPlayed:
        """Returns whether a fault was played; the simulated boards of this world play none of them."""
        played = self._random.random() < 0.5
        text = PLAYED if played else f"there is no fault {action.fault}"
        return FaultPlayed(action.client, action.request, text, played)


class ExecutorProcess:
    """Runs an executor on the simulated clock, like its event loop.

    Attributes:
        journal: the switch journal of the process; its file survives the process.
        core: core of the present process; None between a kill and the next start.
        instances: number of processes so far.
        recorder: records the events of all processes; None: they are not recorded.

    Args:
        habits: what the process does beside its core; None: nothing.
    """

    def __init__(
        self,
        arm: ExecutedArm,
        agenda: Agenda,
        random: Random,
        buses: Mapping[str, BusModel],
        witness: Witness,
        habits: Habits | None = None,
    ) -> None:
        self._arm, self._files = arm, TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None)
        self.journal = self._opened()
        self.core: Executor | None = None
        self.instances = 0
        self.recorder: FlightRecorder | None = None
        self._agenda, self._random, self._buses = agenda, random, buses
        self._witness, self._habits = witness, habits
        self._quitting = False
        self._last: Up | None = None  # the last message to a client
        self._to_client: Callable[[ClientId, Up], None] = lambda client, message: None
        self._dies: Callable[[], None] = lambda: None
        self._at_start: Callable[[], None] = lambda: None
        self._events: deque[Event] = deque()
        self._awake_at = self._started_at = 0.0
        self._woken = self._ticked = False
        self._next_tick, self._ticks, self._rests = 0.0, 0, False
        self._clients: set[ClientId] = set()
        self._actions_left: int | None = None
        self._tearable = False  # a kill now may be in the middle of the journal's last write
        self._dies_in_write = False

    def start(self) -> None:
        """Starts a process if none runs, and opens the buses."""
        if self.core is not None:
            return
        self.instances += 1
        self._events.clear()
        habits, self._quitting = self._habits, False
        extras = (None, None) if habits is None else (habits.watchdog, habits.simulation)
        if self.instances > 1:
            if habits is not None and habits.forgets_now():
                for path in Path(self._files.name).iterdir():
                    path.unlink()
                self._witness.see("forgets")
            self.journal = self._opened()
        self.core = Executor(self._arm, self.journal, self.instances, *extras)
        if self.recorder is not None:
            core = self.core
            self.recorder.begin(core, lambda count: core.calm)
        self._next_tick = self._agenda.now
        self._ticked = self._rests = False
        self._started_at = self._agenda.now
        self._witness.see("started")
        for name, bus in self._buses.items():
            self.post(BusChanged(name, bus.state, "", None))
        self._tick_later(self.instances)
        happen, self._at_start = self._at_start, lambda: None
        happen()

    def _opened(self) -> FileJournal:
        """Opens the switch journal, whose file in memory survives a kill."""
        folder = Path(self._files.name)
        memory = os.fdopen(os.open(folder / "memory", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC), "r+b", buffering=0)
        return FileJournal(folder / "disk", self._arm.actuators, memory)

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
        self._actions_left, self._dies_in_write = None, False

    def kill(self) -> None:
        """Ends the process at once, and starts it again later. Frames that it has handed out stay in the controller."""
        if self.core is not None:
            self.core = None
            self._actions_left, self._dies_in_write = None, False
            self._clients.clear()
            self._witness.see("killed")
            self._dies()
            self._agenda.after(self._random.choice([0.05, 0.2, 1.0]), self.start)

    def quit(self) -> None:
        if not self._quitting:
            self._quitting = self.core is not None
            self.post(Quit())

    def quit_again(self) -> None:
        """Asks a process that ends in order to end at once."""
        if self._quitting and self.awake and not self._events:
            self._witness.see("hurries")
            self._finish()

    def at_next_start(self, happen: Callable[[], None]) -> None:
        """Calls a function once, after the next start of a process."""
        self._at_start = happen

    def kill_after(self, actions: int) -> None:
        """Kills the process after `actions` further actions, perhaps in the middle of a step."""
        self._actions_left = actions

    def die_in_write(self) -> None:
        """Kills the process in the middle of the next write of its journal."""
        self._dies_in_write = True

    def stall(self, seconds: float) -> None:
        """Stalls the process for a time [s]."""
        self._awake_at = max(self._awake_at, self._agenda.now + seconds)

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

    def post(self, event: Event) -> None:
        """Takes an event. At rest those of buses wait for the tick, or for a client's message."""
        if self.core is not None:
            self._events.append(event)
            if not self._rests or not isinstance(event, OF_BUSES):
                self._wake()

    def _wake(self) -> None:
        if not self._woken:
            self._woken = True
            delay = self._random.uniform(0.0, WAKE_UP)
            self._agenda.at(max(self._awake_at, self._agenda.now + delay), self._run)

    def _tick_later(self, instance: int) -> None:
        def due() -> None:
            if self.core is None or instance != self.instances or number != self._ticks:
                return
            if self._agenda.now < self._awake_at:
                self._agenda.at(self._awake_at, due)
                return
            # Frames may arrive behind the last poll of the buses; at rest they were waiting for it. Buses are opened
            # before the first tick.
            first = self._random.random() < 0.5 and self._ticked and not self._rests
            self._rests = False
            self._ticked = True
            ticks: list[Event] = [ExecutorTick()]
            if self._habits is not None and self.core.reports.diagnostics_due(self._agenda.now + SOON):
                figures = self._habits.figures()
                ticks = ticks if figures is None else [figures, *ticks]
            (self._events.extendleft(reversed(ticks)) if first else self._events.extend(ticks))
            self._run_now()
            if self.core is None:
                return
            self._next_tick += self.core.period
            if self._next_tick <= self._agenda.now:
                self._next_tick += (1 + int((self._agenda.now - self._next_tick) / TICK)) * TICK
            self._rests = self.core.period > TICK
            self._tick_later(instance)

        self._ticks += 1
        number = self._ticks
        self._agenda.at(self._next_tick, due)

    def _run(self) -> None:
        self._woken = False
        if self._agenda.now < self._awake_at:
            self._wake()
        else:
            self._run_now()

    def _run_now(self) -> None:
        while self._events and self.core is not None:
            self._step(self._events.popleft())
            if self.core is not None and self.core.ended:
                self._finish()
        if self._rests and self.core is not None and not self.core.resting(self._agenda.now):
            self._rests = False
            self._next_tick -= int((self._next_tick - self._agenda.now) / TICK) * TICK
            self._tick_later(self.instances)

    def _step(self, event: Event) -> None:
        assert self.core is not None
        self._witness.see("told", event)
        written = self.journal.number
        actions = self.core.step(event, self._agenda.now)
        self.core.check()
        self._tearable = self.journal.number > written
        if self._tearable and self._dies_in_write:
            self._tear()
            self.kill()
            return
        if self.recorder is not None:
            self.recorder(event, self._agenda.now, None, actions)
        for action in actions:
            if self.core is not None:
                self._do(action)

    def _tear(self) -> None:
        self.journal.mapped[self.journal.slots[self.journal.number % 2] + FIRST_COUNT] ^= 0xFF

    def _finish(self) -> None:
        """Ends the process in order: the core tells the last results and counts."""
        if self._habits is not None:
            self._step(Quit())
        self.kill()

    def _do(self, action: Action) -> None:
        if self._actions_left is not None:
            self._actions_left -= 1
            if self._actions_left < 0:
                if self._tearable and self._random.random() < 0.5:
                    self._tear()
                self.kill()
                return
        self._tearable = False
        match action:
            case SendFrame(bus, frame):
                why = self._buses[bus].send_frame(frame, self._witness.see("sends", bus, frame))
                if why is not None:
                    self._events.appendleft(SendFailed(bus, frame, why))
            case ToClient(client, message):
                if message is not self._last:
                    self._last = message
                    self._witness.see("says", message)
                self._witness.see("tells", client, message)
                self._to_client(client, message)
                if isinstance(message, Goodbye) and self._habits is not None:  # the server closes the connection
                    self._clients.discard(client)
                    self.post(ClientGone(client))
            case ToSimulation() if self._habits is not None:
                self.post(self._habits.play(action))
            case Log(level, text):
                self._witness.see("logs", level, text)
            case Notify(text):
                self._witness.see("notifies", text)

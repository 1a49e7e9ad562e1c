"""The executor on the real CANopen master, with buses, boards and process of the simulation, and a planner."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from random import Random
from typing import Any

from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ClientGone, ClientId, Event, FromClient
from hyperbit.controller.program import TICK, VERSION, Alive, Hello, Program, Snapshot, Stage, Up, pack
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.simulation.variants import Variant
from tests.executor.rig import PLANNER, SIZE, small_arm
from tests.simulation.buses.hardware import Hardware
from tests.simulation.executor.process import WAKE_UP, ExecutorProcess, Witness

A, B = 0b000111, 0b011100
STEP = 0.001  # [s]


class World(Hardware, Witness):
    """Executor, boards, and a planner that keeps itself alive.

    Attributes:
        core: of the present process, or of the last one.
        heard: messages to the planner, with their times.
        syncs: times at which SYNCs were handed out [s].
    """

    core: Executor

    def __init__(self, variants: Mapping[str, Variant] | None = None, **fields: Any) -> None:
        self.arm = small_arm(**fields)
        super().__init__(self.arm.wiring, self.arm.timing, self._to_executor, variants)
        self.heard: list[tuple[float, Any]] = []
        self.syncs: list[float] = []
        self.logged: list[str] = []
        self.ended = False
        self.executor = ExecutorProcess(self.arm, self.agenda, Random(0), self.buses, self)
        self.executor.connect(self._hear, lambda: None)
        self.executor.start()
        self.connect()
        self._keep_alive()

    def connect(self) -> None:
        self.send(Hello(VERSION, "planner", "small"))

    def leave(self) -> None:
        self.executor.hear(PLANNER, ClientGone(PLANNER))
        self.agenda.run(WAKE_UP)

    @property
    def epoch(self) -> int:
        assert self.executor.core is not None
        return self.executor.core.modes.epoch

    def send(self, message: Any) -> None:
        """Sends a message of the planner, which the executor takes at once."""
        self.executor.hear(PLANNER, FromClient(PLANNER, message))
        self.agenda.run(WAKE_UP)

    def post(self, event: Event) -> None:
        """Gives the executor an event, which it takes at once."""
        self.executor.post(event)
        self.agenda.run(WAKE_UP)

    def go(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Runs for a time [s]; calls a function each millisecond."""
        for _ in range(round(seconds / STEP) if each else 1):
            self.agenda.run(STEP if each else seconds)
            if each:
                each()

    def run(self, number: int, *states: int, step: float = 0.2) -> None:
        snapshot = self.last(Snapshot)
        stages = tuple(Stage(pack(bits, SIZE), at=step * k, mark=k) for k, bits in enumerate(states))
        self.send(Program(number, snapshot.epoch, snapshot.outputs, 0.0, stages, True, False, f"goal {number}"))

    def _keep_alive(self) -> None:
        if self.has_planner:
            self.executor.hear(PLANNER, FromClient(PLANNER, Alive()))
        self.agenda.after(TICK, self._keep_alive)

    def of(self, kind: type) -> list[Any]:
        return [message for _, message in self.heard if isinstance(message, kind)]

    def last(self, kind: type) -> Any:
        return self.of(kind)[-1]

    @property
    def mode(self) -> str:
        return self.core.modes.mode

    @property
    def has_planner(self) -> bool:
        core = self.executor.core
        return core is not None and core.clients.planner is not None

    @property
    def journal(self) -> Any:
        return self.executor.journal

    @property
    def driven(self) -> int:
        return sum(end << k for k, end in enumerate(self.boards.drives()))

    def started(self) -> None:
        assert self.executor.core is not None
        self.core = self.executor.core

    def killed(self) -> None:
        self.ended = True

    def sends(self, bus: str, frame: Frame) -> None:
        if frame.id == cia301.SYNC:
            self.syncs.append(self.now)

    def logs(self, level: int, text: str) -> None:
        self.logged.append(text)

    def _hear(self, client: ClientId, message: Up) -> None:
        self.heard.append((self.now, message))

    def _to_executor(self, event: Event) -> None:
        self.executor.post(event)


def ready(**fields: Any) -> World:
    world = World(**fields)
    world.go(2.0)
    assert world.mode == "ready", world.logged
    return world

"""The executor with a planner that the test plays: on a master without boards, or on simulated boards and buses.

Both have the clock of the simulation.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from random import Random
from typing import Any, Literal, TypeVar

from msgspec.structs import replace

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ClientGone, ClientId, Event, ExecutorTick, FromClient, ToClient
from hyperbit.controller.host.process import Log, Notify
from hyperbit.controller.program import (
    TICK,
    VERSION,
    Alive,
    Answer,
    Ended,
    Hello,
    Program,
    Setpoint,
    Settled,
    Snapshot,
    Stage,
    pack,
    unpack,
)
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.events import FrameIgnored
from hyperbit.drivers.canopen.wiring import BoardId, BusWiring, Channel, Interlock, NodeWiring, Timing, Wiring
from hyperbit.drivers.simulation.variants import Variant
from tests.executor.fake_master import FakeMaster
from tests.simulation.agenda import Agenda
from tests.simulation.buses.boards import Hardware
from tests.simulation.executor.process import WAKE_UP, ExecutorProcess
from tests.simulation.statements.statement import Witness

SIZE = 6
ALL = (1 << SIZE) - 1
A, B, C = 0b000111, 0b011100, 0b110000
TRAVEL, MARGIN = 0.05, 0.03
STEP = 0.001  # [s]
PLANNER, OTHER, OPERATOR = ClientId(1, 4001), ClientId(2, 4002), ClientId(3, 4003)
LABELS = tuple(f"{module}.{name}" for module in (1, 2) for name in ("left", "diagonal", "right"))
LOST = ArmFault("board-lost", "can0/1", "board can0/1: no heartbeat")
CAN = FrameIgnored("can0", 100)  # an event of a bus without effect

T = TypeVar("T")


def small_arm(
    sensed: int = ALL,
    margin: float = MARGIN,
    channel: dict[str, Any] | None = None,
    interlocks: tuple[Interlock, ...] = (),
    on_loss: Literal["hold", "contract"] = "hold",
    input_board: BoardId | None = None,
    nodes: tuple[NodeWiring, ...] = (),
    **fields: Any,
) -> ExecutedArm:
    """Returns an arm of two boards with three actuators each.

    `channel`: further fields; second lines are +8. `input_board`: the board of all end-stops; bit k is actuator k.
    """
    more = dict(channel or {})
    second = {name for name in ("output_off", "input_contracted") if more.pop(name, False)}
    channels = tuple(
        Channel(
            label,
            "can0",
            1 + k // 3,
            k % 3,
            (k if input_board else k % 3) if sensed >> k & 1 else None,
            **{name: 8 + (k if input_board and name == "input_contracted" else k % 3) for name in second},
            input_board=input_board,
            input_contracted_board=input_board,
            **more,
        )
        for k, label in enumerate(LABELS)
    )
    names = dict.fromkeys(["can0", *([input_board.bus] if input_board else [])])
    buses = tuple(BusWiring(name, "virtual", name) for name in names)
    wiring = Wiring(buses, channels, on_loss=on_loss, interlocks=interlocks, nodes=nodes)
    timing = Timing(travel_time=TRAVEL, settle_margin=margin)
    return ExecutedArm("small", wiring, timing, digest="d" * 64, **fields)


def _packed(fields: dict[str, Any]) -> dict[str, Any]:
    """Returns fields of a message; `number` is that of the program, `start` and `homed` are masks."""
    named = {"program" if name == "number" else name: value for name, value in fields.items()}
    return {name: pack(value, SIZE) if name in ("start", "homed") else value for name, value in named.items()}


class Played:
    """A planner that the test plays, and what the executor tells its clients, with times."""

    core: Executor
    now: Any  # [s], of the clock

    def __init__(self) -> None:
        self.heard: list[tuple[float, ClientId, Any]] = []
        self.logged: list[tuple[int, str]] = []
        self.programs = 0

    def send(self, message: Any, client: ClientId = PLANNER) -> None:
        raise NotImplementedError

    def connect(self, client: ClientId = PLANNER, role: str = "planner") -> None:
        self.send(Hello(VERSION, role, "small"), client)

    def program(self, *states: int, step: float = 0.2, final: bool = True, **fields: Any) -> Program:
        """Returns a program whose stages each have a mark."""
        self.programs += 1
        stages = tuple(
            Stage(pack(bits, SIZE), at=step * k, mark=k, settled=step * k + TRAVEL + TICK)
            for k, bits in enumerate(states)
        )
        start, name = pack(self.states, SIZE), f"goal {self.programs}"
        given = Program(self.programs, self.snapshot.epoch, start, 0.0, stages, final, False, name, until=1e12)
        return replace(given, **_packed(fields))

    def run(self, *states: int, **fields: Any) -> Program:
        program = self.program(*states, **fields)
        self.send(program)
        return program

    def follow(self, stream: int, *stages: int, lasting: float = 0.25, **fields: Any) -> None:
        start, until = pack(self.states, SIZE), self.now + lasting
        packed = tuple(pack(bits, SIZE) for bits in stages)
        given = Setpoint(stream, self.snapshot.epoch, start, packed, until, False, "following a setpoint")
        self.send(replace(given, **_packed(fields)))

    def of(self, kind: type[T], client: ClientId | None = PLANNER) -> list[T]:
        return [said for _, receiver, said in self.heard if isinstance(said, kind) and client in (None, receiver)]

    def last(self, kind: type[T], client: ClientId | None = PLANNER) -> T:
        return self.of(kind, client)[-1]

    @property
    def snapshot(self) -> Snapshot:
        return self.last(Snapshot)

    @property
    def states(self) -> int:
        """The commanded states, as the planner sees them."""
        return unpack(self.snapshot.outputs)

    @property
    def answer(self) -> tuple[bool, str]:
        last = self.last(Answer)
        return last.accepted, last.message

    @property
    def faults(self) -> list[tuple[str, str]]:
        return [(fault.code, fault.source) for fault in self.snapshot.faults]

    @property
    def results(self) -> list[tuple[int, str]]:
        return [(ended.program, ended.status) for ended in self.of(Ended)]

    @property
    def marks(self) -> list[int]:
        return [settled.mark for settled in self.of(Settled)]

    @property
    def epoch(self) -> int:
        return self.core.modes.epoch

    @property
    def mode(self) -> str:
        return self.core.modes.mode

    @property
    def reason(self) -> str:
        return self.core.modes.reason


class Rig(Played):
    """The executor's core on a master without boards; `go` advances the time while the planner is alive."""

    def __init__(self, **fields: Any) -> None:
        super().__init__()
        self.agenda = Agenda()
        self.arm = small_arm(**fields)
        self.journal = SwitchJournal(SIZE)
        self.core = Executor(self.arm, self.journal, instance=7, watchdog=0.4, build_master=FakeMaster)
        self.master: FakeMaster = self.core.master
        self.notified: list[str] = []
        self.fields: list[Mapping[str, str]] = []  # of the same lines as `logged`, for the journal
        self.alive = False

    @property
    def now(self) -> float:
        return self.agenda.now

    def do(self, event: Any) -> None:
        for action in self.core.step(event, self.now):
            match action:
                case ToClient():
                    self.heard.append((self.now, action.client, action.message))
                case Notify():
                    self.notified.append(action.text)
                case Log():
                    self.logged.append((action.level, action.text))
                    self.fields.append(action.fields)

    def send(self, message: Any, client: ClientId = PLANNER) -> None:
        self.do(FromClient(client, message))

    def connect(self, client: ClientId = PLANNER, role: str = "planner") -> None:
        super().connect(client, role)
        self.alive |= client == PLANNER

    def gone(self, client: ClientId = PLANNER) -> None:
        self.alive &= client != PLANNER
        self.do(ClientGone(client))

    def go(self, seconds: float = TICK) -> None:
        for _ in range(max(round(seconds / TICK), 1)):
            self.agenda.run(TICK)
            if self.alive:
                self.send(Alive())
            self.do(ExecutorTick())

    @property
    def switched(self) -> list[int]:
        return [states for _, states in self.master.commits]

    def errors(self) -> Iterable[str]:
        return [text for level, text in self.logged if level >= logging.ERROR]


class World(Played, Hardware, Witness):
    """The executor's process with buses and boards, and a planner that keeps itself alive.

    Attributes:
        core: of the present process, or of the last one.
        syncs: times at which SYNCs were handed out [s].

    Args:
        wired: how the boards are wired in truth; None: as the executor's arm says.
    """

    def __init__(
        self,
        variants: Mapping[str, Variant] | None = None,
        arm: ExecutedArm | None = None,
        wired: Wiring | None = None,
        **fields: Any,
    ) -> None:
        Played.__init__(self)
        self.arm = arm or small_arm(**fields)
        Hardware.__init__(self, wired or self.arm.wiring, self.arm.timing, self._to_executor, variants)
        self.syncs: list[float] = []
        self.ended = False
        self.executor = ExecutorProcess(self.arm, self.agenda, Random(0), self.buses, self)
        self.executor.connect(self._hear, lambda: None)
        self.executor.start()
        self.connect()
        self._keep_alive()

    def send(self, message: Any, client: ClientId = PLANNER) -> None:
        """Sends a message, which the executor takes at once."""
        self.executor.hear(client, FromClient(client, message))
        self.agenda.run(WAKE_UP)

    def leave(self) -> None:
        self.executor.hear(PLANNER, ClientGone(PLANNER))
        self.agenda.run(WAKE_UP)

    def do(self, event: Event) -> None:
        """Gives the executor an event, which it takes at once."""
        self.executor.post(event)
        self.agenda.run(WAKE_UP)

    def go(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Runs for a time [s]; calls a function each millisecond."""
        for _ in range(round(seconds / STEP) if each else 1):
            self.agenda.run(STEP if each else seconds)
            if each:
                each()

    def _keep_alive(self) -> None:
        if self.has_planner:
            self.executor.hear(PLANNER, FromClient(PLANNER, Alive()))
        self.agenda.after(TICK, self._keep_alive)

    @property
    def has_planner(self) -> bool:
        return self.executor.core is not None and self.core.clients.planner is not None

    @property
    def journal(self) -> SwitchJournal:
        return self.executor.journal

    @property
    def driven(self) -> int:
        """The states that the boards' outputs command."""
        return sum(end << k for k, end in enumerate(self.boards.drives()))

    @property
    def positions(self) -> int:
        return sum(round(position) << k for k, position in enumerate(self.boards.positions()))

    def started(self) -> None:
        assert self.executor.core is not None
        self.core = self.executor.core

    def killed(self) -> None:
        self.ended = True

    def sends(self, bus: str, frame: cia301.Frame) -> None:
        if frame.id == cia301.SYNC:
            self.syncs.append(self.now)

    def logs(self, level: int, text: str) -> None:
        self.logged.append((level, text))

    def _hear(self, client: ClientId, message: Any) -> None:
        self.heard.append((self.now, client, message))

    def _to_executor(self, event: Event) -> None:
        self.executor.post(event)


def ready(**fields: Any) -> Rig:
    """Returns a ready rig with a planner; switches of a previous executor would have settled."""
    rig = Rig(**fields)
    rig.connect()
    rig.go(3 * TICK)
    assert rig.mode == "ready", rig.reason
    rig.go(TRAVEL)
    return rig


def ready_world(**fields: Any) -> World:
    world = World(**fields)
    world.go(2.0)
    assert world.mode == "ready", world.logged
    return world

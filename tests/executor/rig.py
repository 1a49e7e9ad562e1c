"""The executor's core alone, for tests of its rules: a master without boards, and a planner that the test plays.

`tests/executor/world.py` has the executor with buses and boards. Both have the clock of the simulation.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from typing import Any, Literal, TypeVar

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ClientGone, ClientId, ExecutorTick, FromClient, ToClient
from hyperbit.controller.host.process import Log, Notify
from hyperbit.controller.program import (
    TICK,
    VERSION,
    Alive,
    Answer,
    Diagnostics,
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
from hyperbit.drivers.canopen.wire.events import FrameIgnored
from hyperbit.drivers.canopen.wiring import BoardId, BusWiring, Channel, Interlock, NodeWiring, Timing, Wiring
from tests.executor.fake_master import FakeMaster
from tests.simulation.agenda import Agenda

SIZE = 6
TRAVEL, MARGIN = 0.05, 0.03
PLANNER, OTHER, OPERATOR = ClientId(1, 4001), ClientId(2, 4002), ClientId(3, 4003)
LABELS = tuple(f"{module}.{name}" for module in (1, 2) for name in ("left", "diagonal", "right"))
LOST = ArmFault("board-lost", "can0/1", "board can0/1: no heartbeat")
CAN = FrameIgnored("can0", 100)  # an event of a bus without effect

T = TypeVar("T")


def small_arm(
    sensed: int = 0b111111,
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
    return ExecutedArm("small", LABELS, wiring, timing, digest="d" * 64, **fields)


class Rig:
    """An executor and its actions; `go` advances the time while the planner is alive."""

    def __init__(self, **fields: Any) -> None:
        self.agenda = Agenda()
        self.arm = small_arm(**fields)
        self.journal = SwitchJournal(SIZE)
        self.core = Executor(self.arm, self.journal, instance=7, watchdog=0.4, build_master=FakeMaster)
        self.master: FakeMaster = self.core.master
        self.heard: list[tuple[ClientId, Any]] = []
        self.notified: list[str] = []
        self.logged: list[tuple[int, str]] = []
        self.fields: list[Mapping[str, str]] = []  # of the same lines, for the journal
        self.alive = False
        self.programs = 0

    @property
    def now(self) -> float:
        return self.agenda.now

    @property
    def answer(self) -> tuple[bool, str]:
        last = self.last(Answer)
        return last.accepted, last.message

    @property
    def faults(self) -> list[tuple[str, str]]:
        return [(fault.code, fault.source) for fault in self.snapshot.faults]

    @property
    def epoch(self) -> int:
        return self.core.modes.epoch

    def do(self, event: Any) -> None:
        for action in self.core.step(event, self.now):
            match action:
                case ToClient():
                    self.heard.append((action.client, action.message))
                case Notify():
                    self.notified.append(action.text)
                case Log():
                    self.logged.append((action.level, action.text))
                    self.fields.append(action.fields)

    def send(self, message: Any, client: ClientId = PLANNER) -> None:
        self.do(FromClient(client, message))

    def connect(self, client: ClientId = PLANNER, role: str = "planner") -> None:
        self.send(Hello(VERSION, role, "small"), client)
        self.alive |= client == PLANNER

    def gone(self, client: ClientId = PLANNER) -> None:
        self.alive = False
        self.do(ClientGone(client))

    def go(self, seconds: float = TICK) -> None:
        for _ in range(max(round(seconds / TICK), 1)):
            self.agenda.run(TICK)
            if self.alive:
                self.send(Alive())
            self.do(ExecutorTick())

    def program(self, *states: int, step: float = 0.2, final: bool = True, **fields: Any) -> Program:
        """Sends a program whose stages each have a mark."""
        self.programs += 1
        stages = tuple(
            Stage(pack(bits, SIZE), at=step * k, mark=k, settled=step * k + TRAVEL + TICK)
            for k, bits in enumerate(states)
        )
        given = {"number": self.programs, "epoch": self.snapshot.epoch, "start": self.states, "begin": 0.0}
        given |= {"strict": False, "name": f"goal {self.programs}", "context": b"", "stages": stages} | fields
        return Program(
            program=given["number"],
            epoch=given["epoch"],
            start=pack(given["start"], SIZE),
            begin=given["begin"],
            stages=given["stages"],
            final=final,
            strict=given["strict"],
            name=given["name"],
            context=given["context"],
            homed=pack(given["homed"], SIZE) if "homed" in given else b"",
        )

    def run(self, *states: int, **fields: Any) -> Program:
        program = self.program(*states, **fields)
        self.send(program)
        return program

    def follow(self, stream: int, *stages: int, lasting: float = 0.25, **fields: Any) -> None:
        given = {"epoch": self.snapshot.epoch, "start": self.states, "strict": False} | fields
        self.send(
            Setpoint(
                stream=stream,
                epoch=given["epoch"],
                start=pack(given["start"], SIZE),
                stages=tuple(pack(bits, SIZE) for bits in stages),
                until=self.now + lasting,
                strict=given["strict"],
                reason="following a setpoint",
            )
        )

    def of(self, kind: type[T], client: ClientId = PLANNER) -> list[T]:
        return [message for receiver, message in self.heard if isinstance(message, kind) and receiver == client]

    def last(self, kind: type[T], client: ClientId = PLANNER) -> T:
        return self.of(kind, client)[-1]

    @property
    def snapshot(self) -> Snapshot:
        return self.last(Snapshot)

    @property
    def diagnostics(self) -> list[Diagnostics]:
        return self.of(Diagnostics)

    @property
    def results(self) -> list[tuple[int, str]]:
        return [(ended.program, ended.status) for ended in self.of(Ended)]

    @property
    def marks(self) -> list[int]:
        return [settled.mark for settled in self.of(Settled)]

    @property
    def switched(self) -> list[int]:
        return [states for _, states in self.master.commits]

    @property
    def states(self) -> int:
        """The commanded states, as the planner sees them."""
        return unpack(self.snapshot.outputs)

    @property
    def mode(self) -> str:
        return self.core.modes.mode

    @property
    def reason(self) -> str:
        return self.core.modes.reason

    def errors(self) -> Iterable[str]:
        return [text for level, text in self.logged if level >= logging.ERROR]


def ready(**fields: Any) -> Rig:
    """Returns a ready rig with a planner; switches of a previous executor would have settled."""
    rig = Rig(**fields)
    rig.connect()
    rig.go(3 * TICK)
    assert rig.mode == "ready", rig.reason
    rig.go(TRAVEL)
    return rig

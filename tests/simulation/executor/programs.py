"""Random requests of a planner: programs, replacements, set-points, correct and bad ones; and of a commissioner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random

import msgspec

from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.program import (
    Cancel,
    Down,
    Lock,
    Program,
    Replacement,
    Reset,
    Setpoint,
    Snapshot,
    Stage,
    Trial,
    pack,
    unpack,
)

NOBODY = 10**9  # number of the requests whose answers nobody awaits
TRIES = {"trial": 30, "wait": 20, "cancel": 3, "cancel program": 2, "reset": 1, "operator": 1, "planner": 1}
TRIES |= {"acknowledge": 4, "forbidden": 0.5}


@dataclass
class Drawn:
    """A program that was sent, with the stages appended since.

    Attributes:
        stages: all stages that the executor has accepted.
        begin: its zero of time [s].
        generation: of the last replacement.
        taken: the last stage that the executor has reported.
        cut: stages that a parking has cut off.
        sent: replacement that is not answered yet.
    """

    program: Program
    stages: list[Stage]
    begin: float = 0.0
    generation: int = 0
    taken: int = -1
    cut: tuple[Stage, ...] = ()
    sent: Replacement | None = None

    def answered(self, accepted: bool) -> None:
        message, self.sent = self.sent, None
        if message is not None and accepted:
            if not message.stages:
                self.cut = (*self.stages[message.first :], *self.cut)
            self.stages[message.first :] = message.stages


class Author:
    """Draws the messages of a planner for an arm."""

    def __init__(self, arm: ExecutedArm, random: Random) -> None:
        self._random = random
        self._count = len(arm.actuators)
        self._most = self._count if arm.inrush is None else min(arm.inrush, self._count)
        self._travel = arm.timing.travel_time

    def program(self, snapshot: Snapshot, number: int, now: float) -> Drawn:
        """Returns a correct program from the outputs of a snapshot."""
        random = self._random
        stages = self._walk(unpack(snapshot.outputs), unpack(snapshot.locked), random.randint(1, 8), 0.0)
        program = Program(
            program=number,
            epoch=snapshot.epoch,
            start=snapshot.outputs,
            begin=0.0 if random.random() < 0.7 else now + random.uniform(-0.2, 0.3),
            stages=tuple(stages),
            final=random.random() < 0.8,
            strict=random.random() < 0.3,
            name=f"goal {number}",
            context=b"context %d" % number,
            homed=pack(random.getrandbits(self._count), self._count) if random.random() < 0.2 else b"",
        )
        return Drawn(program, stages)

    def switch(
        self, snapshot: Snapshot, number: int, actuator: int, times: int, pause: float, strict: bool = False
    ) -> Drawn:
        """Returns a program that switches one actuator to and fro, once in each pause [s]."""
        before = unpack(snapshot.outputs)
        after = (before ^ (k + 1) % 2 << actuator for k in range(times))
        stages = [Stage(pack(states, self._count), k * pause, k + 1, 0.0) for k, states in enumerate(after)]
        name, outputs = f"goal {number}", snapshot.outputs
        return Drawn(Program(number, snapshot.epoch, outputs, 0.0, tuple(stages), True, strict, name), stages)

    def replacement(self, drawn: Drawn, locked: int) -> Replacement:
        """Returns a replacement of a program's stages, from a random stage on."""
        random = self._random
        first = random.randint(0, len(drawn.stages))
        if random.random() < 0.6:
            first = len(drawn.stages)
        states = drawn.stages[first - 1].states if first else drawn.program.start
        earliest = drawn.stages[first - 1].at if first else 0.0
        stages = self._walk(unpack(states), locked, random.randint(0, 4), earliest)
        return self._replacing(drawn, first, tuple(stages), random.random() < 0.8, random.random() < 0.4)

    def parking(self, drawn: Drawn) -> Replacement:
        """Returns a replacement that parks a program: its stages that have not begun are cut off."""
        return self._replacing(drawn, drawn.taken + 1, (), final=False, strict=self._random.random() < 0.3)

    def resumption(self, drawn: Drawn, now: float) -> Replacement:
        """Returns a replacement that appends stages that were cut off, at their old times or later."""
        random, last = self._random, len(drawn.stages) - 1
        count = random.choice([1, len(drawn.cut)])
        stages, drawn.cut = drawn.cut[:count], drawn.cut[count:]
        earliest = drawn.stages[last].at if drawn.stages else stages[0].at
        if random.random() < 0.7:
            earliest = max(earliest, now - drawn.begin)
        delay = max(0.0, earliest - stages[0].at)
        later = (msgspec.structs.replace(s, at=s.at + delay, settled=s.settled + delay) for s in stages)
        return self._replacing(drawn, last + 1, tuple(later), final=not drawn.cut, strict=False)

    def _replacing(self, drawn: Drawn, first: int, stages: tuple[Stage, ...], final: bool, strict: bool) -> Replacement:
        drawn.generation += 1
        start = drawn.stages[first - 1].states if first else drawn.program.start
        drawn.sent = Replacement(drawn.program.program, drawn.generation, first, start, stages, final, strict)
        return drawn.sent

    def trial(self, snapshot: Snapshot, number: int, now: float) -> Trial:
        """Returns a trial of one actuator; some are of an earlier epoch, late, or of no actuator."""
        random = self._random
        wild = random.random() < 0.1
        return Trial(
            program=max(0, number - random.choice([0, 0, 0, 0, 1]) * wild),
            epoch=max(0, snapshot.epoch - random.choice([0, 1]) * wild),
            actuator=random.randrange(self._count + wild),
            state=random.randint(0, 1),
            watch=random.choice([0.0, 0.05, 0.3]),
            until=now + random.choice([1.0, 1.0, 0.0, -0.1] if wild else [1.0]),
        )

    def setpoint(self, snapshot: Snapshot, stream: int, now: float) -> Setpoint:
        """Returns a set-point near the outputs of a snapshot; one of four has no stages."""
        random = self._random
        length = random.randint(0, 3)
        stages = self._walk(unpack(snapshot.outputs), unpack(snapshot.locked), length, 0.0)
        return Setpoint(
            stream=stream,
            epoch=snapshot.epoch,
            start=snapshot.outputs,
            stages=tuple(stage.states for stage in stages),
            until=now + random.choice([0.05, 0.25, 0.25, 1.0]),
            strict=random.random() < 0.3,
            reason="following",
        )

    def strict_setpoint(self, snapshot: Snapshot, stream: int, now: float, actuator: int) -> Setpoint:
        """Returns a strict set-point that switches one actuator."""
        states = pack(unpack(snapshot.outputs) ^ 1 << actuator, self._count)
        return Setpoint(stream, snapshot.epoch, snapshot.outputs, (states,), now + 0.2, True, "following")

    def spoiled_setpoint(self, message: Setpoint, snapshot: Snapshot, now: float) -> Setpoint:
        """Returns a spoiled set-point, which must not be followed unless it is correct by chance."""
        random, replace = self._random, msgspec.structs.replace
        locked = pack(unpack(message.start) ^ unpack(snapshot.locked), self._count)
        ways: list[Callable[[], Setpoint]] = [
            lambda: replace(message, epoch=max(0, message.epoch - random.randint(1, 3))),
            lambda: replace(message, epoch=message.epoch + 1),
            lambda: replace(message, stream=max(0, message.stream - random.randint(1, 20))),
            lambda: replace(message, until=now - random.choice([0.01, 1.0])),
            lambda: replace(message, start=message.start + b"\0"),
            lambda: replace(message, start=pack(self._wild(), self._count)),
            lambda: replace(message, stages=(*message.stages, message.start + b"\0")),
            lambda: replace(message, stages=(pack(self._wild(), self._count), *message.stages)),
            lambda: replace(message, stages=(locked, *message.stages)),
        ]
        return random.choice(ways)()

    def spoiled_replacement(self, message: Replacement) -> Replacement:
        """Returns a spoiled replacement, which must be refused unless it is correct by chance."""
        random, replace = self._random, msgspec.structs.replace
        wild = Stage(pack(self._wild(), self._count), 1e6)
        ways: list[Callable[[], Replacement]] = [
            lambda: replace(message, generation=max(0, message.generation - random.randint(1, 3))),
            lambda: replace(message, program=max(0, message.program - 1)),
            lambda: replace(message, first=message.first + random.randint(1, 3)),
            lambda: replace(message, start=pack(self._wild(), self._count)),
            lambda: replace(message, start=message.start + b"\0"),
            lambda: replace(message, stages=(*message.stages, wild)),
            lambda: replace(message, stages=(*message.stages, replace(wild, at=-1e12))),
            lambda: replace(message, stages=(*message.stages, replace(wild, states=b""))),
        ]
        return random.choice(ways)()

    def spoiled(self, program: Program, snapshot: Snapshot, now: float) -> Program:
        """Returns a spoiled program, which must be declined unless it is correct by chance."""
        random, replace = self._random, msgspec.structs.replace
        stages = list(program.stages)
        k = random.randrange(len(stages))
        ways: list[Callable[[], Program]] = [
            lambda: replace(program, epoch=max(0, program.epoch - random.randint(1, 3))),
            lambda: replace(program, epoch=program.epoch + 1),
            lambda: replace(program, program=max(0, program.program - random.randint(1, 50))),
            lambda: replace(program, start=pack(random.getrandbits(self._count), self._count)),
            lambda: replace(program, start=program.start + b"\0"),
            lambda: replace(program, stages=self._with(stages, k, states=b"\xff" * len(program.start))),
            lambda: replace(program, stages=self._with(stages, k, states=b"")),
            lambda: replace(program, stages=self._with(stages, k, at=-1e12)),
            lambda: replace(program, stages=self._with(stages, k, states=pack(self._wild(), self._count))),
            lambda: replace(program, stages=self._with(stages, k, states=self._unlocking(stages[k], snapshot))),
            lambda: replace(program, stages=()),
            lambda: replace(program, until=now - random.choice([0.01, 10.0])),
            lambda: replace(program, homed=program.start + b"\0"),
            lambda: replace(program, begin=random.choice([-1e12, 1e12]), final=True),
        ]
        return random.choice(ways)()

    def _with(self, stages: list[Stage], k: int, **changes: object) -> tuple[Stage, ...]:
        return (*stages[:k], msgspec.structs.replace(stages[k], **changes), *stages[k + 1 :])

    def _wild(self) -> int:
        return self._random.getrandbits(self._count)

    def _unlocking(self, stage: Stage, snapshot: Snapshot) -> bytes:
        return pack(unpack(stage.states) ^ unpack(snapshot.locked), self._count)

    def _walk(self, states: int, locked: int, length: int, earliest: float) -> list[Stage]:
        """Returns stages within the inrush limit that switch no locked actuator."""
        random = self._random
        free = [k for k in range(self._count) if not locked >> k & 1]
        stages, at, mark = [], earliest, random.randint(0, 100)
        for _ in range(length):
            for k in random.sample(free, min(len(free), random.randint(0, self._most))):
                states ^= 1 << k
            at += random.choice([0.0, 0.01, self._travel, 2 * self._travel, 0.1])
            marked = random.random() < 0.5
            mark += marked
            settled = at + random.choice([0.0, self._travel])
            stages.append(Stage(pack(states, self._count), at, mark if marked else -1, settled if marked else 0.0))
        return stages


def commissioning(
    author: Author, random: Random, snapshot: Snapshot, number: int, now: float
) -> tuple[str, Down | None]:
    """A commissioner tries actuators, cancels, resets, and leaves: returns the name of an act, and its message if any.

    `number`: of its trial or program.
    """
    if snapshot.mode in ("fault", "stopped") and random.random() < 0.2:
        return "reset", Reset(NOBODY, snapshot.epoch)
    act = random.choices(list(TRIES), list(TRIES.values()))[0]
    match act:
        case "trial":
            return act, author.trial(snapshot, number, now)
        case "cancel":
            return act, Cancel(NOBODY, None, "canceled by a person")
        case "cancel program":
            return act, Cancel(NOBODY, number - random.randint(0, 1), "left")
        case "reset":
            return act, Reset(NOBODY, snapshot.epoch - (random.random() < 0.2 and snapshot.epoch > 0))
        case "forbidden":
            stream, drawn = author.setpoint(snapshot, number, now), author.program(snapshot, number, now)
            return act, random.choice([drawn.program, stream, Lock(NOBODY, 0, 1)])
        case _:
            return act, None

"""What the account of a world keeps: pins, stages and motions that were asked for, and SYNCs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

from hyperbit.controller import program
from hyperbit.controller.program import Ended, Program, Setpoint, Trial, unpack

EPSILON = 1e-6  # [s], rounding errors of sums of times


class Pins(NamedTuple):
    """What boards drive and end-stops read from a time on, as masks of actuators.

    Attributes:
        at: begin [s].
        states: ends to which the actuators are driven; with two coils, by the coil that was on last.
        on: one of two coils is on.
        extended: the end-stop at the extended end reads 1.
        contracted: the end-stop at the contracted end reads 1.
    """

    at: float
    states: int
    on: int
    extended: int
    contracted: int


class Stage(NamedTuple):
    """A stage of a program; of a set-point, only the states count."""

    states: int
    at: float = -math.inf
    mark: int = -1
    settled: float = 0.0


class Motion:
    """A program or trial that was accepted, or a set-point: what may move the arm, until it is barred.

    Attributes:
        message: as it arrived.
        order: of the arrival at the executor.
        begin: zero of its stages' times [s].
        stages: all stages so far.
        homes: mask of the actuators that it homes if their states are unknown.
        unsettled: whether the mark of `taken` was not told as settled.
        taken: the last stage that was told as begun.
        tried: mask of the one actuator that a trial may switch; None for others.
        strict: whether no stage is skipped, or begins before the one before has settled.
        final: whether no further stages come.
        barred_at: when a stop, a cancel, a fault or a loss took its permission [s]; infinity before.
        ended: its result; None before.
    """

    def __init__(self, message: Program | Setpoint, order: int, begin: float) -> None:
        self.message, self.order, self.begin = message, order, begin
        self.start = unpack(message.start)
        self.stages: list[Stage] = []
        self.append(0, message.stages)
        self.final = not isinstance(message, Program) or message.final
        self.homes = unpack(message.homed) if isinstance(message, Program) and message.homed else -1
        self.unsettled = False
        self.tried: int | None = None
        self.taken, self.barred_at, self.strict = -1, math.inf, message.strict
        self.ended: Ended | None = None

    @classmethod
    def of_trial(cls, trial: Trial, outputs: int, order: int, begin: float) -> Motion:
        """Returns what a trial may do from the commanded states `outputs`."""
        bit, size = 1 << trial.actuator, (max(outputs.bit_length(), trial.actuator + 1) + 7) // 8
        states = (outputs & ~bit | trial.state * bit).to_bytes(size, "little")
        stage, start = program.Stage(states, 0.0, 0, trial.watch), outputs.to_bytes(size, "little")
        made = Program(trial.program, trial.epoch, start, begin, (stage,), True, False, "trial")
        motion = cls(made, order, begin)
        motion.homes = motion.tried = bit
        return motion

    @property
    def number(self) -> int:
        return self.message.program if isinstance(self.message, Program) else self.message.stream

    def append(self, first: int, stages: Iterable[Any]) -> None:
        """Replaces the stages from `first` on."""
        self.stages[first:] = [
            Stage(unpack(stage))
            if isinstance(stage, bytes)
            else Stage(unpack(stage.states), stage.at, stage.mark, stage.settled)
            for stage in stages
        ]

    def due(self, now: float) -> list[int]:
        """Returns the states of the stages that may begin now."""
        return [stage.states for stage in self.stages[self.taken + 1 :] if self.begin + stage.at <= now + EPSILON]


class Sync(NamedTuple):
    """A SYNC that was handed out.

    Attributes:
        at: time [s].
        commanded_at: time of the RPDOs before it [s].
        program: number of the program that asked for its RPDOs; None: another motion.
        strict: whether that is strict.
        homing: mask of the actuators whose states were unknown, as told.
        asked: motions that asked for its RPDOs then, and are not barred now; with the states of their due stages.
    """

    at: float
    commanded_at: float
    program: int | None
    strict: bool
    homing: int
    asked: list[tuple[Motion, list[int]]]


class Switch(NamedTuple):
    """Changed outputs. `cause` is "SYNC", another frame, "time", "fault" or "foreign START"; `sync` that SYNC."""

    mask: int
    after: int
    cause: str
    bus: str
    sync: Sync | None


class Energised(NamedTuple):
    """Coils of actuators with two coils: those that came on, all that are on, and those that came on without effect.

    `cause` is that of `Switch`.
    """

    came: int
    on: int
    again: int
    cause: str
    bus: str
    sync: Sync | None

"""Facts of the world, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from controller.program import Accepted, Begun, Ended, Program, Replacement, Settled, unpack
from drivers.canopen.wire.cia301 import Frame


@dataclass
class Running:
    """An accepted program; `last` is the stage that the boards have reached, `taken` the one that was reported."""

    number: int
    begin: float
    strict: bool
    final: bool
    stages: list[tuple[int, float]]  # states, and their earliest times
    marks: list[int]  # of the stages
    last: int = -1
    taken: int = -1
    settled: int = -1  # the last stage whose mark was reported as settled
    skipped: bool = False  # a stage that would have switched was skipped since the last mark was taken
    unfed: float = 0.0  # time since all stages were taken, or the last ones came [s]

    @property
    def starves(self) -> bool:
        """Whether all stages were taken, and more will come."""
        return not self.final and self.taken == len(self.stages) - 1

    def replace(self, message: Replacement) -> None:
        """Records an accepted replacement."""
        self.stages[message.first :] = [(unpack(stage.states), stage.at) for stage in message.stages]
        self.marks[message.first :] = [stage.mark for stage in message.stages]
        self.strict, self.final = self.strict or message.strict, message.final
        if message.stages:
            self.unfed = 0.0

    def take(self, index: int, locked: int) -> None:
        """Records a stage that was reported."""
        if self.taken >= 0:
            if self.marks[self.taken] >= 0:
                self.skipped = False
            before = self.stages[self.taken][0]
            self.skipped |= any((states ^ before) & ~locked for states, _ in self.stages[self.taken + 1 : index])
        self.taken = index


@dataclass
class Commit:
    """RPDOs and the SYNCs after them, with requests and locked actuators at the time of the RPDOs."""

    began: float
    locked: int
    locked_states: int
    realigns: bool  # something was requested, and outputs of locked actuators differed from their locked states
    running: Running | None
    candidates: list[tuple[int, int]]  # index and states of the requested stages
    homing: int = 0  # mask of the actuators of unknown state that a request brings to `homes`
    homes: int = 0
    releases: bool = False  # a pulse was on
    synced_at: float | None = None
    switched: int = 0


class Switch(NamedTuple):
    """Changed outputs. `cause` is "SYNC", another frame, "time", "fault" or "foreign START"."""

    mask: int
    after: int
    cause: str
    bus: str
    commit: Commit | None


class Energised(NamedTuple):
    """Coils of actuators with two coils: those that came on, all that are on, and those that came on without effect.

    `cause` is that of `Switch`.
    """

    came: int
    on: int
    again: int
    cause: str
    bus: str
    commit: Commit | None


@dataclass
class Step:
    """The facts of the last step of the world."""

    frames: list[tuple[str, Frame]] = field(default_factory=list)
    booting: bool = False  # whether boards were booted when one of the frames was handed out
    switches: list[Switch] = field(default_factory=list)
    energised: list[Energised] = field(default_factory=list)
    accepted: list[tuple[Program, Accepted]] = field(default_factory=list)
    ended: list[tuple[Ended, Running | None]] = field(default_factory=list)  # with the program, if it still ran
    progress: list[tuple[Begun | Settled, Running]] = field(default_factory=list)  # in order
    errors: list[str] = field(default_factory=list)
    epochs: list[tuple[int, int]] = field(default_factory=list)  # shown epoch, and the least correct one

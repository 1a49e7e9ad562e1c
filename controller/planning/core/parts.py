"""The parts that the core's other parts share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from controller.planning.core.admission import Admission
from controller.planning.core.arm import ExecutorView
from controller.planning.core.events import Action, Payload
from controller.planning.core.jobs import Jobs, ProgramNumbers
from controller.planning.core.tasks import Scene, Tables
from controller.program import Fault, Mode


class Locks(Protocol):
    """The locked actuators, and the tables for them.

    Attributes:
        states: locked state of each actuator, 0 or 1; -1 if it is free; shape (A,).
        tables: None while they are rebuilt.
    """

    states: NDArray[np.int8]
    tables: Tables | None

    def mode(self) -> tuple[Mode, str]:
        """Returns the mode and its reason: the executor's, or those of a rebuild of the tables."""

    def faults(self) -> Iterator[Fault]:
        """Yields the faults for `state`."""


class Obstacles(Protocol):
    """The obstacles.

    Attributes:
        scene: None while a newer one is built.
        generation: of the latest obstacles.
        standing: collision of the arm where it stands, in words; None if it is clear.
    """

    scene: Scene | None
    generation: int
    standing: str | None


class ProgramReport(Protocol):
    """The report on a program; see `state` for its members."""

    id: str

    @property
    def waypoint(self) -> int | None:
        """The waypoint that the arm moves to or is at; None before the first."""

    @property
    def target(self) -> Payload | None:
        """Position and orientation that the goal gives for the present point; None for a jog."""


class RunningProgram(Protocol):
    """The program that runs."""

    @property
    def report(self) -> ProgramReport:
        """Its report."""


class Programs(Protocol):
    """The programs sent to the executor.

    Attributes:
        offered: whether a program waits for the executor's answer.
        last_accepted: number of the last accepted program.
    """

    offered: bool
    last_accepted: int

    @property
    def current(self) -> RunningProgram | None:
        """The program that runs."""


@dataclass(frozen=True)
class Parts:
    """The parts that the core's other parts share.

    Attributes:
        view: what the executor last said.
        admission: of requests and set-points.
        numbers: of programs and streams.
        jobs: tasks under way.
        locks: locked actuators.
        obstacles: all obstacles.
        programs: sent to the executor.
        act: takes actions.
    """

    view: ExecutorView
    admission: Admission
    numbers: ProgramNumbers
    jobs: Jobs
    locks: Locks
    obstacles: Obstacles
    programs: Programs
    act: Callable[[Action], None]

"""The parts of the core that others ask; each owns its facts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from controller.planning.core.admission import Admission
    from controller.planning.core.arm import ExecutorView
    from controller.planning.core.events import Action
    from controller.planning.core.jobs import Jobs, Moment, ProgramNumbers
    from controller.planning.core.locks import Locks
    from controller.planning.core.obstacles import ObstacleOwner
    from controller.planning.core.programs import Programs


@dataclass(frozen=True)
class Parts:
    """The parts of the core that others ask.

    Attributes:
        view: what the executor last said.
        admission: of requests and set-points.
        numbers: of programs and streams.
        jobs: tasks under way.
        moment: of the present step.
        act: takes actions.
        locks: locked actuators and tables.
        obstacles: all obstacles.
        programs: what is in flight.
    """

    view: ExecutorView
    admission: Admission
    numbers: ProgramNumbers
    jobs: Jobs
    moment: Moment
    act: Callable[[Action], None]
    locks: Locks
    obstacles: ObstacleOwner
    programs: Programs

"""The points of a trajectory, each with the target of its searches."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.trajectory import Trajectory
from hyperbit.controller.refusals.refusal import leg, nth_waypoint
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.search.target import SearchTarget

States = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class TrajectoryPoint:
    """One point of a trajectory, with all that its searches need."""

    index: int  # in the trajectory
    trajectory: Trajectory  # the goal
    target: SearchTarget  # position, orientation, tolerances and obstacles of its searches

    @property
    def states(self) -> States | None:
        """Actuator states (A,) if the point is given as a configuration; None: the configuration is searched."""
        return self.trajectory.fixed.get(self.index)

    @property
    def configuration(self) -> Configuration | None:
        """Configuration (B,) if the point is given as one; None: it is searched.

        Raises:
            ValueError: a locked actuator excludes it.
        """
        return None if self.states is None else self.target.manipulator.configuration(self.states)

    @property
    def between(self) -> bool:
        return self.trajectory.between(self.index)

    @property
    def place(self) -> str:
        """The name of the point in messages."""
        last = self.trajectory.last(self.index)
        if self.between:
            return leg(last)
        return nth_waypoint(last, "position" if self.states is None else "configuration")


class TrajectoryPoints:
    """The points of a trajectory for the searches of one solver. Each is built once, when it is first needed.

    Attributes:
        solver: of the arm.
        trajectory: the goal.
    """

    def __init__(self, solver: Solver, trajectory: Trajectory) -> None:
        self.solver, self.trajectory = solver, trajectory
        self._points: dict[int, TrajectoryPoint] = {}

    def __len__(self) -> int:
        return len(self.trajectory.times)

    def __getitem__(self, index: int) -> TrajectoryPoint:
        if (point := self._points.get(index)) is None:
            it = self.trajectory
            target = self.solver.target(it.goal(index), float(it.tolerances[index]), float(it.turns[index]))
            point = self._points[index] = TrajectoryPoint(index, it, target)
        return point

    def __iter__(self) -> Iterator[TrajectoryPoint]:
        return (self[index] for index in range(len(self)))

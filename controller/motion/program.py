"""A plan as stages of a motion program: packed actuator states, when each stage may begin, and marks.

Stage k of the n stages to a point begins `lead * (n - k)` before the point's time, so that the last stage has settled
at that time. The mark of a stage is the index of the point that the stage reaches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from controller.program import Stage

if TYPE_CHECKING:  # their kernels take seconds to import
    from controller.motion.pacing import Staged
    from controller.motion.plan import Plan
    from controller.motion.trajectory import Trajectory

States = NDArray[np.uint8]
Pack = Callable[[States], list[bytes]]  # packs actuator states (k, A) for the executor


@dataclass(frozen=True, eq=False)
class PointStages:
    """The stages that reach one point of a trajectory.

    Attributes:
        point: index in the trajectory; the mark of the last stage.
        stages: at least one.
        transition: the transition that the stages carry out.
    """

    point: int
    stages: tuple[Stage, ...]
    transition: Staged

    @property
    def deviation(self) -> float | None:
        """Greatest distance of the tip from the straight line; None if it is not known."""
        return self.transition.deviation

    @property
    def end(self) -> bytes:
        """Packed actuator states after the last stage."""
        return self.stages[-1].states


def pack_states(states: States) -> list[bytes]:
    """Returns actuator states (k, A) in the executor's packing: actuator a is bit a % 8 of byte a // 8."""
    return [row.tobytes() for row in np.packbits(states, axis=1, bitorder="little")]


def unpack_states(packed: bytes, actuators: int) -> States:
    """Returns actuator states (A,) from the executor's packing."""
    return np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=actuators, bitorder="little")


def point_stages(
    trajectory: Trajectory, point: int, transition: Staged, lead: float, delay: float, not_before: float, pack: Pack
) -> PointStages:
    """Returns the stages of the transition to one point.

    Args:
        trajectory: of the goal.
        point: index in it.
        transition: to the point.
        lead: time of one stage [s].
        delay: the trajectory's t = 0 in the program's time [s].
        not_before: begin of the stage before, in the program's time [s]; begins never decrease.
        pack: packs actuator states.
    """
    packed, time = pack(transition.stages), float(trajectory.times[point]) + delay
    n, last = len(packed), len(packed) - 1
    stages = tuple(
        Stage(
            states,
            max(time - lead * (n - k), not_before),
            point if k == last else -1,
            time if k == last else 0.0,
        )
        for k, states in enumerate(packed)
    )
    return PointStages(point, stages, transition)


def stages_from(
    plan: Plan, first: int, end: bytes | None, lead: float, delay: float, not_before: float, pack: Pack
) -> Iterator[PointStages]:
    """Yields the stages to each point of a plan from point `first` on.

    A point between waypoints that needs no switch has no stages and is omitted.

    Args:
        plan: the plan.
        first: index of a point.
        end: packed states after the point before; None: there is none.
        lead: time of one stage [s].
        delay: the trajectory's t = 0 in the program's time [s].
        not_before: begin of the stage before `first`, in the program's time [s].
        pack: packs actuator states.
    """
    trajectory, transitions = plan.trajectory, plan.transitions
    for point in range(first, len(transitions)):
        reached = point_stages(trajectory, point, transitions[point], lead, delay, not_before, pack)
        if reached.end == end and trajectory.between(point):
            continue
        yield reached
        end, not_before = reached.end, reached.stages[-1].at


def delay_of(trajectory: Trajectory, needed: float) -> float:
    """Returns t = 0 of a trajectory without a stamp, as a delay after the executor accepts the program [s].

    The delay gives the first point's actuators the time they need. The times between points stay as they are.

    Args:
        trajectory: the goal.
        needed: time from acceptance until the first point's actuators can have settled [s].
    """
    return max(needed - float(trajectory.times[0]), 0.0)


def in_groups(states: States, target: States, most: int) -> States:
    """Returns stages (k, A) between two actuator states (A,), with at most `most` actuators at once, base first.

    The stages may end in states that are no configuration.
    """
    changes = np.flatnonzero(states != target)
    stages, current = list[States](), states.copy()
    for start in range(0, len(changes), most):
        current = current.copy()
        group = changes[start : start + most]
        current[group] = target[group]
        stages.append(current)
    return np.array(stages or [target])


def flatten(points: Sequence[PointStages]) -> list[Stage]:
    """Returns the stages of all points, in order."""
    return [stage for point in points for stage in point.stages]

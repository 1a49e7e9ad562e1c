"""Tasks of the workers and their answers, as plain data: each answer is a function of its task.

Actuator states travel packed, as in the contract with the executor. One worker makes `tables`, `scene` and `plan`;
others use them. The core stores them, compares their generations, and does not look inside.
"""

from typing import Any, NamedTuple

import numpy as np

from hyperbit.controller.messages.goals import Plan
from hyperbit.controller.motion.decoding.goal import GoalMessage
from hyperbit.controller.motion.stages.feed import Improved, PlannedPoint, PlanProof
from hyperbit.controller.motion.stages.program import States, pack_states, unpack_states
from hyperbit.controller.motion.trajectory import Trajectory
from hyperbit.controller.program import unpack
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, Refused


class Tables(NamedTuple):  # solvers of the arm reduced by locked actuators
    generation: int  # grows with each rebuild
    locked: bytes  # locked state of each actuator, 0 or 1, 255 if it is free; A bytes
    solvers: Any = None  # of the workers; opaque


class VersionedScene(NamedTuple):  # the obstacles, those of the arm's file and those sent
    generation: int  # grows with each change
    free: bool  # whether there is nothing to collide with
    keep_out: Any = None  # swept checks; opaque


class ArmStart(NamedTuple):  # start of a plan; a plan holds for each equal start
    outputs: bytes  # of the boards; `Program.start`
    commanded: bytes  # states from which stages begin: the outputs, the locked state for a locked actuator
    states: bytes  # states to plan from: measured at rest, commanded while actuators travel
    locked: bytes  # mask of the locked actuators

    def sent(self, stages: States) -> list[bytes]:
        """Returns stages (k, A) packed for the executor: a locked actuator keeps its output."""
        if any(self.locked):
            locked, outputs = (unpack_states(states, stages.shape[1]) for states in (self.locked, self.outputs))
            stages = np.where(locked, outputs, stages)
        return pack_states(stages)

    def real(self, states: bytes) -> bytes:
        """Returns packed states of a stage with the states of locked actuators, for checks of collisions."""
        locked, told, known = (unpack(bits) for bits in (self.locked, states, self.commanded))
        return ((told & ~locked) | (known & locked)).to_bytes(len(states), "little")


class Basis(NamedTuple):  # premises of a plan; the plan is dropped after a change of any of the three
    start: ArmStart
    tables: Tables
    scene: VersionedScene


# --- tasks


class PlanGoal(NamedTuple):  # answered by `Planned`, `Refused` or `Failed`
    message: GoalMessage
    received: float  # time of arrival [UNIX s]
    bias: tuple[float, ...] | None  # tip bias that corrects the goal, dimension numbers; None: no tracker
    basis: Basis


class ImprovePlan(NamedTuple):  # answered by `Deviations` first, then by several `Improved`, at last by `Done`
    plan: Any
    begin: float  # t = 0 of the trajectory [s, the monotonic clock]
    search: bool  # False: only the deviations are wanted
    tables: Tables
    scene: VersionedScene


class PrepareSearch(NamedTuple):  # while no request waits; answered by `Done`
    basis: Basis
    rehearsal: GoalMessage | None = None  # planned without effect


class DescribePlan(NamedTuple):  # answered by `Described`, `Refused` or `Failed`
    goal: PlanGoal
    seconds: float  # longest time


class FollowSetpoint(NamedTuple):  # answered by `Followed` or `Failed`
    basis: Basis
    position: tuple[float, ...]  # of the computed tip, dimension numbers
    tolerance: float  # greatest distance from the set-point; the search uses half of it
    bias: tuple[float, ...] | None = None  # tip bias that corrected `position`, for the note; None: no tracker


class CheckStages(NamedTuple):  # answered by `Checked` or `Failed`
    scene: VersionedScene
    before: bytes  # states before the first stage; the bits of locked actuators are their states, not their outputs
    stages: tuple[bytes, ...]


class CheckStanding(NamedTuple):  # answered by `Checked` or `Failed`
    scene: VersionedScene
    states: bytes  # at rest


class BuildScene(NamedTuple):  # answered by `SceneBuilt` or `Failed`
    generation: int
    obstacles: Any  # the sent ones


class BuildTables(NamedTuple):  # takes seconds; answered by `Tables` or `Failed`
    generation: int
    locked: bytes


Search = PlanGoal | ImprovePlan | PrepareSearch | DescribePlan | FollowSetpoint
Task = Search | CheckStages | CheckStanding | BuildScene | BuildTables


# --- answers


class Planned(NamedTuple):
    trajectory: Trajectory  # the goal, corrected by the tip bias; it has as many points as `points`
    points: tuple[PlannedPoint, ...]
    proof: PlanProof
    plan: Any = None  # for `ImprovePlan`; opaque


class Deviations(NamedTuple):
    values: tuple[float | None, ...]  # of all points of a plan; None where one is not known


class Described(NamedTuple):
    plan: Plan


class Followed(NamedTuple):
    stages: tuple[bytes, ...]  # packed states after each stage; empty: the arm stays
    note: str  # why it stays; completes a sentence from "following a setpoint"; "" if it moves
    found: bool  # whether a configuration within the tolerance was found
    seconds: float  # time of the search


class Checked(NamedTuple):
    collision: str | None  # the first one, in words; None if all states are clear


class SceneBuilt(NamedTuple):
    scene: VersionedScene
    total: int  # number of all obstacles
    sent: int  # number of obstacles that were sent


class Done(NamedTuple):  # the task has ended; there is nothing to tell
    pass


class Failed(NamedTuple):  # an exception ended the task
    reason: str  # its last line; the log has the rest


Answer = (
    Planned | Deviations | Improved | Described | Followed | Checked | SceneBuilt | Tables | Done | Refused | Failed
)


def refusal_of(answer: Answer) -> Refusal:
    return answer.refusal if isinstance(answer, Refused) else Refusal(Reason.PLANNING_FAILED)


def collision_of(answer: Answer) -> str | None:
    """Returns the collision in an answer, in words; a failed check counts as a collision."""
    return answer.collision if isinstance(answer, Checked) else "a collision check failed, see the journal"

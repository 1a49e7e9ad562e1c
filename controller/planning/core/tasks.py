"""Tasks of the workers and their answers, as plain data: what a worker computes is a function of its task.

Actuator states travel packed, as in the contract with the executor. `tables`, `scene` and `plan` are made by one worker
and used by others. The core stores them, compares their generations, and does not look inside.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from controller.motion.feed import Improved, PlannedPoint, Proof
from controller.motion.goal import GoalMessage
from controller.motion.trajectory import Trajectory


class Tables(NamedTuple):
    """The solvers of the arm reduced by locked actuators.

    Attributes:
        generation: grows with each rebuild.
        locked: locked state of each actuator, 0 or 1, 255 if it is free; A bytes.
        solvers: of the workers; opaque.
    """

    generation: int
    locked: bytes
    solvers: Any = None


class Scene(NamedTuple):
    """The obstacles, those of the arm's file and those sent.

    Attributes:
        generation: grows with each change.
        free: whether there is nothing to collide with.
        keep_out: swept checks; opaque.
    """

    generation: int
    free: bool
    keep_out: Any = None


class ArmStart(NamedTuple):
    """Where a plan starts. Two starts are equal if a plan from one is a plan from the other.

    Attributes:
        outputs: of the boards; `Program.start`.
        commanded: states from which stages begin: the outputs, the locked state for a locked actuator.
        states: states to plan from: measured at rest, commanded while actuators travel.
        locked: mask of the locked actuators.
    """

    outputs: bytes
    commanded: bytes
    states: bytes
    locked: bytes


# --- tasks


class PlanGoal(NamedTuple):
    """Plan a goal. Answered by `Planned`, `Refused` or `Failed`.

    Attributes:
        received: time of arrival [UNIX s].
        start: where the arm is, or where its running stage ends.
        bias: tip bias that corrects the goal, dimension numbers; None: no tracker.
    """

    message: GoalMessage
    received: float
    start: ArmStart
    bias: tuple[float, ...] | None
    tables: Tables
    scene: Scene


class ImprovePlan(NamedTuple):
    """Improve a running plan. Answered by `Deviations` first, then by several `Improved`, at last by `Done`.

    Attributes:
        begin: t = 0 of the trajectory [s, the monotonic clock].
        search: False: only the deviations are wanted.
    """

    plan: Any
    begin: float
    search: bool
    tables: Tables
    scene: Scene


class PrepareSearch(NamedTuple):
    """Prepare the next search while no request waits. Answered by `Done`.

    Attributes:
        rehearsal: a goal to plan without effect, so that the processor's caches are warm; None: none.
    """

    start: ArmStart
    tables: Tables
    scene: Scene
    rehearsal: GoalMessage | None = None


class DescribePlan(NamedTuple):
    """Plan a goal without running it. Answered by `Described`, `Refused` or `Failed`; see `PlanGoal`.

    Attributes:
        goal: its id.
        seconds: time after which the query is refused [s].
    """

    goal: str
    message: GoalMessage
    received: float
    start: ArmStart
    bias: tuple[float, ...] | None
    tables: Tables
    scene: Scene
    seconds: float


class FollowSetpoint(NamedTuple):
    """Search the configuration for a followed set-point. Answered by `Followed` or `Failed`.

    Attributes:
        position: of the computed tip, dimension numbers.
        tolerance: greatest distance from the set-point; the search uses half of it.
        bias: tip bias that corrects `position`, dimension numbers, for the note; None: no tracker.
    """

    start: ArmStart
    position: tuple[float, ...]
    tolerance: float
    tables: Tables
    scene: Scene
    bias: tuple[float, ...] | None = None


class CheckStages(NamedTuple):
    """Check consecutive stages for collisions. Answered by `Checked` or `Failed`.

    Attributes:
        before: packed states before the first stage, with the states of locked actuators.
        stages: packed states after each stage, likewise.
    """

    scene: Scene
    before: bytes
    stages: tuple[bytes, ...]


class CheckStanding(NamedTuple):
    """Check states at rest for a collision. Answered by `Checked` or `Failed`."""

    scene: Scene
    states: bytes


class BuildScene(NamedTuple):
    """Build the swept checks of obstacles. Answered by `SceneBuilt` or `Failed`.

    Attributes:
        generation: of the new scene.
        obstacles: those that were sent, without those of the arm's file; opaque.
    """

    generation: int
    obstacles: Any


class BuildTables(NamedTuple):
    """Build the solvers for locked states; takes seconds. Answered by `TablesBuilt` or `Failed`."""

    generation: int
    locked: bytes


Task = (
    PlanGoal
    | ImprovePlan
    | PrepareSearch
    | DescribePlan
    | FollowSetpoint
    | CheckStages
    | CheckStanding
    | BuildScene
    | BuildTables
)


# --- answers


class Planned(NamedTuple):
    """The plan of a goal.

    Attributes:
        trajectory: the goal, corrected by the tip bias.
        points: one for each point of the trajectory.
        plan: for `ImprovePlan`; opaque.
    """

    trajectory: Trajectory
    points: tuple[PlannedPoint, ...]
    proof: Proof
    plan: Any = None


class Deviations(NamedTuple):
    """The deviations of all points of a plan; None where one is not known."""

    values: tuple[float | None, ...]


class Described(NamedTuple):
    """The payload of a planned goal."""

    payload: dict[str, Any]


class Followed(NamedTuple):
    """The stages to a set-point.

    Attributes:
        stages: packed states after each stage; empty: the arm stays.
        note: why it stays, as the end of a sentence that begins "following a setpoint"; "" if all is well.
        found: whether a configuration within the tolerance was found.
        seconds: time of the search [s].
    """

    stages: tuple[bytes, ...]
    note: str
    found: bool
    seconds: float


class Checked(NamedTuple):
    """The first collision of the checked stages, in words; None if all are clear."""

    collision: str | None


class SceneBuilt(NamedTuple):
    """A new scene.

    Attributes:
        total: number of all obstacles.
        sent: number of those sent.
    """

    scene: Scene
    total: int
    sent: int


class TablesBuilt(NamedTuple):
    """New tables."""

    tables: Tables


class Done(NamedTuple):
    """The task has ended; there is nothing to tell."""


class Refused(NamedTuple):
    """The goal cannot be carried out; a code of FollowJointTrajectory, and why."""

    code: int
    reason: str


class Failed(NamedTuple):
    """An exception ended the task; `reason` is its last line, the log has the rest."""

    reason: str


Answer = (
    Planned
    | Deviations
    | Improved
    | Described
    | Followed
    | Checked
    | SceneBuilt
    | TablesBuilt
    | Done
    | Refused
    | Failed
)

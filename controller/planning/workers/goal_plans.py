"""Plans goals, and prepares searches while no goal waits."""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain
from typing import NamedTuple

import numpy as np

from controller.manipulator.manipulator import Configuration
from controller.motion import codes
from controller.motion.codes import Refusal
from controller.motion.feed import PlannedPoint, Proof, most_stages
from controller.motion.goal import schedule
from controller.motion.pacing import Staged
from controller.motion.plan import Plan
from controller.motion.point_by_point import PLANNING_TIME, plan
from controller.motion.restaging import restage
from controller.motion.trajectory import Trajectory
from controller.planning.core.tasks import ArmStart, DescribePlan, Done, PlanGoal, Planned, PrepareSearch
from controller.planning.workers.arm_model import ArmModel, Proceed, States
from controller.planning.workers.keep_out import KeepOutSet
from controller.program import MOST_PROGRAM_STAGES
from controller.search.solver import Solver


class PlannedGoal(NamedTuple):
    """A plan with what its improvement needs; `Planned.plan`.

    Attributes:
        plan: from the configuration of `start.states`.
        first: transition to the first point from `start.commanded`.
        points: of `Planned`.
        start: where the plan starts.
        tables: generation of the tables that the plan's configurations belong to.
    """

    plan: Plan
    first: Staged
    points: tuple[PlannedPoint, ...]
    start: ArmStart
    tables: int


class FoundPlan(NamedTuple):
    """A plan, the configuration (B,) before it, and the solver that found it."""

    plan: Plan
    previous: Configuration
    solver: Solver


def plan_goal(model: ArmModel, task: PlanGoal, proceed: Proceed) -> Planned:
    """Returns the plan of a goal.

    The plan starts from `start.states`; the stages start from `start.commanded`. The two differ at rest if an actuator
    has not followed its output. The proof counts switches from `start.states`, the points count those of their stages.

    Raises:
        Refusal: there is no plan.
        Abandoned: `proceed` has raised it.
    """
    trajectory = schedule_goal(model, task)
    found = search_plan(model, task, trajectory, proceed, PLANNING_TIME).plan
    first = stage_first(model, task, found.transitions[0], proceed)
    transitions = found.transitions
    if first is not transitions[0]:
        transitions = (first, *transitions[1:])
        check_size(model, transitions)
    points = tuple(points_of(model, task.start, model.unpack(task.start.commanded), transitions))
    opaque = PlannedGoal(found, first, points, task.start, task.tables.generation)
    return Planned(trajectory, points, proof_of(found), opaque)


def schedule_goal(model: ArmModel, task: PlanGoal | DescribePlan) -> Trajectory:
    """Returns the trajectory of a goal, corrected by the tip bias.

    Raises:
        Refusal: the goal is invalid, or a position is farther than the arm's length; the message names the field.
    """
    arm, manipulator, message = model.arm, model.arm.manipulator, task.message
    base, tracker = manipulator.base[: manipulator.dimension, 3], arm.settings.tracker
    farthest = manipulator.length + (tracker.clamp if tracker else 0.0)
    for k, waypoint in enumerate(message.waypoints):
        position = waypoint.position
        if position is None or len(position) != len(base):
            continue
        away = math.dist(position, base)
        if away > farthest + (message.tolerance.position or arm.tolerance):
            where = f"waypoints[{k}].position: ({', '.join(f'{x:g}' for x in position)}) is out of reach"
            words = f"{where}: {away:g} from the base, and no tip is farther from it than {farthest:g}"
            raise Refusal(codes.GOAL_TOLERANCE_VIOLATED, words, message.id)
    scheduled = schedule(
        message, manipulator.dimension, arm.tolerance, arm.angle_tolerance, model.pace, task.received, manipulator
    )
    return scheduled.corrected(None if task.bias is None else np.array(task.bias))


def search_plan(
    model: ArmModel, task: PlanGoal | DescribePlan, trajectory: Trajectory, proceed: Proceed, seconds: float
) -> FoundPlan:
    """Returns a plan whose stages are clear.

    Args:
        model: of the arm.
        task: with start, tables and scene.
        trajectory: the goal.
        proceed: called before each point, and before each check of a stage.
        seconds: time for the searches of all points [s].

    Raises:
        Refusal: there is no plan.
    """
    solver, keep_out = model.solver(task.tables, task.scene), task.scene.keep_out
    previous = model.configuration(task.start, solver.manipulator)
    found = plan(solver, trajectory, previous, model.arm.settings.method, proceed, model.pace, seconds)
    check_size(model, found.transitions)
    # All stages are checked, so that the executor need not ask. Most results are known from the planning.
    stages = stages_of(found.transitions)
    collision = None if task.scene.free else keep_out.first_collision(model.unpack(task.start.states), stages, proceed)
    if collision is not None:
        raise Refusal(codes.GOAL_TOLERANCE_VIOLATED, f"the plan would collide: {collision}")
    return FoundPlan(found, previous, solver)


def check_size(model: ArmModel, transitions: Sequence[Staged]) -> None:
    """Checks that the executor accepts the size of a plan.

    Raises:
        Refusal: it has too many stages.
    """
    counts = [len(transition.stages) for transition in transitions]
    most = most_stages(len(model.arm.manipulator.actuators))
    if max(counts) > most or sum(counts) > MOST_PROGRAM_STAGES:
        raise Refusal(
            codes.INVALID_GOAL,
            f"the plan has {sum(counts)} stages, {max(counts)} to one point; at most {MOST_PROGRAM_STAGES} and"
            f" {most} are accepted: send fewer waypoints",
        )


def stage_first(model: ArmModel, task: PlanGoal, planned: Staged, proceed: Proceed) -> Staged:
    """Returns the transition to the first point from `start.commanded`.

    Planned stages among obstacles stay if they are clear from there, because they may contain detours.

    Raises:
        Refusal: the stages would collide.
    """
    if task.start.commanded == task.start.states:
        return planned
    keep_out: KeepOutSet = task.scene.keep_out
    commanded, manipulator = model.unpack(task.start.commanded), model.arm.manipulator
    most = model.pace.inrush or len(commanded)
    if not task.scene.free:
        rows = np.vstack([commanded, planned.stages])
        fits = np.count_nonzero(rows[1:] != rows[:-1], axis=1).max() <= most
        if fits and keep_out.first_collision(commanded, planned.stages, proceed) is None:
            return planned
    stages = restage(manipulator, commanded, planned.stages, most)
    collision = None if task.scene.free else keep_out.first_collision(commanded, stages, proceed)
    if collision is not None:
        raise Refusal(codes.INVALID_GOAL, f"the motion from the arm's present state would collide: {collision}")
    return planned if np.array_equal(stages, planned.stages) else Staged(stages, None, planned.strict)


def points_of(
    model: ArmModel, start: ArmStart, before: States, transitions: Sequence[Staged], first: int = 0
) -> Iterator[PlannedPoint]:
    """Yields the points of consecutive transitions, with the deviations that are known without computing them.

    Args:
        model: of the arm.
        start: of the plan.
        before: actuator states before the first transition, shape (A,).
        transitions: at least one.
        first: index of the first point.
    """
    states = np.concatenate([before[None], *(transition.stages for transition in transitions)])
    packed = model.pack(start, states[1:])
    ends = np.cumsum([len(transition.stages) for transition in transitions])
    begins = np.concatenate([[0], ends[:-1]])
    switches = np.add.reduceat(np.count_nonzero(states[1:] != states[:-1], axis=1), begins)
    rows = zip(transitions, begins.tolist(), ends.tolist(), switches.tolist(), strict=True)
    for point, (transition, begin, end, count) in enumerate(rows, first):
        source = transition.deviation_source
        yield PlannedPoint(point, tuple(packed[begin:end]), None if callable(source) else source, count)


def proof_of(found: Plan) -> Proof:
    """Returns what is proven of a plan, from the configuration of `start.states`, in Python's own numbers."""
    return Proof(int(found.switches), float(found.cost), float(found.bound), found.certificate)


def stages_of(transitions: Sequence[Staged]) -> Iterator[States]:
    """Yields the actuator states (A,) after each stage of transitions."""
    return chain.from_iterable(transition.stages for transition in transitions)


def prepare_search(model: ArmModel, task: PrepareSearch, proceed: Proceed) -> Done:
    """Prepares the next search of a goal from the arm's state; `proceed` is called between two parts."""
    solver = model.solver(task.tables, task.scene)
    if model.arm.settings.method != "minimum-switch":
        return Done()
    with suppress(Refusal):
        previous = model.configuration(task.start, solver.manipulator)
        for _ in solver.expect(previous, model.arm.tolerance):
            proceed()
        if task.rehearsal is not None:
            plan_goal(model, PlanGoal(task.rehearsal, 0.0, task.start, None, task.tables, task.scene), proceed)
    return Done()

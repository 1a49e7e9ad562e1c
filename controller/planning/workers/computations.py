"""Computations of the workers: each answer is a function of its task. For searches and stages see controller/motion."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import chain, islice
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator.locked import lock_actuators, transferred
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.motion.decoding.goal import GoalMessage, GoalRules, Waypoint, schedule
from hyperbit.controller.motion.plans.description import describe_plan
from hyperbit.controller.motion.plans.improvement import Improvement, changed_points
from hyperbit.controller.motion.plans.plan import TrajectoryPlan
from hyperbit.controller.motion.plans.point_by_point import PLANNING_TIME, PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner, first_transition
from hyperbit.controller.motion.plans.whole import WHOLE_TIME, first_time, look_ahead
from hyperbit.controller.motion.stages.feed import Improved, PlannedPoint, PlanProof, most_stages
from hyperbit.controller.motion.stages.pacing import Blocked, Staged, pace_of
from hyperbit.controller.motion.stages.program import unpack_states
from hyperbit.controller.motion.tracking.following import SetpointQuery, find, stages_to
from hyperbit.controller.obstacles.keep_out import KeepOutSet, States
from hyperbit.controller.obstacles.single_switches import arm_switches
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.tasks import ArmStart
from hyperbit.controller.program import MOST_PROGRAM_STAGES
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.method import MINIMUM_SWITCH
from hyperbit.controller.search.search_time import search_time
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities

MOST_THREADS = 2  # of one plan: one searches a way around obstacles, one a proof that there is none

# Called between two parts of a task. Returns whether the task must end soon. Raises Abandoned if the task is no longer
# needed, Refusal if its time is over.
Proceed = Callable[[], bool]
MakeSolver = Callable[[Manipulator, Densities, NDArray[np.float64]], Solver]


class Abandoned(Exception):
    pass


class ArmModel:
    """The arm for one worker. Not thread-safe, because the memory of its solver is not."""

    def __init__(self, arm: Arm, worker: Literal["goals", "queries", "setpoints"]) -> None:
        self.arm, self.pace, self._worker = arm, pace_of(arm.settings), worker
        whole = arm.manipulator
        self.rules = GoalRules(whole.dimension, arm.tolerance, arm.angle_tolerance, self.pace, whole)
        self._generations = (-1, -1)  # of tables and obstacles of the latest solver
        self._solver: Solver | None = None
        self._rehearsed = False

    def solver(self, tables: tasks.Tables, scene: tasks.VersionedScene) -> Solver:
        generations = tables.generation, scene.generation
        if self._solver is None or generations != self._generations:
            solver: Solver = tables.solvers[self._worker]
            if not scene.free:
                clearance = scene.keep_out.clearance
                if solver.manipulator is not clearance.manipulator:
                    clearance = self.arm.clearance(solver.manipulator, scene.keep_out.sent)
                solver = solver.avoiding(clearance)
            self._solver, self._generations = solver, generations
        return self._solver

    def first_rehearsal(self) -> GoalMessage | None:
        """Returns a goal far from most configurations, once, so that the first goal waits for no machine code."""
        if self._rehearsed:
            return None
        self._rehearsed, arm = True, self.arm.reduced
        tip = arm.tip(arm.states - 1)[: arm.dimension, 3]
        return GoalMessage([Waypoint(position=tip.tolist())])

    def unpack(self, packed: bytes) -> States:
        return unpack_states(packed, len(self.arm.manipulator.actuators))

    def configuration(self, start: tasks.ArmStart, reduced: Manipulator) -> Configuration:
        """Returns the configuration (B,) of the reduced arm to plan from, or raises Refusal."""
        whole = self.arm.manipulator
        try:
            configuration = whole.configuration(self.unpack(start.states))
        except ValueError as error:
            why = f"what the boards measure is no configuration: {error}"
            raise Refusal(Reason.UNKNOWN_STATE, why=why) from None
        try:
            return transferred(configuration, whole, reduced)
        except ValueError:
            raise Refusal(Reason.LOCKS_CHANGING) from None


def build_tables(
    arm: Arm, densities: Densities, weights: NDArray[np.float64], task: tasks.BuildTables, make: MakeSolver = Solver
) -> tasks.Tables:
    """Returns the solvers for locked states.

    `densities` are of the arm reduced by the locked states of its file; others are mapped, which takes seconds.
    `weights` are the costs of a switch of each actuator, shape (A,). `make` makes a solver.

    Raises:
        ValueError: a module has no state with these locks.
    """
    locked = np.frombuffer(task.locked, dtype=np.int8)  # 255 becomes -1
    reduced = arm.reduced
    if not np.array_equal(locked, arm.locked):
        reduced = lock_actuators(arm.manipulator, locked)
        densities = map_densities(reduced, arm.pixel, arm.level_pixels)
    goals = make(reduced, densities, weights)
    goals.prepare()
    arm_switches(reduced)  # a goal among obstacles needs them at once
    solvers = {"goals": goals, "queries": goals.another(), "setpoints": goals.another()}  # all with the same tables
    return tasks.Tables(task.generation, task.locked, solvers)


def build_scene(arm: Arm, task: tasks.BuildScene) -> tasks.SceneBuilt:
    keep_out = KeepOutSet(arm.clearance(others=task.obstacles), task.obstacles)
    scene = tasks.VersionedScene(task.generation, keep_out.free, keep_out)
    return tasks.SceneBuilt(scene, len(keep_out.clearance.obstacles), len(task.obstacles))


# --- goals


class PlannedGoal(NamedTuple):  # a plan with data for its improvement; `Planned.plan`
    plan: TrajectoryPlan  # from the configuration of `start.states`
    first: Staged  # transition to the first point from `start.commanded`
    points: tuple[PlannedPoint, ...]  # of `Planned`
    start: ArmStart
    tables: int  # their generation


def plan_goal(model: ArmModel, task: tasks.PlanGoal, proceed: Proceed) -> tasks.Planned:
    """Returns the plan of a goal.

    The plan starts from `start.states`; the stages start from `start.commanded`. The two differ at rest if an actuator
    has not followed its output. The proof counts switches from `start.states`, the points count those of their stages.

    Raises Refusal if there is no plan, and the exceptions of `proceed`.
    """
    start, planner = task.basis.start, planner_of(model, task)
    found = search_plan(model, task, planner, PLANNING_TIME, proceed)
    first, *others = transitions = found.transitions
    if start.commanded != start.states:
        arm, keep_out, commanded = model.arm.manipulator, task.basis.scene.keep_out, model.unpack(start.commanded)
        first = first_transition(arm, model.pace, keep_out, commanded, first, proceed)
        transitions = (first, *others)
        check_size(model, transitions)
    points = tuple(points_of(model, start, start.commanded, transitions))
    opaque = PlannedGoal(found, first, points, start, task.basis.tables.generation)
    return tasks.Planned(found.trajectory, points, proof_of(found), opaque)


def planner_of(model: ArmModel, task: tasks.PlanGoal) -> TransitionPlanner:
    """Returns the planner of a goal's trajectory, corrected by the tip bias; raises Refusal if the goal is invalid."""
    scheduled = schedule(task.message, model.rules, task.received)
    trajectory = scheduled.corrected(None if task.bias is None else np.array(task.bias))
    return TransitionPlanner(model.solver(task.basis.tables, task.basis.scene), trajectory, model.pace)


def search_plan(
    model: ArmModel, goal: tasks.PlanGoal, planner: TransitionPlanner, first: float, proceed: Proceed
) -> TrajectoryPlan:
    """Returns a plan whose stages are clear, or raises Refusal; calls `proceed` repeatedly.

    `first` [s] is the time for all its points together.
    """
    basis, settings = goal.basis, model.arm.settings
    previous = model.configuration(basis.start, planner.solver.manipulator)
    allowed = search_time(first, settings.planning.seconds_per_switch, goal.message.deadline)
    threads = max(1, min(settings.planning.workers, MOST_THREADS))
    found = PointByPoint(planner, settings.method, allowed, threads).plan(previous, proceed)
    check_size(model, found.transitions)
    # All stages are checked, so that the executor need not ask. Most results are known from the planning.
    before, stages = model.unpack(basis.start.states), chain.from_iterable(t.stages for t in found.transitions)
    if (collision := basis.scene.keep_out.first_collision(before, stages, proceed)) is not None:
        raise Refusal(Reason.PLAN_COLLIDES, collision=collision)
    return found


def check_size(model: ArmModel, transitions: Sequence[Staged]) -> None:
    counts = [len(transition.stages) for transition in transitions]
    total, longest, most = sum(counts), max(counts), most_stages(len(model.arm.manipulator.actuators))
    if longest > most or total > MOST_PROGRAM_STAGES:
        raise Refusal(Reason.TOO_MANY_STAGES, total=total, longest=longest, most=MOST_PROGRAM_STAGES, most_to_one=most)


def points_of(
    model: ArmModel, start: ArmStart, before: bytes, transitions: Sequence[Staged], first: int = 0
) -> Iterator[PlannedPoint]:
    """Yields the points of consecutive transitions, with already known deviations.

    `before` is packed; its bits of locked actuators do not matter. `first` is the index of the first point.
    """
    stages = [transition.stages for transition in transitions]
    packed = iter(start.sent(stages[0] if len(stages) == 1 else np.concatenate(stages)))
    free, last = ~int.from_bytes(start.locked), int.from_bytes(before)
    for point, transition in enumerate(transitions, first):
        own, switches = tuple(islice(packed, len(transition.stages))), 0
        for stage in own:
            switches += (((bits := int.from_bytes(stage)) ^ last) & free).bit_count()
            last = bits
        source = transition.deviation_source
        yield PlannedPoint(point, own, None if callable(source) else source, switches)


def proof_of(found: TrajectoryPlan) -> PlanProof:
    """Returns the proof of a plan from the configuration of `start.states`, in Python's own numbers."""
    return PlanProof(int(found.switches), float(found.cost), float(found.bound), found.certificate)


def improve(model: ArmModel, task: tasks.ImprovePlan, proceed: Proceed) -> Iterator[tasks.Deviations | Improved]:
    """Yields the deviations of a plan, then each improvement whose stages are clear; calls `proceed` between."""
    goal: PlannedGoal = task.plan
    deviations = list[float | None]()
    for transition in (goal.first, *goal.plan.transitions[1:]):
        proceed()
        deviations.append(transition.deviation)
    yield tasks.Deviations(tuple(deviations))
    same_arm = goal.tables == task.tables.generation
    if not task.search or not same_arm or model.arm.settings.method != MINIMUM_SWITCH:
        return
    current, keep_out = goal.plan, task.scene.keep_out
    points = [point._replace(deviation=d) for point, d in zip(goal.points, deviations, strict=True)]
    planner = TransitionPlanner(model.solver(task.tables, task.scene), current.trajectory, model.pace)
    for better in Improvement(planner, current, task.begin, proceed).plans():
        proceed()
        if (changed := changed_points(current, better)) is None:
            continue
        transitions, before = better.transitions[changed], better.transitions[changed.start - 1].stages[-1]
        stages = chain.from_iterable(transition.stages for transition in transitions)
        if keep_out.first_collision(before, stages, proceed) is not None:
            continue
        new = points_of(model, goal.start, points[changed.start - 1].stages[-1], transitions, changed.start)
        points[changed] = [
            point._replace(deviation=transition.deviation) for point, transition in zip(new, transitions, strict=True)
        ]
        current = better
        yield Improved(changed.start, tuple(points[changed.start :]), proof_of(current))


def prepare_search(model: ArmModel, task: tasks.PrepareSearch, proceed: Proceed) -> tasks.Done:
    solver = model.solver(task.basis.tables, task.basis.scene)
    if model.arm.settings.method != MINIMUM_SWITCH:
        return tasks.Done()
    with suppress(Refusal):
        previous = model.configuration(task.basis.start, solver.manipulator)
        for _ in solver.expect(previous, model.arm.tolerance):
            proceed()
        if (rehearsal := task.rehearsal or model.first_rehearsal()) is not None:
            short = msgspec.structs.replace(rehearsal, deadline=PLANNING_TIME)
            plan_goal(model, tasks.PlanGoal(short, 0.0, None, task.basis), proceed)
    return tasks.Done()


def describe(model: ArmModel, task: tasks.DescribePlan, proceed: Proceed, hurry: Callable[[], bool]) -> tasks.Described:
    """Returns the description of a plan. Raises Refusal if there is none, or if planning took too long.

    `hurry` returns whether the search over the whole trajectory must end early.
    """
    planner, message = planner_of(model, task.goal), task.goal.message
    clock = planner.solver.clock
    began = clock.now()

    def in_time() -> bool:
        proceed()
        if clock.now() > began + task.seconds:
            raise Refusal(Reason.PLANNING_TOO_LONG, seconds=task.seconds)
        return hurry()

    reduced = planner.solver.manipulator
    found = search_plan(model, task.goal, planner, first_time(planner.trajectory), in_time)
    previous = model.configuration(task.goal.basis.start, reduced)
    if model.arm.settings.method == MINIMUM_SWITCH:
        left = WHOLE_TIME if message.deadline is None else began + message.deadline - clock.now()
        found = look_ahead(planner, found, previous, left, hurry)
    return tasks.Described(describe_plan(model.arm.manipulator, reduced, previous, found, model.pace))


# --- set-points


def follow(model: ArmModel, task: tasks.FollowSetpoint) -> tasks.Followed:
    arm_start, tables, scene = task.basis
    solver = model.solver(tables, scene)
    try:
        start = model.configuration(arm_start, solver.manipulator)
    except Refusal as refusal:
        return tasks.Followed((), f", which is not possible now: {refusal}", False, 0.0)
    commanded, goal = model.unpack(arm_start.commanded), np.array(task.position)
    # The arm may lag behind a moving set-point by the other half of the tolerance.
    target = solver.target(goal, task.tolerance / 2)
    query = SetpointQuery(solver, scene.keep_out, commanded, start, target)
    began = solver.clock.now()
    found = find(query, model.arm.settings.method)
    seconds = solver.clock.now() - began
    if found.error > task.tolerance:
        where = ", ".join(f"{x:.4f}" for x in (goal if task.bias is None else goal + task.bias))
        words = f", which {found.reach} at ({where}): {found.error:.4f} away, tolerance {task.tolerance:g}"
        return tasks.Followed((), words, False, seconds)
    if not found.switches:
        return tasks.Followed((), "", True, seconds)
    try:
        stages = stages_to(query, found.configuration, model.arm.manipulator, model.pace)
    except Blocked as blocked:
        return tasks.Followed((), f", but the transition to it is blocked: {blocked}", True, seconds)
    return tasks.Followed(tuple(arm_start.sent(stages)), "", True, seconds)


# --- collisions


def check_stages(task: tasks.CheckStages, proceed: Proceed) -> tasks.Checked:
    keep_out: KeepOutSet = task.scene.keep_out
    before, *stages = (unpack_states(states, keep_out.actuators) for states in (task.before, *task.stages))
    return tasks.Checked(keep_out.first_collision(before, stages, proceed))


def check_standing(task: tasks.CheckStanding) -> tasks.Checked:
    """Returns the collision of the arm at rest; None if its states form no configuration."""
    keep_out: KeepOutSet = task.scene.keep_out
    return tasks.Checked(keep_out.collision_at(unpack_states(task.states, keep_out.actuators)))

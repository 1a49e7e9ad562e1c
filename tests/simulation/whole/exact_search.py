"""Exact answers to the tasks of the planner's workers, by listing all configurations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from random import Random
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.motion.decoding.goal import GoalRules, schedule
from hyperbit.controller.motion.stages.feed import Improved, PlannedPoint, PlanProof
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.motion.stages.program import restage, unpack_states
from hyperbit.controller.motion.trajectory import Trajectory
from hyperbit.controller.planning.core.tasks import (
    Answer,
    ArmStart,
    BuildScene,
    BuildTables,
    Checked,
    CheckStages,
    CheckStanding,
    Described,
    DescribePlan,
    Deviations,
    Done,
    Followed,
    FollowSetpoint,
    ImprovePlan,
    PlanGoal,
    Planned,
    SceneBuilt,
    Tables,
    Task,
    VersionedScene,
)
from hyperbit.controller.program import pack, unpack
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from tests.simulation.whole.configurations import Configurations, Costs, Graph, cubes_of, first_touched
from tests.simulation.whole.planned_arms import integer


class FoundPlan(NamedTuple):
    """A plan; `Planned.plan`.

    Attributes:
        start: where it starts.
        trajectory: of the goal.
        goals: number of the configuration at each point.
        bound: least cost of any plan.
    """

    start: ArmStart
    trajectory: Trajectory
    goals: list[int]
    bound: float


class ExactSearch:
    """Answers tasks; each answer is a function of its task and of drawn choices among equal plans.

    Attributes:
        errs: share of the plans that miss a waypoint.
    """

    def __init__(self, arm: Arm, space: Configurations, random: Random) -> None:
        self._arm, self._space, self._random = arm, space, random
        self.errs = 0.0
        self._size, self._pace = len(arm.manipulator.actuators), pace_of(arm.settings)

    def answers(self, task: Task) -> Iterator[Answer]:
        """Yields the answers of a task in order; one, but for improvements."""
        try:
            match task:
                case PlanGoal():
                    yield self._plan(task, errs=self._random.random() < self.errs)
                case DescribePlan():
                    planned = self._plan(task.goal)
                    yield Described(described(task, planned))
                case ImprovePlan():
                    yield from self._improve(task)
                case FollowSetpoint():
                    yield self._follow(task)
                case CheckStages(scene, before, stages):
                    yield Checked(first_touched(scene.keep_out, unpack(before), [*map(unpack, stages)]))
                case CheckStanding(scene, states):
                    yield Checked(first_touched(scene.keep_out, unpack(states), [unpack(states)]))
                case BuildScene(generation, obstacles):
                    cubes = cubes_of(obstacles)
                    yield SceneBuilt(VersionedScene(generation, not cubes, cubes), len(cubes), len(cubes))
                case BuildTables(generation, locked):
                    yield Tables(generation, locked)
                case _:
                    yield Done()
        except Refusal as refusal:
            yield refusal.data

    def trajectory(self, task: PlanGoal) -> Trajectory:
        """Returns the trajectory of a goal, corrected by the tip bias."""
        arm, manipulator = self._arm, self._arm.manipulator
        bias = None if task.bias is None else np.array(task.bias)
        rules = GoalRules(manipulator.dimension, arm.tolerance, arm.angle_tolerance, self._pace, manipulator)
        return schedule(task.message, rules, task.received).corrected(bias)

    def wanted(self, trajectory: Trajectory) -> list[NDArray[np.bool_]]:
        """Returns which configurations serve each point of a trajectory."""
        sets = []
        for k, (position, tolerance) in enumerate(
            zip(trajectory.positions, trajectory.tolerances.tolist(), strict=True)
        ):
            fits = self._space.near(position, tolerance)
            if trajectory.turns[k] < np.inf:
                fits &= self._space.turned(trajectory.rotations[k], float(trajectory.turns[k]))
            if k in trajectory.fixed:
                code = unpack(np.packbits(trajectory.fixed[k], bitorder="little").tobytes())
                fits = self._space.codes == code
            sets.append(fits)
        return sets

    def _graph(self, tables: Tables, scene: VersionedScene) -> Graph:
        cubes = () if scene.free else scene.keep_out
        return self._space.graph(locked_mask(tables), locked_states(tables), cubes)

    def _start(self, start: ArmStart, graph: Graph, tables: Tables) -> int:
        """Returns the configuration to plan from.

        Raises:
            Refusal: there is none with the locks of the tables, or it is in an obstacle.
        """
        number = self._space.index.get(unpack(start.states))
        if number is None:
            raise Refusal(Reason.NO_CONFIGURATION)
        if not graph.permitted[number] and (self._space.codes[number] ^ locked_states(tables)) & locked_mask(tables):
            raise Refusal(Reason.NO_CONFIGURATION)
        if not graph.permitted[number]:
            raise Refusal(Reason.ARM_IN_OBSTACLE)
        return number

    def _plan(self, task: PlanGoal, errs: bool = False) -> Planned:
        arm_start, tables, scene = task.basis
        trajectory, graph = self.trajectory(task), self._graph(tables, scene)
        start, wanted = self._start(arm_start, graph, tables), self.wanted(trajectory)
        layers = self._space.layers(graph, start, wanted)
        bound = float(layers[-1].min())
        if bound == np.inf:
            raise self._unreachable(trajectory, wanted, graph, tables)
        way = self._random.choice(["cheapest", "cheapest", "greedy", "any"])
        goals = None if way == "cheapest" else self._greedy(graph, start, wanted, cheapest=way == "greedy")
        goals = goals or self._choose(graph, layers)
        if errs:
            goals = self._misled(graph, start, goals)
        points = self._points(arm_start, graph, start, goals)
        first = self._from_commanded(arm_start, points[0], scene)
        if first is None:
            raise Refusal(Reason.START_COLLIDES)
        points[0] = first
        plan = FoundPlan(arm_start, trajectory, goals, bound)
        proof = self._proof(graph, start, goals, points, bound)
        proof = proof._replace(bound=0.0, certificate="unknown") if errs else proof
        return Planned(trajectory, tuple(points), proof, plan)

    def _misled(self, graph: Graph, start: int, goals: list[int]) -> list[int]:
        """Returns a plan with another configuration at one point, whatever the goal says."""
        k = self._random.choice([len(goals) - 1, self._random.randrange(len(goals))])
        reached = np.flatnonzero(np.isfinite(self._to(graph, start))).tolist()
        return [*goals[:k], int(self._random.choice(reached)), *goals[k + 1 :]]

    def _choose(self, graph: Graph, layers: Sequence[Costs]) -> list[int]:
        """Returns the configurations of a cheapest plan, chosen backwards among equal ones."""
        goals, costs = list[int](), layers[-1]
        for k in range(len(layers) - 1, 0, -2):
            goals.append(int(self._random.choice(np.flatnonzero(costs == costs.min()).tolist())))
            if k > 1:
                before = layers[k - 2] + self._to(graph, goals[-1])
                costs = np.where(before == before.min(), 0.0, np.inf)
        return goals[::-1]

    def _to(self, graph: Graph, goal: int) -> Costs:
        """Returns the cost from each configuration to one; stages cost the same in both directions."""
        costs = np.full(len(graph.permitted), np.inf)
        costs[goal] = 0.0
        return graph.spread(costs)

    def _greedy(
        self, graph: Graph, start: int, wanted: Sequence[NDArray[np.bool_]], cheapest: bool = True
    ) -> list[int] | None:
        """Returns the nearest configuration at each point, or any; None if that leads nowhere."""
        goals, here = list[int](), start
        for fits in wanted:
            costs = np.where(fits, self._to(graph, here), np.inf)
            if costs.min() == np.inf:
                return None
            fitting = costs == costs.min() if cheapest else np.isfinite(costs)
            here = int(self._random.choice(np.flatnonzero(fitting).tolist()))
            goals.append(here)
        return goals

    def _points(self, start: ArmStart, graph: Graph, first: int, goals: Sequence[int]) -> list[PlannedPoint]:
        """Returns the stages to each goal, and the bits of locked actuators as the outputs are."""
        here, points, states = first, list[PlannedPoint](), unpack(start.commanded)
        for k, goal in enumerate(goals):
            way = self._space.path(graph, here, goal, self._to(graph, here)) or [here]
            stages = [int(self._space.codes[number]) for number in way]
            switches = 0
            for stage in stages:
                switches += (stage ^ states).bit_count()
                states = stage
            points.append(PlannedPoint(k, tuple(self._packed(start, stage) for stage in stages), None, switches))
            here = goal
        return points

    def _packed(self, start: ArmStart, stage: int) -> bytes:
        locked = unpack(start.locked)
        return pack(stage & ~locked | unpack(start.outputs) & locked, self._size)

    def _from_commanded(self, start: ArmStart, point: PlannedPoint, scene: VersionedScene) -> PlannedPoint | None:
        """Returns the first point with stages that begin in the commanded states; None if they touch an obstacle."""
        cubes, commanded, locked = scene.keep_out or (), unpack(start.commanded), unpack(start.locked)
        stages = [stage & ~locked | commanded & locked for stage in map(unpack, point.stages)]
        most, steps = self._pace.inrush or self._size, zip([commanded, *stages], stages, strict=False)
        if start.commanded != start.states and (
            scene.free
            or first_touched(cubes, commanded, stages) is not None
            or max((before ^ after).bit_count() for before, after in steps) > most
        ):
            rows = np.array([unpack_states(pack(stage, self._size), self._size) for stage in stages])
            before = unpack_states(start.commanded, self._size)
            stages = [integer(row) for row in restage(self._arm.manipulator, before, rows, most)]
        if first_touched(cubes, commanded, stages) is not None:
            return None
        steps = zip([commanded, *stages], stages, strict=False)
        switches = sum((before ^ after).bit_count() for before, after in steps)
        return point._replace(stages=tuple(self._packed(start, stage) for stage in stages), switches=switches)

    def _unreachable(
        self, trajectory: Trajectory, wanted: Sequence[NDArray[np.bool_]], graph: Graph, tables: Tables
    ) -> Refusal:
        """Returns why there is no plan: out of reach of the arm with its locks, or barred by obstacles."""
        free = self._space.graph(locked_mask(tables), locked_states(tables), ()).permitted
        for k, fits in enumerate(wanted):
            if not (fits & free).any():
                where = f"waypoints[{k}].position"
                position = ", ".join(f"{x:g}" for x in trajectory.positions[k])
                return Refusal(Reason.OUT_OF_REACH, where=where, position=position, turned="", nearest="none is near")
        if (free == graph.permitted).all():  # few switches at a time, and locks
            return Refusal(Reason.NO_CONFIGURATION, where="waypoints", error="no way of allowed switches leads there")
        facts = {"where": "waypoints", "proof": "as all configurations show", "blocked": "obstacles"}
        return Refusal(Reason.NO_WAY, **facts)

    def _proof(
        self, graph: Graph, start: int, goals: Sequence[int], points: Sequence[PlannedPoint], bound: float
    ) -> PlanProof:
        cost, here = 0.0, start
        for goal in goals:
            cost += float(self._to(graph, here)[goal])
            here = goal
        switches = sum(point.switches for point in points)
        return PlanProof(switches, cost, bound, "optimal" if cost == bound else "bound")

    def _improve(self, task: ImprovePlan) -> Iterator[Answer]:
        plan: FoundPlan = task.plan
        known = [self._random.random() < 0.9 for _ in plan.goals]
        yield Deviations(tuple(round(self._random.uniform(0.01, 0.3), 3) if told else None for told in known))
        graph, start = self._graph(task.tables, task.scene), self._space.index[unpack(plan.start.states)]
        goals = plan.goals
        for _ in range(self._random.choice([0, 1, 1, 2, 3]) if task.search else 0):
            first = self._random.randrange(len(goals))
            before = goals[first - 1] if first else start
            wanted = self.wanted(plan.trajectory)[first:]
            better = [*goals[:first], *self._choose(graph, self._space.layers(graph, before, wanted))]
            points = self._points(plan.start, graph, start, better)
            if first == 0:
                point = self._from_commanded(plan.start, points[0], task.scene)
                if point is None:
                    continue
                points[0] = point
            goals = better
            yield Improved(first, tuple(points[first:]), self._proof(graph, start, goals, points, plan.bound))
        yield Done()

    def _follow(self, task: FollowSetpoint) -> Followed:
        arm_start, tables, scene = task.basis
        graph, start = self._graph(tables, scene), self._space.index.get(unpack(arm_start.states))
        if start is None or not graph.permitted[start]:
            return Followed((), ", which is not possible now", False, 0.01)
        fits = self._space.near(np.array(task.position), task.tolerance)
        goals = self._greedy(graph, start, [fits])
        if goals is None:
            return Followed((), ", which cannot be reached", False, 0.01)
        if goals == [start]:
            return Followed((), "", True, 0.01)
        (point,) = self._points(arm_start, graph, start, goals)
        first = self._from_commanded(arm_start, point, scene)
        if first is None:
            return Followed((), ", but the transition to it is blocked", True, 0.01)
        return Followed(first.stages, "", True, 0.01)


def described(task: DescribePlan, planned: Planned) -> dict[str, Any]:
    proof = planned.proof
    return {
        **{"accepted": True, "code": 0, "message": f"{len(planned.points)} waypoints, {proof.switches} switches"},
        **{"id": task.goal.message.id, "switches": proof.switches, "cost": proof.cost},
        **{"optimal": proof.certificate == "optimal", "lower_bound": proof.bound, "certificate": proof.certificate},
    }


def locked_mask(tables: Tables) -> int:
    """Returns the mask of the actuators for whose locks tables were built."""
    return sum(1 << k for k, state in enumerate(tables.locked) if state != 255)


def locked_states(tables: Tables) -> int:
    """Returns the states in which tables have these actuators locked."""
    return sum(1 << k for k, state in enumerate(tables.locked) if state == 1)

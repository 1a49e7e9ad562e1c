"""Tasks of the workers as plain facts for the judge."""

from __future__ import annotations

from typing import Any

import msgspec

from hyperbit.controller.motion.decoding.goal import GoalMessage
from hyperbit.controller.planning.core.tasks import (
    Basis,
    BuildScene,
    BuildTables,
    CheckStages,
    CheckStanding,
    DescribePlan,
    FollowSetpoint,
    ImprovePlan,
    PlanGoal,
    PrepareSearch,
    Task,
    VersionedScene,
)
from tests.simulation.judge.interface.modules import Cube
from tests.simulation.judge.interface.tasks import Search


def seen(number: int, task: Task) -> Search:
    match task:
        case PlanGoal(message, received, bias, on):
            return Search(number, "goal", **of_basis(on), goal=of_goal(message, received), bias=bias)
        case DescribePlan(PlanGoal(message, received, bias, on), seconds):
            goal = {**of_goal(message, received), "seconds": seconds}
            return Search(number, "plan", **of_basis(on), goal=goal, bias=bias)
        case PrepareSearch(on, rehearsal):
            return Search(number, "prepare", **of_basis(on), goal=None if rehearsal is None else of_goal(rehearsal))
        case FollowSetpoint(on, _, tolerance, bias):
            return Search(number, "follow", **of_basis(on), bias=bias, tolerance=tolerance)
        case ImprovePlan(search=improves, scene=scene):
            return Search(number, "improve", cubes=of_scene(scene), improves=improves)
        case CheckStages(scene, before, stages):
            return Search(number, "stages", cubes=of_scene(scene), states=(before, *stages))
        case CheckStanding(scene, states):
            return Search(number, "standing", cubes=of_scene(scene), states=(states,))
        case BuildScene():
            return Search(number, "scene")
        case BuildTables(_, locked):
            return Search(number, "tables", tables=locked)
    raise AssertionError(task)


def of_basis(basis: Basis) -> dict[str, Any]:
    return {"start": tuple(basis.start), "tables": basis.tables.locked, "cubes": of_scene(basis.scene)}


def of_scene(scene: VersionedScene) -> tuple[Cube, ...]:
    return () if scene.free else tuple(Cube(*cube) for cube in scene.keep_out)


def of_goal(message: GoalMessage, received: float = 0.0) -> dict[str, Any]:
    return {**msgspec.to_builtins(message), "received": received}

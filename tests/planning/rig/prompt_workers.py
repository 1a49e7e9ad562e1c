"""Workers of the planner that compute at once, in the thread of the test."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.planning.core.tasks import (
    BuildScene,
    BuildTables,
    CheckStages,
    DescribePlan,
    Done,
    FollowSetpoint,
    ImprovePlan,
    PlanGoal,
    PrepareSearch,
    Task,
)
from hyperbit.controller.planning.workers.computations import (
    ArmModel,
    build_scene,
    build_tables,
    check_stages,
    check_standing,
    describe,
    follow,
    improve,
    plan_goal,
)
from hyperbit.controller.workspace.densities import Densities


class PromptWorkers:
    def __init__(self, arm: Arm, densities: Densities) -> None:
        self._arm, self._densities, self._weights = arm, densities, weights_of(arm, {})
        self._models = {kind: ArmModel(arm, kind) for kind in ("goals", "queries", "setpoints")}  # type: ignore[arg-type]

    def perform(self, task: Task) -> Iterator[Any]:
        match task:
            case ImprovePlan():
                yield from improve(self._models["goals"], task, lambda: None)
                yield Done()
            case PrepareSearch():
                yield Done()
            case BuildScene():
                yield build_scene(self._arm, task)
            case BuildTables():
                yield build_tables(self._arm, self._densities, self._weights, task)
            case PlanGoal():
                yield plan_goal(self._models["goals"], task, lambda: None)
            case DescribePlan():
                yield describe(self._models["queries"], task, lambda: None, lambda: False)
            case FollowSetpoint():
                yield follow(self._models["setpoints"], task)
            case CheckStages():
                yield check_stages(task, lambda: None)
            case _:
                yield check_standing(task)

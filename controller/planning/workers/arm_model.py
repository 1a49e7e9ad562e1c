"""What one worker knows of the arm: its pace, packed states, and the solver that avoids the present obstacles."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator.locked import lock_actuators, transferred
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.motion.decoding.goal import GoalRules
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.motion.stages.program import pack_states, unpack_states
from hyperbit.controller.obstacles.keep_out import KeepOutSet, States
from hyperbit.controller.obstacles.single_switches import arm_switches
from hyperbit.controller.planning.core import tasks
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import map_densities

# Called between two parts of a task. Returns whether the task must end soon. Raises Abandoned if the task is no longer
# needed, Refusal if its time is over.
Proceed = Callable[[], bool]


class Abandoned(Exception):
    """A task is no longer needed."""


class ArmModel:
    """The arm for one worker. Not thread-safe, because the memory of its solver is not."""

    def __init__(self, arm: Arm, worker: Literal["goals", "queries", "setpoints"]) -> None:
        self.arm, self.pace, self._worker = arm, pace_of(arm.settings), worker
        whole = arm.manipulator
        self.rules = GoalRules(whole.dimension, arm.tolerance, arm.angle_tolerance, self.pace, whole)
        self._generations = (-1, -1)  # of tables and obstacles of the latest solver
        self._solver: Solver | None = None

    def solver(self, tables: tasks.Tables, scene: tasks.VersionedScene) -> Solver:
        """Returns the solver of the reduced arm that avoids the obstacles of a scene."""
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

    def unpack(self, packed: bytes) -> States:
        return unpack_states(packed, len(self.arm.manipulator.actuators))

    def pack(self, start: tasks.ArmStart, stages: States) -> list[bytes]:
        """Returns stages (k, A) packed for the executor; locked actuators keep their bits of the outputs."""
        if any(start.locked):
            stages = np.where(self.unpack(start.locked), self.unpack(start.outputs), stages)
        return pack_states(stages)

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


def build_tables(arm: Arm, densities: Densities, weights: NDArray[np.float64], task: tasks.BuildTables) -> tasks.Tables:
    """Returns the solvers for locked states.

    `densities` are of the arm reduced by the locked states of its file; others are mapped, which takes seconds.
    `weights` are the costs of a switch of each actuator, shape (A,).

    Raises:
        ValueError: a module has no state with its actuators locked so.
    """
    locked = np.frombuffer(task.locked, dtype=np.int8)  # 255 becomes -1
    reduced = arm.reduced
    if not np.array_equal(locked, arm.locked):
        reduced = lock_actuators(arm.manipulator, locked)
        densities = map_densities(reduced, arm.pixel, arm.level_pixels)
    goals = Solver(reduced, densities, weights)
    goals.prepare()
    arm_switches(reduced)  # a goal among obstacles needs them at once
    solvers = {"goals": goals, "queries": goals.another(), "setpoints": goals.another()}  # all with the same tables
    return tasks.Tables(task.generation, task.locked, solvers)


def build_scene(arm: Arm, task: tasks.BuildScene) -> tasks.SceneBuilt:
    keep_out = KeepOutSet(arm.clearance(others=task.obstacles), task.obstacles)
    scene = tasks.VersionedScene(task.generation, keep_out.free, keep_out)
    return tasks.SceneBuilt(scene, len(keep_out.clearance.obstacles), len(task.obstacles))

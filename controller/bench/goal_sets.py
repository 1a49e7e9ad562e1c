"""Goal sets: arms, start configurations, goals, and the proven minimum of switches for each goal.

A set is a CSV file in `sets`; the arms are in `arms`. `tests/benchmarks/proofs/goal_sets.py` draws the goals and proves
them.
"""

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.armfile.csv_files import read_csv
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.manipulator.notation import parse_configuration

FOLDER = Path(__file__).parent

SETS = {
    "paper": "the paper's arm of 16 modules, positions",
    "paper-poses": "the paper's arm, positions with an orientation",
    "planar16": "deploy/planar16.yaml, positions",
    "revolute24": "deploy/revolute24.yaml, positions",
    "platform8": "deploy/platform8.yaml, positions in space",
    "motor12": "deploy/motor12.yaml, positions in space",
    "lattice": "arms whose tips lie on a lattice, in the plane and in space, many goals exactly on the tolerance",
    "obstacles": "the paper's arm and platform8 among obstacles",
}


@dataclass(frozen=True, eq=False)
class Task:
    arm: str  # name of a file in `arms`
    start: Configuration  # shape (B,)
    position: tuple[float, ...]  # of the tip in the world, shape (2,) or (3,)
    angle: float | None  # of the tip [rad], counter-clockwise; None: any angle
    tolerance: float
    angle_tolerance: float  # [rad]; infinite: any angle
    bound: int  # proven lower bound of the switches of valid configurations
    best: Configuration  # valid, with the fewest switches known, shape (B,)
    switches: int  # from `start` to `best`

    @property
    def proven(self) -> bool:
        return self.switches == self.bound

    @property
    def frame(self) -> Frame:
        """The goal in the world, shape (4, 4); its rotation is irrelevant without an angle."""
        return goal_frame(self.position, self.angle)


def goal_frame(position: tuple[float, ...], angle: float | None) -> Frame:
    if len(position) == 2:
        return frames.planar(position[0], position[1], angle or 0.0)
    return frames.spatial(position)


@cache
def load_arm(name: str) -> Arm:
    return load(FOLDER / "arms" / f"{name}.yaml")


def read(name: str) -> list[Task]:
    columns, rows = read_csv(FOLDER / "sets" / f"{name}.csv")
    return [task(dict(zip(columns, row.fields, strict=True))) for row in rows]


def task(row: dict[str, str]) -> Task:
    arm = load_arm(row["arm"]).manipulator
    numbers = tuple(map(float, row["goal"].split()))
    oriented = row["angle_tolerance"] != ""
    start, best = parse_configuration(arm, row["start"]), parse_configuration(arm, row["best"])
    return Task(
        row["arm"],
        start,
        numbers[: arm.dimension],
        numbers[arm.dimension] if oriented else None,
        float(row["tolerance"]),
        float(row["angle_tolerance"]) if oriented else math.inf,
        int(row["bound"]),
        best,
        arm.switches(start, best),
    )


def by_arm(tasks: list[Task]) -> dict[str, list[Task]]:
    return {name: [t for t in tasks if t.arm == name] for name in dict.fromkeys(t.arm for t in tasks)}


def sample_evenly(tasks: list[Task], count: int) -> list[Task]:
    """Returns at most `count` goals, evenly spaced in a set, so that each arm is represented."""
    if count >= len(tasks):
        return tasks
    return [tasks[k] for k in np.linspace(0, len(tasks) - 1, count).round().astype(int)]

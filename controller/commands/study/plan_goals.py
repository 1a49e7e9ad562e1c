"""The goals of `plan`: given by its options, or in a CSV file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import configuration, parse_goal
from hyperbit.controller.commands.goal_rows import Orientation, goal_rows
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.locked import transferred
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.search.method import Method


class PlanOptions(NamedTuple):
    """The options of `plan` about goals and search, None where they are not given.

    Attributes:
        goal: one goal.
        goals: CSV file of goals.
        configuration: configuration to describe instead of a search.
        previous: configuration before the first goal.
        tolerance: position tolerance.
        angle_tolerance: orientation tolerance [rad].
        path_tolerance: follow straight lines between the goals within this distance.
        method: search method.
        deadline: longest time of planning [s].
        effort: work of each search, in place of a deadline.
        apart: search each goal of a file by itself.
    """

    goal: str | None
    goals: Path | None
    configuration: str | None
    previous: str | None
    tolerance: float | None
    angle_tolerance: float | None
    path_tolerance: float | None
    method: Method | None
    deadline: float | None
    effort: float | None = None
    apart: bool = False


class WantedGoal(NamedTuple):
    """A goal.

    Attributes:
        position: shape (dimension,).
        orientation: an angle [rad] or a quaternion; None: any orientation.
        previous: configuration from which its search starts, shape (B,); None: the one before.
    """

    position: list[float]
    orientation: Orientation
    previous: Configuration | None = None

    def target(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        """Returns the position, or the tip's frame (4, 4) if the goal has an orientation."""
        if self.orientation is None:
            return np.array(self.position)
        if isinstance(self.orientation, float):
            return frames.planar(self.position[0], self.position[1], self.orientation)
        return frames.spatial(self.position, self.orientation)


class PlanTask(NamedTuple):
    """What `plan` searches or describes.

    Attributes:
        start: configuration of the reduced arm before the first goal, shape (B,).
        described: configuration of the reduced arm to describe instead of a search; None: search.
        goal: the goal of `--goal`.
        total: number of goals in the file of `--goals`, which is read again as they are needed.
        digest: of this file.
    """

    start: Configuration
    described: Configuration | None = None
    goal: WantedGoal | None = None
    total: int = 0
    digest: str = ""


def read_task(arm: Arm, options: PlanOptions) -> PlanTask:
    """Returns the task that the options describe.

    Raises:
        InputFaults: an option, or a line of the file of goals, is wrong.
    """
    check_options(options)
    home = np.zeros(len(arm.reduced.modules), dtype=np.int64)
    start = home if options.previous is None else unlocked(arm, options.previous, "--previous")
    if options.configuration is not None:
        return PlanTask(start, unlocked(arm, options.configuration, "--configuration"))
    if options.goal is not None:
        return PlanTask(start, goal=WantedGoal(*parse_goal(options.goal, arm.manipulator.dimension, "--goal")))
    path, count = options.goals or Path(), 0
    for goal in read_goals(arm, path):
        count += 1
        if options.path_tolerance is not None:
            check_line(goal, path)
    with path.open("rb") as file:
        return PlanTask(start, total=count, digest=hashlib.file_digest(file, "sha256").hexdigest())


def check_options(options: PlanOptions) -> None:
    """Checks which options are given together, and the range of tolerances, time and work.

    Raises:
        InputFaults: an option is wrong.
    """
    if [options.goal, options.goals, options.configuration].count(None) != 2:
        raise InputFaults(Path("plan"), ["give one of --goal, --goals and --configuration"])
    tolerances = (
        ("--tolerance", "length", options.tolerance),
        ("--turn", "angle", options.angle_tolerance),
        ("--path-tolerance", "length", options.path_tolerance),
        ("--deadline", "time", options.deadline),
        ("--effort", "work", options.effort),
    )
    for name, kind, value in tolerances:
        if value is not None and not 1e-9 <= value <= 1e6:
            raise InputFaults(Path(name), [f"{value:g} is no {kind} from 1e-9 to 1e6"])
    if options.path_tolerance is not None and options.goals is None:
        raise InputFaults(Path("--path-tolerance"), ["lines need several goals: give --goals FILE.csv"])
    if options.apart and (options.goals is None or options.path_tolerance is not None):
        raise InputFaults(Path("--apart"), ["it is for --goals FILE.csv, without --path-tolerance"])
    if options.effort is not None and options.goals is not None and not options.apart:
        raise InputFaults(
            Path("--effort"), ["a trajectory is planned by time; add --apart to search each goal by itself"]
        )
    if options.effort is not None and options.deadline is not None:
        raise InputFaults(Path("--effort"), ["a search ends by work or by time: give --effort or --deadline"])


def read_goals(arm: Arm, path: Path) -> Iterator[WantedGoal]:
    """Yields the goals of a CSV file as they are read: position, and orientation and previous configuration if given.

    Raises:
        InputFaults: the file is missing or wrong; each fault names its line.
    """
    faults, count = list[str](), 0
    for row in goal_rows(path, ("previous",), arm.manipulator.dimension, faults):
        try:
            previous = unlocked(arm, row.more["previous"], row.where) if row.more["previous"] else None
            yield WantedGoal(row.position, row.orientation, previous)
            count += 1
        except InputFaults as error:
            faults += [f"{row.where}: {fault}" for fault in error.faults]
    if faults or not count:
        raise InputFaults(path, faults or ["no goals"])


def check_line(goal: WantedGoal, path: Path) -> None:
    """Checks that a straight line can end at a goal of a file.

    Raises:
        InputFaults: the goal has an orientation, or a previous configuration.
    """
    if goal.previous is not None:
        raise InputFaults(path, ["column previous: remove it, each line begins at the end of the previous line"])
    if goal.orientation is not None:
        raise InputFaults(path, ["orientations: remove them, lines are followed by position only"])


def unlocked(arm: Arm, text: str, where: str) -> Configuration:
    """Parses a configuration of the whole arm and returns it as a configuration of `arm.reduced`, shape (B,).

    Raises:
        InputFaults: the arm has no such configuration, or a locked actuator is in another state.
    """
    whole = configuration(arm, text, where)
    try:
        return transferred(whole, arm.manipulator, arm.reduced)
    except ValueError as error:
        raise InputFaults(Path(where), [f"{text}: as actuators are locked, {error}"]) from None

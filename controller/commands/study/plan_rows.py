"""The rows of `plan`: its options and goals, and its results as JSON, in a table, and in a file to go on with."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from importlib import metadata
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.goal_files import CSV, GoalRow, Orientation, goal_rows, parse_goal, read_goal
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import (
    CommandFailed,
    configuration,
    console,
    errors,
    print_json,
    print_table,
    results_table,
    shown,
)
from hyperbit.controller.host.keeper import FileInUse, lock_file
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.locked import transferred
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.motion.decoding.goal import parse
from hyperbit.controller.motion.plans.description import describe_solution
from hyperbit.controller.refusals.refusal import Refusal, nth_waypoint
from hyperbit.controller.search.method import Method
from hyperbit.controller.studies import lines

if TYPE_CHECKING:  # the search's kernels take a second to import
    from hyperbit.controller.search.solution import Solution

WORDS = {
    "study": "another command",
    "hyperbit": "another version of hyperbit",
    "arm": "another arm file",
    "goals": "another file of goals",
    "options": "other options",
}


class PlanOptions(NamedTuple):
    """The options of `plan` about goals and search, None where they are not given. Files of results name them."""

    goal: str | None
    goals: Path | None
    configuration: str | None
    previous: str | None
    tolerance: float | None
    angle_tolerance: float | None
    path_tolerance: float | None
    method: Method | None
    deadline: float | None
    effort: float | None
    apart: bool
    prove: bool


class WantedGoal(NamedTuple):
    """A goal, and the configuration from which its search starts, shape (B,); None: the one before."""

    position: list[float]
    orientation: Orientation
    previous: Configuration | None = None
    timed: bool = False  # whether its file has a time for it, which a study ignores

    def target(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        """Returns the position, or the tip's frame (4, 4) if the goal has an orientation."""
        if self.orientation is None:
            return np.array(self.position)
        if isinstance(self.orientation, float):
            return frames.planar(self.position[0], self.position[1], self.orientation)
        return frames.spatial(self.position, self.orientation)


class PointSolution(NamedTuple):
    position: list[float]
    orientation: Orientation
    solution: Solution
    between: bool = False
    whole: dict[str, Any] | None = None  # of the whole trajectory, for JSON; None: a separate search


class Row(NamedTuple):
    """The solution of one point, as it is printed: for JSON, and as cells of the table."""

    line: dict[str, Any]
    cells: list[str]


def read_goals(arm: Arm, options: PlanOptions) -> Iterator[WantedGoal]:
    path, faults = options.goals or Path(), list[str]()
    for row in study_rows(path, arm.manipulator.dimension):
        try:
            previous = unlocked(arm, row.previous, row.where) if row.previous else None
        except InputFaults as error:
            faults += [f"{row.where}: {fault}" for fault in error.faults]
            continue
        goal = WantedGoal(row.position, row.orientation, previous, timed=row.t is not None)
        if options.path_tolerance is not None and goal.previous is not None:
            raise InputFaults(path, ["column previous: remove it, each line begins at the end of the previous line"])
        if options.path_tolerance is not None and goal.orientation is not None:
            raise InputFaults(path, ["orientations: remove them, lines are followed by position only"])
        yield goal
    if faults:
        raise InputFaults(path, faults)


def study_rows(path: Path, dimension: int) -> Iterator[GoalRow]:
    """Yields the waypoints of a file for a study; those of a CSV file as they are read."""
    if path.suffix.lower() == CSV:
        yield from goal_rows(path, dimension)
        return
    try:
        message = parse(json.dumps(read_goal(path)).encode())
    except Refusal as refusal:
        raise InputFaults(path, [str(refusal)]) from None
    for k, waypoint in enumerate(message.waypoints):
        where, turn = nth_waypoint(k), waypoint.orientation
        if waypoint.position is None:
            words = "a study has positions; `plan ARM.yaml GOAL` plans configurations"
            raise InputFaults(path, [f"{where}: {words}"])
        fields = [*waypoint.position, *(turn if isinstance(turn, list) else [] if turn is None else [turn])]
        try:
            goal = parse_goal([repr(float(x)) for x in fields], dimension, where)
        except InputFaults as error:
            raise InputFaults(path, [f"{where}: {fault}" for fault in error.faults]) from None
        yield GoalRow(where, *goal, waypoint.t or None, "")


def unlocked(arm: Arm, text: str, where: str) -> Configuration:
    """Parses a configuration of the whole arm and returns it as a configuration of `arm.reduced`, shape (B,)."""
    whole = configuration(arm, text, where)
    try:
        return transferred(whole, arm.manipulator, arm.reduced)
    except ValueError as error:
        raise InputFaults(Path(where), [f"{text}: as actuators are locked, {error}"]) from None


def row_of(arm: Arm, options: PlanOptions, point: PointSolution) -> Row:
    found, orientation = point.solution, point.orientation
    line = {
        "goal": point.position,
        **describe_solution(arm.manipulator, arm.reduced, found, orientation is not None),
        "within_tolerance": found.within_tolerance,
    }
    if options.path_tolerance is not None:
        line["between"] = point.between
    if options.goals is not None and not options.apart:
        line["trajectory"] = point.whole
    turned = [] if orientation is None else orientation if isinstance(orientation, list) else [orientation]
    angle = "" if orientation is None else f", {found.angle:.3f}"
    cells = [
        ("  " if point.between else "") + ", ".join(f"{x:g}" for x in [*point.position, *turned]),
        line["configuration"],
        shown(line["position"]),
        shown(line["orientation"]),
        f"{found.error:.5f}{angle}",
        str(found.switches),
        f"{found.seconds * 1e3 if found.effort is None else found.effort:.2f}",
    ]
    return Row(line, cells)


def print_results(
    found: Iterable[Row], options: PlanOptions, unit: str | None, *, as_json: bool, many: bool = False
) -> None:
    """Prints each result as a line of JSON, or all in a table; `many`: as lines of text as the results come."""
    if as_json:
        for row in found:
            print_json(row.line)
        return
    work = "effort" if options.effort is not None else "ms"
    length = f" [{unit}]" if unit else ""
    columns = f"goal{length}", "configuration", f"position{length}", "th [rad]", f"error{length}", "switches", work
    table, wholes = results_table(*columns), list[dict[str, Any]]()
    if many:
        console.print("  ".join(columns))
    for row in found:
        whole = row.line.get("trajectory")
        if wholes and whole is not wholes[-1] and many:
            console.print(sentence(wholes.pop()))
        if whole is not None and not (wholes and whole is wholes[-1]):
            wholes.append(whole)
        if many:
            console.print("  ".join(cell or "-" for cell in row.cells))
        else:
            table.add_row(*row.cells)
    if not many:
        print_table(table)
    for whole in wholes:
        console.print(sentence(whole))


def sentence(whole: Mapping[str, Any]) -> str:
    """Returns a sentence on switches and certificate of a whole trajectory."""
    least = f"at least {whole['lower_bound'] or 0:g}"
    if whole["cost"] == whole["switches"]:
        cost, proven = "", {"optimal": "proven to be the fewest", "bound": f"proven: {least}"}
    else:
        cost = f" of cost {whole['cost']:.6g}"
        proven = {"optimal": "proven to cost least", "bound": f"proven: a cost of {least}"}
    return f"{whole['switches']} switches{cost} in all; {proven.get(whole['certificate'], 'nothing is proven')}"


@contextmanager
def results_file(
    path: Path, about: Mapping[str, Any], parts: Iterator[list[list[float]]]
) -> Iterator[tuple[BinaryIO, int]]:
    """Opens a file of results to go on with it, or creates it; yields it, and the number of goals that are done.

    The file has a header, and a line for each result. A line that was half written, and the results of a part that was
    not finished, are cut. While it is open no other process writes it.

    Args:
        path: of the file.
        about: what the results belong to, for the header: study, arm, goals and options.
        parts: positions of the goals of each part that is searched as a whole.
    """
    header = {**about, "hyperbit": metadata.version("hyperbit")}
    lock = path.with_name(f".{path.name}.lock")
    with ExitStack() as closing:
        if not path.parent.is_dir():
            raise InputFaults(path, [f"cannot be written: there is no folder {path.parent}"])
        try:
            closing.callback(os.close, lock_file(lock, f"{path}: end the other study, or name another file: process"))
            closing.callback(lock.unlink, missing_ok=True)
            file = closing.enter_context(path.open("r+b" if path.exists() else "w+b"))
        except FileInUse as error:
            raise CommandFailed(str(error)) from None
        except OSError as error:
            raise InputFaults(path, [f"cannot be written: {error.strerror}"]) from None
        first, done = file.readline(), 0
        if not first.endswith(b"\n") and (json.dumps(header) + "\n").encode().startswith(first):
            file.seek(0)
            file.truncate()
            write_line(path, file, header)
        else:
            check_header(path, first, header)
            done, size = finished(path, file, len(first), parts)
            file.seek(size)
            file.truncate()
        yield file, done


def write_line(path: Path, file: IO[bytes], line: Mapping[str, Any]) -> None:
    """Writes a line of results."""
    try:
        if lines.write_line(path, file, line):
            errors.print(f"{path} was deleted or moved: it is written again", markup=False)
    except OSError as error:
        step = "free disk space; the same command then goes on where it ended"
        raise CommandFailed(f"{path} cannot be written: {error.strerror}", step) from None


def check_header(path: Path, line: bytes, header: Mapping[str, Any]) -> None:
    try:
        found = json.loads(line)
    except ValueError:
        found = None
    if not isinstance(found, dict) or found.keys() != header.keys():
        raise InputFaults(path, ["it holds no results of a study: give the name of a new file"])
    other = [words for name, words in WORDS.items() if found[name] != json.loads(json.dumps(header[name]))]
    if other:
        raise InputFaults(path, [f"its results belong to {' and '.join(other)}: give the name of a new file"])


def finished(path: Path, file: BinaryIO, size: int, parts: Iterator[list[list[float]]]) -> tuple[int, int]:
    """Returns the number of finished goals, and the size of the file up to them.

    `file` is open after the header of `size` bytes; for `parts` see results_file.
    """
    done, whole, goals, wanted = 0, size, 0, deque[list[float]]()
    for number, line in enumerate(file, 2):
        if not line.endswith(b"\n"):
            break
        if not wanted:
            wanted.extend(next(parts, ()))
        if not wanted:
            raise InputFaults(path, [f"line {number}: there are more results than goals"])
        try:
            row = json.loads(line)
            goal, between = row["goal"], row.get("between", False)
        except (ValueError, TypeError, KeyError, AttributeError):
            raise InputFaults(path, [f"line {number} is damaged: give the name of a new file"]) from None
        if not between and goal != wanted.popleft():
            raise InputFaults(
                path, [f"line {number} is of another goal, so lines are missing: give the name of a new file"]
            )
        size, goals = size + len(line), goals + (not between)
        if not wanted:
            done, whole = goals, size
    return done, whole

"""The command `plan`: searches configurations for goals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from controller.arm.arm import Arm, load
from controller.commands.common import (
    ArmFile,
    AsJson,
    CommandFailed,
    console,
    print_json,
    print_table,
    results_table,
    shown,
)
from controller.commands.goal_rows import Orientation
from controller.commands.study.plan_goals import PlanOptions, PlanTask, read_task
from controller.commands.study.plan_search import (
    GoalSearch,
    PointSolution,
    described,
    follow,
    prepared_search,
    search_each,
)
from controller.motion.plans.description import describe_solution
from controller.search.method import Method

ONE_GOAL = "One goal, optionally with an orientation; spatial arms: X,Y,Z[,QX,QY,QZ,QW]."
MANY_GOALS = "Goals with columns x,y[,th] or x,y,z[,qx,qy,qz,qw], and optionally `previous`."
PATH_TOLERANCE = "Follow straight lines between --goals within this distance."
ANGLE_TOLERANCE = "Orientation tolerance [rad]. Default: the arm's."
DEADLINE = "Longest time of planning [s], also for a goal that is not found. Default: see `planning` of the arm's file."
START = "Configuration to start from. Default: all contracted."


def plan(
    file: ArmFile,
    goal: Annotated[str | None, typer.Option(metavar="X,Y[,TH]", help=ONE_GOAL)] = None,
    goals: Annotated[Path | None, typer.Option(metavar="FILE.csv", help=MANY_GOALS)] = None,
    configuration: Annotated[str | None, typer.Option(help="Configuration to describe instead of a search.")] = None,
    previous: Annotated[str | None, typer.Option(help=START)] = None,
    tolerance: Annotated[float | None, typer.Option(help="Position tolerance. Default: the arm's.")] = None,
    angle_tolerance: Annotated[float | None, typer.Option("--turn", help=ANGLE_TOLERANCE)] = None,
    path_tolerance: Annotated[float | None, typer.Option(help=PATH_TOLERANCE)] = None,
    method: Annotated[Method | None, typer.Option(help="Search method. Default: the arm's.")] = None,
    deadline: Annotated[float | None, typer.Option(help=DEADLINE)] = None,
    as_json: AsJson = False,
) -> None:
    """Search configurations for goals, without hardware."""
    tolerances = tolerance, angle_tolerance, path_tolerance
    options = PlanOptions(goal, goals, configuration, previous, *tolerances, method, deadline)
    arm = load(file)
    task = read_task(arm, options)
    search = prepared_search(arm, options, silent=as_json)
    found = print_solutions(arm, options, solutions(search, options, task), as_json)
    check_goal(options, found)
    check_clearance(search, options, task)


def solutions(search: GoalSearch, options: PlanOptions, task: PlanTask) -> Iterator[PointSolution]:
    """Yields the solution of each point of the task, in order.

    Raises:
        CommandFailed: the lines between the goals cannot be followed.
    """
    if task.described is not None:
        yield described(search, task, task.described)
    elif options.goal is not None:
        yield from search_each(search, task.goals, task.start)
    else:
        yield from follow(search, task.goals, task.start)


def print_solutions(arm: Arm, options: PlanOptions, found: Iterable[PointSolution], as_json: bool) -> PointSolution:
    """Prints each solution as a line of JSON, or all in a table; returns the last."""
    table = results_table("goal", "configuration", "position", "θ [rad]", "error", "switches", "ms")
    wholes = list[dict[str, Any]]()
    for point in found:
        line = as_line(arm, options, point)
        if as_json:
            print_json(line)
        table.add_row(*cells(point, line))
        if point.whole is not None and not any(point.whole is known for known in wholes):
            wholes.append(point.whole)
    if not as_json:
        print_table(table)
        for whole in wholes:
            console.print(sentence(whole))
    return point


def as_line(arm: Arm, options: PlanOptions, point: PointSolution) -> dict[str, Any]:
    """Returns a solution for JSON."""
    line = {
        "goal": point.position,
        **describe_solution(arm.manipulator, arm.reduced, point.solution, point.orientation is not None),
        "within_tolerance": point.solution.within_tolerance,
    }
    if options.path_tolerance is not None:
        line["between"] = point.between
    if options.goals is not None:
        line["trajectory"] = point.whole
    return line


def cells(point: PointSolution, line: dict[str, Any]) -> list[str]:
    """Returns a solution as cells of the table."""
    found, goal = point.solution, [*point.position, *numbers(point.orientation)]
    angle = "" if point.orientation is None else f", {found.angle:.3f}"
    return [
        ("  " if point.between else "") + ", ".join(f"{x:g}" for x in goal),
        line["configuration"],
        shown(line["position"]),
        shown(line["orientation"]),
        f"[{'green' if found.within_tolerance else 'red'}]{found.error:.5f}{angle}",
        str(found.switches),
        f"{found.seconds * 1e3:.2f}",
    ]


def numbers(orientation: Orientation) -> list[float]:
    """Returns the numbers of an orientation: none, the angle, or the quaternion."""
    return [] if orientation is None else orientation if isinstance(orientation, list) else [orientation]


def sentence(whole: dict[str, Any]) -> str:
    """Returns a sentence on switches and certificate of a whole trajectory."""
    least = f"at least {whole['lower_bound'] or 0:g}"
    if whole["cost"] == whole["switches"]:
        cost, proven = "", {"optimal": "proven to be the fewest", "bound": f"proven: {least}"}
    else:
        cost = f" of cost {whole['cost']:.6g}"
        proven = {"optimal": "proven to cost least", "bound": f"proven: a cost of {least}"}
    return f"{whole['switches']} switches{cost} in all; {proven.get(whole['certificate'], 'nothing is proven')}"


def check_goal(options: PlanOptions, point: PointSolution) -> None:
    """Checks that a single goal is reached.

    Raises:
        CommandFailed: no configuration within the tolerances was found.
    """
    found = point.solution
    if options.goal is None or found.within_tolerance:
        return
    away = f"{found.error:.4f} away" + ("" if point.orientation is None else f" and turned {found.angle:.4f} rad")
    nearest = shown(found.tip[: len(point.position), 3])
    raise CommandFailed(f"goal {options.goal} {found.reach}: nearest point found {nearest}, {away}")


def check_clearance(search: GoalSearch, options: PlanOptions, task: PlanTask) -> None:
    """Checks that a described configuration is clear of obstacles and of the arm itself.

    Raises:
        CommandFailed: the configuration collides.
    """
    clearance = search.solver.clearance
    if clearance is None or task.described is None:
        return
    if (where := clearance.where(task.described)) is not None:
        raise CommandFailed(f"configuration {options.configuration}: {where}")

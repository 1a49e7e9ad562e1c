"""The command `plan`: searches configurations for goals."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.arm.arm import load
from hyperbit.controller.commands.arguments import ArmFile, AsJson
from hyperbit.controller.commands.common import CommandFailed, shown
from hyperbit.controller.commands.sharing import Dask, Sharing, Workers
from hyperbit.controller.commands.study.plan_goals import PlanOptions, PlanTask, read_task
from hyperbit.controller.commands.study.plan_results import print_results, shown_result
from hyperbit.controller.commands.study.plan_search import (
    GoalSearch,
    PointSolution,
    described,
    prepared_search,
    search_one,
)
from hyperbit.controller.commands.study.plan_study import PlanJob, StudyOptions, check_study, study_goals
from hyperbit.controller.search.method import Method

ONE_GOAL = "One goal, optionally with an orientation; spatial arms: X,Y,Z[,QX,QY,QZ,QW]."
MANY_GOALS = "Goals with columns x,y[,th] or x,y,z[,qx,qy,qz,qw], and optionally `previous`."
PATH_TOLERANCE = "Follow straight lines between --goals within this distance."
ANGLE_TOLERANCE = "Orientation tolerance [rad]. Default: the arm's."
DEADLINE = "Longest time of planning [s], also for a goal that is not found. Default: see `planning` of the arm's file."
EFFORT = "Work of each search instead of a deadline, about one unit a millisecond: the same answers on every run."
APART = "Search each goal of --goals by itself, from --previous or from its own `previous`."
OUTPUT = "Write the results of --goals to a file as JSON lines; started again, the command goes on where it ended."
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
    effort: Annotated[float | None, typer.Option(help=EFFORT)] = None,
    apart: Annotated[bool, typer.Option("--apart", help=APART)] = False,
    workers: Workers = 1,
    dask: Dask = None,
    output: Annotated[Path | None, typer.Option(metavar="FILE.jsonl", help=OUTPUT)] = None,
    as_json: AsJson = False,
) -> None:
    """Search configurations for goals, without hardware."""
    tolerances = tolerance, angle_tolerance, path_tolerance
    options = PlanOptions(goal, goals, configuration, previous, *tolerances, method, deadline, effort, apart)
    where = StudyOptions(Sharing(workers, dask), output)
    check_study(options, where)
    arm = load(file)
    task = read_task(arm, options)
    if goals is not None:
        study_goals(PlanJob(arm, options, task.start, silent=as_json), task, where, as_json=as_json)
        return
    search = prepared_search(arm, options, silent=as_json)
    if task.goal is not None:
        found = search_one(search, task.goal, task.start)
    else:
        assert task.described is not None
        found = described(search, task.start, task.described)
    print_results([shown_result(arm, options, found)], options, as_json=as_json)
    check_goal(options, found)
    check_clearance(search, options, task)


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

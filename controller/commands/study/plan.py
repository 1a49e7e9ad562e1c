"""The command `plan`: searches configurations for one goal, or for the goals of a file as a study."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import ExitStack, closing
from itertools import islice
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.armfile.goal_files import parse_goal, read_goal
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmFile, AsJson, Connect, Dask, Tolerance, Workers, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, errors, shown
from hyperbit.controller.commands.sharing import Sharing, checked_sharing, open_workers, progress_bar
from hyperbit.controller.commands.study.plan_goal import plan_goal
from hyperbit.controller.commands.study.plan_rows import (
    PlanOptions,
    PointSolution,
    Row,
    WantedGoal,
    print_results,
    read_goals,
    results_file,
    row_of,
    unlocked,
    write_line,
)
from hyperbit.controller.commands.study.plan_search import (
    described,
    follow,
    prepared_search,
    search_one,
    trajectories,
)
from hyperbit.controller.host.files import open_file
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.search.method import Method
from hyperbit.controller.studies.shares import Run, goals_a_share
from hyperbit.controller.studies.stream import results

ONE_GOAL = "One goal, optionally with an orientation; spatial arms: X,Y,Z[,QX,QY,QZ,QW]."
GOAL_FILE = (
    "File of a goal as `send` takes it, planned from where the arm is, as its daemon tells; without a daemon from"
    " --previous."
)
PICTURE = "Draw the plan of a goal's file."
MANY_GOALS = (
    "Goals of a study: a CSV file with columns x,y[,th] or x,y,z[,qx,qy,qz,qw], and optionally `previous`; or a goal's"
    " file, whose times do not count."
)
PATH_TOLERANCE = "Follow straight lines between --goals within this distance."
ANGLE_TOLERANCE = "Orientation tolerance [rad]. Default: the arm's."
DEADLINE = "Longest time of planning [s], also for a goal that is not found. Default: see `planning` of the arm's file."
EFFORT = "Work of each search instead of a deadline, about one unit a millisecond: the same answers on every run."
APART = "Search each goal of --goals by itself, from --previous or from its own `previous`."
PROVE = "Search the whole trajectory of --goals until its switches are proven fewest, or until --deadline (60 s)."
OUTPUT = "Write the results of --goals to a file as JSON lines; started again, the command goes on where it ended."
START = "Configuration to start from. Default: all contracted."
MOST_ROWS = 300  # of a table, which is printed at the end


def plan(
    file: ArmFile,
    goal_file: Annotated[Path | None, typer.Argument(metavar="GOAL", help=GOAL_FILE, show_default=False)] = None,
    goal: Annotated[str | None, typer.Option(metavar="X,Y[,TH]", help=ONE_GOAL)] = None,
    goals: Annotated[Path | None, typer.Option(metavar="FILE.csv", help=MANY_GOALS)] = None,
    configuration: Annotated[str | None, typer.Option(help="Configuration to describe instead of a search.")] = None,
    previous: Annotated[str | None, typer.Option(help=START)] = None,
    tolerance: Tolerance = None,
    angle_tolerance: Annotated[float | None, typer.Option("--turn", help=ANGLE_TOLERANCE)] = None,
    path_tolerance: Annotated[float | None, typer.Option(help=PATH_TOLERANCE)] = None,
    method: Annotated[Method | None, typer.Option(help="Search method. Default: the arm's.")] = None,
    deadline: Annotated[float | None, typer.Option(help=DEADLINE)] = None,
    effort: Annotated[float | None, typer.Option(help=EFFORT)] = None,
    apart: Annotated[bool, typer.Option("--apart", help=APART)] = False,
    prove: Annotated[bool, typer.Option("--prove", help=PROVE)] = False,
    workers: Workers = 1,
    dask: Dask = None,
    output: Annotated[Path | None, typer.Option(metavar="FILE.jsonl", help=OUTPUT)] = None,
    picture: Annotated[Path | None, typer.Option(help=PICTURE)] = None,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Plan a goal's file as `send` would carry it out, or search configurations for goals. Nothing moves."""
    tolerances = tolerance, angle_tolerance, path_tolerance
    options = PlanOptions(goal, goals, configuration, previous, *tolerances, method, deadline, effort, apart, prove)
    sharing = checked_sharing(workers, dask)
    if goal_file is not None:
        check_alone(options, sharing.given or (output and "--output"))
        fields = {"deadline": deadline, "path_tolerance": path_tolerance}
        payload = {**read_goal(goal_file), **{name: value for name, value in fields.items() if value is not None}}
        plan_goal(file, payload, previous, connect, zenoh_file, picture, as_json=as_json)
        return
    if picture is not None:
        raise InputFaults(Path("--picture"), ["it is for a goal's file: plan ARM.yaml GOAL"])
    if goals is None and (given := sharing.given or (output and "--output")):
        raise InputFaults(Path(given), ["it is for many goals: give --goals FILE.csv"])
    check_options(options)
    arm = load(file)
    home = np.zeros(len(arm.reduced.modules), dtype=np.int64)
    start = home if previous is None else unlocked(arm, previous, "--previous")
    if goals is not None:
        study_goals(PlanJob(arm, options, start, sharing.workers, silent=as_json), sharing, output, as_json=as_json)
        return
    wanted = None if goal is None else WantedGoal(*parse_goal(goal.split(","), arm.manipulator.dimension, "--goal"))
    shape = home if configuration is None else unlocked(arm, configuration, "--configuration")
    search = prepared_search(arm, options, silent=as_json)
    found = described(search, start, shape) if wanted is None else search_one(search, wanted, start)
    print_results([row_of(arm, options, found)], options, arm.settings.unit, as_json=as_json)
    if wanted is not None:
        check_reached(found, f"goal {goal}")
    elif (clearance := search.solver.clearance) is not None and (where := clearance.where(shape)) is not None:
        raise CommandFailed(f"configuration {configuration}: {where}")


def check_alone(options: PlanOptions, study: object) -> None:
    """Refuses the options of a study beside a goal's file."""
    taken = {name for name, value in options._asdict().items() if value}
    if other := sorted(taken - {"previous", "path_tolerance", "deadline"}):
        study = f"--{other[0].replace('_', '-')}"
    if study:
        raise InputFaults(Path("plan"), [f"give either a goal's file, which is planned as `send` would, or {study}"])


def check_options(options: PlanOptions) -> None:
    if [options.goal, options.goals, options.configuration].count(None) != 2:
        raise InputFaults(Path("plan"), ["give one of a goal's file, --goal, --goals and --configuration"])
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
    if options.prove and (options.goals is None or options.apart):
        raise InputFaults(Path("--prove"), ["it is for a trajectory: give --goals FILE.csv, without --apart"])
    if options.effort is not None and options.goals is not None and not options.apart:
        raise InputFaults(
            Path("--effort"), ["a trajectory is planned by time; add --apart to search each goal by itself"]
        )
    if options.effort is not None and options.deadline is not None:
        raise InputFaults(Path("--effort"), ["a search ends by work or by time: give --effort or --deadline"])


def check_reached(point: PointSolution, goal: str) -> None:
    found = point.solution
    if not found.within_tolerance:
        away = f"{found.error:.4f} away" + ("" if point.orientation is None else f" and turned {found.angle:.4f} rad")
        nearest = shown(found.tip[: len(point.position), 3])
        raise CommandFailed(f"{goal} {found.reach}: nearest point found {nearest}, {away}")


class PlanJob(NamedTuple):
    """What the shares of `plan --goals` have in common. The first goal starts at `start`, shape (B,)."""

    arm: Arm
    options: PlanOptions
    start: Configuration
    processes: int  # that share the processors of this computer
    silent: bool  # show no progress of the tables

    def prepare(self) -> Run:
        """Returns what searches the goals of a share: each apart, or all as one trajectory."""
        search = prepared_search(self.arm, self.options, silent=self.silent)

        def run(goals: list[WantedGoal]) -> Iterator[Row]:
            apart = (search_one(search, goal, self.start) for goal in goals)
            for point in apart if self.options.apart else follow(search, goals, self.start, self.processes):
                yield row_of(self.arm, self.options, point)

        return run


def study_goals(job: PlanJob, sharing: Sharing, output: Path | None, *, as_json: bool) -> None:
    """Searches the goals of a file; prints the results in order as they come, or writes them to a file."""
    total = timed = 0
    for goal in read_goals(job.arm, job.options):  # all are checked before the first is searched
        total, timed = total + 1, timed + goal.timed
    if timed:
        errors.print("a study ignores the times `t`; with them plans: hyperbit plan ARM.yaml GOAL")
    with ExitStack() as stack:
        file, done = None, 0
        if output is not None:
            file, done = stack.enter_context(results_file(output, about(job), parts(job)))
        if done:
            errors.print(f"{output} has {done} of {total} goals; the search goes on after them")

        def remedy() -> str:
            if done == 0:
                return ""
            if output is None:
                way = "with --output FILE.jsonl the same command goes on where it ended"
                return f"{done} of {total} goals are done; {way}"
            return f"{output} has {done} of {total} goals; the same command goes on after them"

        client = stack.enter_context(open_workers(sharing, remedy))
        found = stack.enter_context(closing(results(job, shares(job, done), client)))
        progress = stack.enter_context(progress_bar("goals", shown=file is not None or not as_json))
        task = progress.add_task("", total=total, completed=done, before=done)

        def counted() -> Iterator[Row]:
            nonlocal done
            for row in (row for share in found for row in share):
                yield row
                done += not row.line.get("between", False)
                progress.update(task, completed=done)

        if file is None or output is None:
            print_results(counted(), job.options, job.arm.settings.unit, as_json=as_json, many=total > MOST_ROWS)
            return
        for row in counted():
            write_line(output, file, row.line)
        errors.print(f"{output} has the results of {total} goals")


def about(job: PlanJob) -> dict[str, object]:
    """Returns what results belong to: one arm, file of goals and set of options."""
    own = {name: value for name, value in job.options._asdict().items() if name != "goals" and value is not None}
    with open_file(job.options.goals or Path(), None) as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"study": "plan", "arm": job.arm.digest, "goals": digest, "options": own}


def shares(job: PlanJob, done: int) -> Iterator[list[WantedGoal]]:
    """Yields the goals of each share as they are read: some goals apart, or one trajectory."""
    goals = islice(read_goals(job.arm, job.options), done, None)
    if not job.options.apart:
        yield from trajectories(goals)
        return
    while share := list(islice(goals, goals_a_share(job.options.effort))):
        yield share


def parts(job: PlanJob) -> Iterator[list[list[float]]]:
    """Yields the positions of the goals of each part that is searched as a whole."""
    goals = read_goals(job.arm, job.options)
    for part in ([goal] for goal in goals) if job.options.apart else trajectories(goals):
        yield [goal.position for goal in part]

"""The command `plan`: searches configurations for goals."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from controller.arm.arm import Arm, load
from controller.armfile.strict import InputFaults
from controller.commands.common import (
    ArmFile,
    AsJson,
    Failed,
    configuration,
    console,
    densities_of,
    parse_goal,
    print_json,
    results_table,
    shown,
)
from controller.commands.study.plan_goals import Goals, Orientation, Tolerances, follow, given, search
from controller.manipulator.locked import transferred
from controller.manipulator.manipulator import Configuration
from controller.motion.plans.description import describe_solution
from controller.search.method import Method

if TYPE_CHECKING:
    from controller.search.solution import Solution

ONE_GOAL = "One goal, optionally with an orientation; spatial arms: X,Y,Z[,QX,QY,QZ,QW]."
MANY_GOALS = "Goals with columns x,y[,th] or x,y,z[,qx,qy,qz,qw], and optionally `previous`."


def plan(
    file: ArmFile,
    goal: Annotated[str | None, typer.Option(metavar="X,Y[,TH]", help=ONE_GOAL)] = None,
    goals: Annotated[Path | None, typer.Option(metavar="FILE.csv", help=MANY_GOALS)] = None,
    to: Annotated[
        str | None, typer.Option("--configuration", help="Configuration to describe instead of a search.")
    ] = None,
    previous: Annotated[str | None, typer.Option(help="Configuration to start from. Default: all contracted.")] = None,
    tolerance: Annotated[float | None, typer.Option(help="Position tolerance. Default: the arm's.")] = None,
    turn: Annotated[float | None, typer.Option(help="Orientation tolerance [rad]. Default: the arm's.")] = None,
    path_tolerance: Annotated[
        float | None, typer.Option(help="Follow straight lines between --goals within this distance.")
    ] = None,
    method: Annotated[Method | None, typer.Option(help="Search method. Default: the arm's.")] = None,
    as_json: AsJson = False,
) -> None:
    """Search configurations for goals, without hardware."""
    from controller.search.solver import Solver

    arm = load(file)
    if [goal, goals, to].count(None) != 2:
        raise InputFaults(Path("plan"), ["give one of --goal, --goals and --configuration"])
    for name, length in (("--tolerance", tolerance), ("--turn", turn), ("--path-tolerance", path_tolerance)):
        if length is not None and not 1e-9 <= length <= 1e6:
            kind = "angle" if name == "--turn" else "length"
            raise InputFaults(Path(name), [f"{length:g} is no {kind} from 1e-9 to 1e6"])
    if path_tolerance is not None and goals is None:
        raise InputFaults(Path("--path-tolerance"), ["lines need several goals: give --goals FILE.csv"])
    home = np.zeros(len(arm.reduced.modules), dtype=np.int64)
    start = home if previous is None else unstuck(arm, previous, "--previous")
    end = None if to is None else unstuck(arm, to, "--configuration")
    wanted: Goals = []
    if goal is not None:
        wanted = [(*parse_goal(goal, arm.manipulator.dimension, "--goal"), None)]
    elif goals is not None:
        wanted = read_goals(arm, goals)
    if path_tolerance is not None:
        check_lines(wanted, goals or Path())
    solver = Solver(arm.reduced, densities_of(arm, silent=as_json), arm.weights(), arm.clearance(arm.reduced))
    solver.prepare()
    tolerances = Tolerances(tolerance or arm.tolerance, turn or arm.angle_tolerance, path_tolerance)
    chosen = method or arm.settings.method
    if end is not None:
        answers = iter([given(solver, end, start, tolerances.position)])
    elif goal is not None:
        answers = search(solver, wanted, start, tolerances, chosen)
    else:
        answers = follow(arm, solver, wanted, start, tolerances, chosen)
    table = results_table("goal", "configuration", "position", "θ [rad]", "error", "switches", "ms")
    wholes = list[dict[str, Any]]()
    for position, orientation, found, between, whole in answers:
        line = answer(arm, position, orientation, found)
        if path_tolerance is not None:
            line["between"] = between
        if goals is not None:
            line["trajectory"] = whole
        if whole is not None and not any(whole is known for known in wholes):
            wholes.append(whole)
        if as_json:
            print_json(line)
        table.add_row(
            ("  " if between else "") + ", ".join(f"{x:g}" for x in [*position, *turned(orientation)]),
            line["configuration"],
            shown(line["position"]),
            shown(line["orientation"]),
            f"[{'green' if found.within_tolerance else 'red'}]{found.error:.5f}"
            + ("" if orientation is None else f", {found.angle:.3f}"),
            str(found.switches),
            f"{found.seconds * 1e3:.2f}",
        )
    if not as_json:
        console.print(table)
        for whole in wholes:
            console.print(sentence(whole))
    if goal is not None and not found.within_tolerance:
        away = f"{found.error:.4f} away" + ("" if orientation is None else f" and turned {found.angle:.4f} rad")
        raise Failed(f"goal {goal} {found.reach}: nearest point found {shown(line['position'])}, {away}")
    if solver.clearance is not None and end is not None and (where := solver.clearance.where(end)) is not None:
        raise Failed(f"configuration {to}: {where}")


def answer(arm: Arm, position: list[float], orientation: Orientation, found: Solution) -> dict[str, Any]:
    """Returns the solution of a goal, for JSON."""
    return {
        "goal": position,
        **describe_solution(arm.manipulator, arm.reduced, found, orientation is not None),
        "within_tolerance": found.within_tolerance,
    }


def sentence(whole: dict[str, Any]) -> str:
    """Returns a sentence on switches and certificate of a whole trajectory."""
    least = f"at least {whole['lower_bound'] or 0:g}"
    if whole["cost"] == whole["switches"]:
        cost, proven = "", {"optimal": "proven to be the fewest", "bound": f"proven: {least}"}
    else:
        cost = f" of cost {whole['cost']:.6g}"
        proven = {"optimal": "proven to cost least", "bound": f"proven: a cost of {least}"}
    return f"{whole['switches']} switches{cost} in all; {proven.get(whole['certificate'], 'nothing is proven')}"


def check_lines(wanted: Goals, path: Path) -> None:
    """Checks that straight lines can join the goals of a file.

    Raises:
        InputFaults: a goal has an orientation, or a previous configuration.
    """
    if any(given is not None for _, _, given in wanted):
        raise InputFaults(path, ["column previous: remove it, each line begins at the end of the previous line"])
    if any(orientation is not None for _, orientation, _ in wanted):
        raise InputFaults(path, ["orientations: remove them, lines are followed by position only"])


def turned(orientation: Orientation) -> list[float]:
    """Returns the numbers of an orientation: none, the angle, or the quaternion."""
    return [] if orientation is None else orientation if isinstance(orientation, list) else [orientation]


def read_goals(arm: Arm, path: Path) -> Goals:
    """Reads goals from a CSV file: position, and orientation and previous configuration if given.

    Raises:
        InputFaults: the file is missing or wrong; each fault names its line.
    """
    columns = ["x", "y", "z"][: arm.manipulator.dimension]
    turns = ["th"] if arm.manipulator.planar else ["qx", "qy", "qz", "qw"]
    rows: Goals = []
    faults: list[str] = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            names = reader.fieldnames or []
            if set(turns) <= set(names):
                columns += turns
            if not set(columns) <= set(names) <= {*columns, "previous"}:
                needed = f"columns {','.join(columns)} are needed, {','.join(turns)} and previous are optional"
                raise InputFaults(path, [f"{needed}; got {names}"])
            for row in reader:
                where = f"line {reader.line_num}"
                try:
                    text = ",".join(row[name] or "" for name in columns)
                    wanted = parse_goal(text.rstrip(","), arm.manipulator.dimension, where)
                    given = unstuck(arm, row["previous"], where) if row.get("previous") else None
                    rows.append((*wanted, given))
                except InputFaults as error:
                    faults += [f"{where}: {fault}" for fault in error.faults]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputFaults(path, [f"cannot be read: {error}"]) from None
    if faults or not rows:
        raise InputFaults(path, faults or ["no goals"])
    return rows


def unstuck(arm: Arm, text: str, where: str) -> Configuration:
    """Parses a configuration of the whole arm and returns it as a configuration of `arm.reduced`, shape (B,).

    Raises:
        InputFaults: the arm has no such configuration, or a locked actuator is in another state.
    """
    whole = configuration(arm, text, where)
    try:
        return transferred(whole, arm.manipulator, arm.reduced)
    except ValueError as error:
        raise InputFaults(Path(where), [f"{text}: as actuators are locked, {error}"]) from None

"""Commands that reckon: plan, fk, map, figure5."""

import csv
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from controller.commands.common import (
    ArmFile,
    AsJson,
    Failed,
    console,
    densities_of,
    parse_goal,
    print_json,
    shipped,
)
from controller.commands.searching import Goals, Orientation, follow_lines, search
from controller.config import Arm, load
from controller.manipulator import frames
from controller.manipulator.held import carried
from controller.manipulator.manipulator import Configuration
from controller.manipulator.notation import format_configuration, parse_configuration
from controller.search.method import Method
from controller.strict import InputFaults

ONE_GOAL = "One goal, with an orientation if it matters; in space X,Y,Z[,QX,QY,QZ,QW]."
MANY_GOALS = "Columns x,y[,th] or x,y,z[,qx,qy,qz,qw], and maybe previous."


def configuration(arm: Arm, text: str, where: str) -> Configuration:
    """Returns the configuration that `text` writes; what is wrong with it is told of `where`."""
    try:
        return parse_configuration(arm.manipulator, text)
    except ValueError as error:
        raise InputFaults(Path(where), [str(error)]) from None


def unstuck(arm: Arm, text: str, where: str) -> Configuration:
    """Returns the configuration that `text` writes as one of `arm.left`; what is wrong with it is told of `where`."""
    whole = configuration(arm, text, where)
    try:
        return carried(whole, arm.manipulator, arm.left)
    except ValueError as error:
        raise InputFaults(Path(where), [f"{text}: as actuators are stuck, {error}"]) from None


def pose(arm: Arm, tip: frames.Frame) -> dict[str, Any]:
    """Returns position and orientation of a frame for JSON."""
    planar = arm.manipulator.planar
    orientation = frames.angle(tip) if planar else frames.quaternion(tip).tolist()
    return {"position": tip[: arm.manipulator.dimension, 3].tolist(), "orientation": orientation}


def shown(values: Any) -> str:
    """Returns numbers for a table."""
    return ", ".join(f"{v:.4f}" for v in np.atleast_1d(values))


def results_table(*columns: str) -> Table:
    """Returns an empty table that leaves configurations whole on a narrow terminal."""
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="bold underline")
    for column in columns:
        table.add_column(column, no_wrap=True)
    return table


def fk(
    file: ArmFile,
    states: Annotated[str, typer.Argument(metavar="CONFIGURATION", help="Module states, base first.")],
    as_json: AsJson = False,
) -> None:
    """Say where a configuration brings the tip."""
    arm = load(file)
    found = pose(arm, arm.manipulator.tip(configuration(arm, states, "CONFIGURATION")))
    if as_json:
        print_json(found)
    else:
        console.print(f"position {shown(found['position'])}  orientation {shown(found['orientation'])}")


def plan(
    file: ArmFile,
    goal: Annotated[str | None, typer.Option(metavar="X,Y[,TH]", help=ONE_GOAL)] = None,
    goals: Annotated[Path | None, typer.Option(metavar="FILE.csv", help=MANY_GOALS)] = None,
    previous: Annotated[str | None, typer.Option(help="Configuration to start from; contracted if absent.")] = None,
    tolerance: Annotated[float | None, typer.Option(help="Of the position; the arm's if absent.")] = None,
    turn: Annotated[float | None, typer.Option(help="Tolerance of the orientation [rad]; the arm's if absent.")] = None,
    path_tolerance: Annotated[float | None, typer.Option(help="Follow the straight lines between --goals.")] = None,
    method: Annotated[Method | None, typer.Option(help="The arm's if absent.")] = None,
    as_json: AsJson = False,
) -> None:
    """Search configurations for goals, without any hardware."""
    from controller.search.solver import Solver

    arm = load(file)
    if (goal is None) == (goals is None):
        raise InputFaults(Path("plan"), ["give either --goal or --goals"])
    lengths = (("--tolerance", tolerance), ("--turn", turn), ("--path-tolerance", path_tolerance))
    for name, length in lengths:
        if length is not None and not 1e-9 <= length <= 1e6:
            raise InputFaults(
                Path(name), [f"{length:g} is no {'angle' if name == '--turn' else 'length'} from 1e-9 to 1e6"]
            )
    if path_tolerance is not None and goals is None:
        raise InputFaults(Path("--path-tolerance"), ["lines run between --goals, one goal has none"])
    home = np.zeros(len(arm.left.modules), dtype=np.int64)
    reached = home if previous is None else unstuck(arm, previous, "--previous")
    if goal is not None:
        wanted: Goals = [(*parse_goal(goal, arm.manipulator.dimension, "--goal"), None)]
    else:
        wanted = read_goals(arm, goals or Path())
    if path_tolerance is not None and any(given is not None for _, _, given in wanted):
        raise InputFaults(goals or Path(), ["column previous: a line begins where the one before ended"])
    if path_tolerance is not None and any(orientation is not None for _, orientation, _ in wanted):
        raise InputFaults(goals or Path(), ["orientations: lines are followed by position only"])
    solver = Solver(arm.left, densities_of(arm, silent=as_json), arm.weights(), arm.clearance(arm.left))
    solver.prepare()
    table = results_table("goal", "configuration", "position", "θ [rad]", "error", "switches", "ms")
    missed = 0
    own, chosen = tolerance or arm.tolerance, method or arm.settings.method
    if path_tolerance is None:
        answers = search(solver, wanted, reached, own, turn or arm.turn, chosen)
    else:
        answers = follow_lines(arm, solver, [p for p, _, _ in wanted], reached, own, path_tolerance, chosen)
    for position, orientation, found, between in answers:
        missed += not found.within_tolerance
        line = {
            "goal": position,
            "configuration": format_configuration(
                arm.manipulator, carried(found.configuration, arm.left, arm.manipulator)
            ),
            **pose(arm, found.tip),
            "error": found.error,
            "orientation_error": None if orientation is None else found.angle,
            "switches": found.switches,
            "within_tolerance": found.within_tolerance,
            "seconds": found.seconds,
            "cost": found.cost,
            "optimal": found.optimal,
            "lower_bound": found.lower_bound if np.isfinite(found.lower_bound) else None,
        }
        if path_tolerance is not None:
            line["between"] = between
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
    if goal is not None and missed:
        away = f"{found.error:.4f} away" + ("" if orientation is None else f" and turned {found.angle:.4f} rad")
        raise Failed(f"goal {goal} is out of reach: nearest point found {shown(line['position'])}, {away}")


def turned(orientation: Orientation) -> list[float]:
    """Returns an orientation's numbers: none, the angle, or the quaternion."""
    return [] if orientation is None else orientation if isinstance(orientation, list) else [orientation]


def read_goals(arm: Arm, path: Path) -> Goals:
    """Returns position, orientation and previous configuration, where given, of each row of a CSV file.

    Raises:
        InputFaults: the file is missing, or what is wrong in which lines.
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
                needed = f"columns {','.join(columns)} and maybe {','.join(turns)} and previous are needed"
                raise InputFaults(path, [f"{needed}, got {names}"])
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


def map_(
    file: ArmFile,
    rebuild: Annotated[bool, typer.Option("--rebuild", help="Map anew, whatever is in the cache.")] = False,
    as_json: AsJson = False,
) -> None:
    """Map the point densities of all intermediate workspaces into the cache."""
    from controller.workspace.cache import default_directory

    arm = load(file)
    began = time.perf_counter()
    densities = densities_of(arm, rebuild=rebuild, silent=as_json)
    seconds = time.perf_counter() - began
    largest = int(densities.shapes.prod(axis=1).max())
    finest, coarsest = float(densities.pixels.min()), float(densities.pixels.max())
    megabytes, cache = densities.values.nbytes / 1e6, str(default_directory())
    if as_json:
        print_json(
            {
                "levels": len(densities.pixels),
                "pixel": [finest, coarsest],
                "largest_level": largest,
                "megabytes": megabytes,
                "seconds": seconds,
                "cache": cache,
            }
        )
    else:
        console.print(
            f"{len(densities.pixels)} intermediate workspaces, pixel {finest:.4g} to {coarsest:.4g}, at most {largest}"
            f" pixels each, {megabytes:.1f} MB in {cache}, {seconds:.2f} s"
        )


def figure5(
    picture: Annotated[Path, typer.Option(help="Where the picture goes.")] = Path("figure5.png"),
    as_json: AsJson = False,
) -> None:
    """Repeat the paper's experiment of section 4: three targets, three algorithms."""
    from controller.figure5 import experiment, save

    arm = load(shipped("planar16.yaml"))
    densities = densities_of(arm, silent=as_json)
    rows = experiment(arm, densities)
    save(picture, arm, densities, rows)
    table = results_table("method", "target", "configuration", "x", "y", "θ", "error", "switches")
    for row in rows:
        if as_json:
            print_json({**row.__dict__, "picture": str(picture)})
        table.add_row(
            row.method,
            f"{row.target[0]:g}, {row.target[1]:g}",
            row.configuration,
            f"{row.x:.3f}",
            f"{row.y:.3f}",
            f"{row.theta:.3f}",
            f"{row.error:.4f}",
            str(row.switches),
        )
    if not as_json:
        console.print(table)
        console.print(f"picture: {picture}")

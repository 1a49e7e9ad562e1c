"""The command `send`: sends a goal and follows it to its result."""

from __future__ import annotations

import shlex
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperbit.controller.armfile.goal_files import Orientation, parse_goal, read_goal
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.units import unit_mark
from hyperbit.controller.commands import ENDPOINT, common
from hyperbit.controller.commands.arguments import ArmName, AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, counted, print_json, refusal
from hyperbit.controller.commands.connection import connected, named
from hyperbit.controller.decoding.decoding import convert
from hyperbit.controller.messages.goals import Feedback, Result

if TYPE_CHECKING:
    from hyperbit.controller.network.client import Client

FILE = "File of a goal: YAML or JSON with `waypoints`, or CSV with a waypoint in each row (x, y[, z][, th][, t])."
ONE_GOAL = "Position to go to, optionally with an orientation; spatial arms: X,Y,Z[,QX,QY,QZ,QW]."


def send(
    arm: ArmName,
    file: Annotated[Path | None, typer.Argument(metavar="GOAL", help=FILE)] = None,
    to: Annotated[str | None, typer.Option(metavar="X,Y[,TH]", help=ONE_GOAL)] = None,
    configuration: Annotated[
        str | None, typer.Option(help="Configuration to go to: module states, base first.")
    ] = None,
    pose: Annotated[str | None, typer.Option(metavar="NAME", help="Named pose to go to, see `poses`.")] = None,
    path_tolerance: Annotated[
        float | None, typer.Option(help="Follow straight lines between waypoints within this distance.")
    ] = None,
    deadline: Annotated[float | None, typer.Option(help="Longest time of planning, up to 60 [s].")] = None,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Send a goal and follow it to its result; Ctrl-C cancels the goal."""
    if [file, to, configuration, pose].count(None) != 3:
        raise InputFaults(Path("send"), ["give one of a goal's file, --to, --configuration and --pose"])
    goal = {} if file is None else read_goal(file)
    if configuration is not None:
        goal["waypoints"] = [{"configuration": configuration}]
    if path_tolerance is not None:
        goal["path_tolerance"] = path_tolerance
    if deadline is not None:
        goal["deadline"] = deadline
    numbers = 0 if to is None else to.count(",") + 1
    if to is not None and numbers > 3 and numbers != 7:
        form = "X,Y[,TH] is needed, or in space X,Y,Z[,QX,QY,QZ,QW]"
        raise InputFaults(Path("--to"), [f"{to!r} is no goal; {form}: 2, 3 or 7 numbers"])
    if to is not None and numbers != 3:
        goal["waypoints"] = [waypoint(*parse_goal(to.split(","), 2 if numbers < 3 else 3, "--to"))]
    further = named(arm, connect, zenoh_file)
    with connected(arm, connect, zenoh_file) as client:
        if pose is not None:
            goal = {**goal_of_pose(client, pose, further), **goal}
        if to is not None and numbers == 3:  # X,Y,Z or X,Y,TH: the arm's dimension decides
            goal["waypoints"] = [waypoint(*parse_goal(to.split(","), client.describe().dimension, "--to"))]
        unit = "" if as_json else unit_mark(client.describe().unit)
        result = run_goal(client, goal, as_json, unit)
    print_result(result, further, as_json, unit)


def waypoint(position: list[float], orientation: Orientation) -> dict[str, Any]:
    return {"position": position, **({} if orientation is None else {"orientation": orientation})}


def goal_of_pose(client: Client, name: str, arm: str) -> dict[str, Any]:
    known = {pose.name: pose.goal for pose in client.describe().poses}
    if name not in known:
        raise CommandFailed(
            f"{shlex.split(arm)[0]} has no pose {name!r}; it has {', '.join(known)}", f"hyperbit poses {arm}"
        )
    return known[name]


def run_goal(client: Client, goal: dict[str, Any], as_json: bool, unit: str) -> dict[str, Any]:
    """Sends a goal, prints its answer and feedback, lengths with their `unit`, and returns its result."""

    def show(message: dict[str, Any]) -> None:
        if as_json:
            print_json(message)
        elif message.get("waypoint") is not None:
            feedback = convert(message, Feedback)
            common.console.print(
                f"waypoint {(feedback.waypoint or 0) + 1} of {feedback.waypoints}: error {errors_of(feedback, unit)},"
                f" {counted(feedback.switches)} so far"
            )
        elif message.get("accepted"):
            common.console.print(message["message"])

    goal.setdefault("id", uuid.uuid4().hex[:12])
    try:
        return client.run(goal, show)
    except KeyboardInterrupt:
        cancel_goal(client, goal["id"], as_json)
        raise typer.Exit(130) from None


def print_result(result: dict[str, Any], arm: str, as_json: bool, unit: str) -> None:
    """Prints the result of a goal, or raises its failure. `arm`: see `named`."""
    if as_json and "status" in result:
        print_json(result)
    if result.get("code") != 0:
        raise refusal(result, arm)
    if not as_json:
        told = convert(result, Result)
        position = ", ".join(f"{x:.4f}" for x in told.position or ()) or "unknown"
        common.console.print(f"reached ({position}){unit}, error {errors_of(told, unit)}, {counted(told.switches)}")
        if (why := told.message.removeprefix("reached").lstrip("; ")) != "":
            common.console.print(why)


def cancel_goal(client: Client, goal: str, as_json: bool) -> None:
    """Cancels the goal of an interrupted command, and no other goal; prints the daemon's answer."""
    common.errors.print(f"interrupted: canceling goal {goal}")
    answer = client.request("cancel", {"id": goal})
    if as_json:
        print_json(answer)
    else:
        common.console.print(f"goal {goal}: {answer['message']}")


def errors_of(told: Feedback | Result, unit: str) -> str:
    """Returns the position error in a message, and the orientation error [rad] if the goal has an orientation."""
    if told.error is None:
        return "unknown"
    angle = told.orientation_error
    return f"{told.error:.4f}{unit}" + ("" if angle is None else f" and {angle:.4f} rad")

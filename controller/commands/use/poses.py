"""The command `poses`: lists, saves and removes named poses of a running arm."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from msgspec import Struct, to_builtins

from hyperbit.controller.armfile.goal_files import read_goal
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmName, AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, print_json
from hyperbit.controller.commands.connection import ask, connected, named
from hyperbit.controller.decoding.decoding import Unreadable, convert
from hyperbit.controller.messages.arm import NamedPose
from hyperbit.controller.messages.parts import Orientation, Position

if TYPE_CHECKING:
    from hyperbit.controller.network.client import Client

SAVE = "Save a pose under this name: the goal of FILE, or the arm's present configuration."
FILE = "File of the goal to save: YAML, JSON or CSV, as `send` takes it."


class Waypoint(Struct):
    configuration: str | None = None
    position: Position | None = None
    orientation: Orientation | None = None


class SavedGoal(Struct):
    """The part of a goal that a list of poses shows."""

    waypoints: list[Waypoint] = []


def poses(
    arm: ArmName,
    file: Annotated[Path | None, typer.Argument(metavar="FILE", help=FILE, show_default=False)] = None,
    save: Annotated[str | None, typer.Option(metavar="NAME", help=SAVE, show_default=False)] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Save in place of an earlier pose of this name.")] = False,
    remove: Annotated[str | None, typer.Option(metavar="NAME", help="Remove a saved pose.", show_default=False)] = None,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """List the named poses of an arm, save one, or remove one; `send --pose` goes there. Nothing moves."""
    if (save is not None and remove is not None) or (file is not None and save is None):
        raise InputFaults(Path("poses"), ["give --save NAME [FILE], or --remove NAME, or neither"])
    goal = None if file is None else read_goal(file)
    further = named(arm, connect, zenoh_file)
    with connected(arm, connect, zenoh_file) as client:
        if save is not None:
            if not replace and save in (pose.name for pose in client.describe().poses):
                raise CommandFailed(f"{arm} has a pose {save!r} already", "give another name, or --replace")
            ask(
                client,
                named(arm, connect, zenoh_file),
                "poses",
                {"save": save, "goal": goal or present(client, arm)},
                as_json,
            )
        elif remove is not None:
            ask(client, further, "poses", {"remove": remove}, as_json)
        else:
            print_poses(client.describe().poses, as_json)


def present(client: Client, arm: str) -> dict[str, Any]:
    state = client.next_state()
    if state.configuration is None:
        raise CommandFailed(f"{arm} is in no configuration: {state.reason}", "save a goal's file instead")
    return {"waypoints": [{"configuration": state.configuration}]}


def print_poses(listed: list[NamedPose], as_json: bool) -> None:
    for pose in listed:
        if as_json:
            print_json(to_builtins(pose))
            continue
        try:
            waypoints = convert(pose.goal, SavedGoal).waypoints
        except Unreadable:  # of a stranger
            waypoints = []
        more = "" if len(waypoints) < 2 else f", and {len(waypoints) - 1} more waypoints"
        typer.echo(f"{pose.name}: {shown(waypoints[0]) if waypoints else 'no waypoint'}{more}")


def shown(waypoint: Waypoint) -> str:
    if waypoint.configuration is not None:
        return f"configuration {waypoint.configuration}"
    position = ", ".join(f"{x:g}" for x in waypoint.position or ())
    return f"({position})" + (" with an orientation" if waypoint.orientation is not None else "")

"""The command `obstacles`: lists the obstacles of a running arm, or replaces those that were sent."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hyperbit.controller.armfile.documents import parse_payload, read_text
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmName, AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import print_json
from hyperbit.controller.commands.connection import ask, connected, named
from hyperbit.controller.messages.arm import Description

REGIONS = "Obstacles, YAML or JSON: a list `regions`, written as `obstacles` in the arm's file. Without it: list."
KINDS = ("disc", "sphere", "box", "half_plane", "half_space")


def obstacles(
    arm: ArmName,
    file: Annotated[Path | None, typer.Argument(metavar="REGIONS.yaml", help=REGIONS, show_default=False)] = None,
    none: Annotated[bool, typer.Option("--none", help="Remove all obstacles that were sent.")] = False,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """List the obstacles, or replace those that were sent before; the file's remain. Nothing moves."""
    if file is not None and none:
        raise InputFaults(Path("obstacles"), ["give either a file of regions or --none"])
    payload: dict[str, Any] = {"regions": []}
    if file is not None:
        payload = parse_payload(read_text(file), file, "regions", "regions")
    with connected(arm, connect, zenoh_file) as client:
        if file is None and not none:
            print_obstacles(client.describe(), as_json)
        else:
            ask(client, named(arm, connect, zenoh_file), "obstacles", payload, as_json)


def print_obstacles(arm: Description, as_json: bool) -> None:
    told = {"file": arm.obstacles, "sent": arm.sent_obstacles}
    if as_json:
        print_json({"obstacles": told["file"], "sent_obstacles": told["sent"]})
        return
    for source, entries in told.items():
        for entry in entries:
            kind = next((kind for kind in KINDS if isinstance(entry.get(kind), dict)), None)
            if kind is None:
                continue
            fields = ", ".join(f"{name} {value}" for name, value in entry[kind].items() if value is not None)
            name = f" {entry['name']!r}" if entry.get("name") else ""
            typer.echo(f"{kind.replace('_', '-')}{name}: {fields} ({'in the file' if source == 'file' else source})")
    if not any(told.values()):
        typer.echo("no obstacles")

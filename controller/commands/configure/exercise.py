"""The command `exercise`: moves each actuator once there and back, and measures its travel times."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT, common
from hyperbit.controller.commands.arguments import ArmName, AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, arm_name, print_json, results_table
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.network.messages import filled

if TYPE_CHECKING:
    from hyperbit.controller.network.client import Client

ONLY = "Only these actuators, such as 5.left. Default: all."
RESERVE = 1.25  # proposed travel time over the longest measured time
DIFFERENT = 1.5  # an actuator that is faster than the arm's time by this factor gets its own travel time
FIELDS = {"extended": "extend", "contracted": "contract"}  # in the arm's file, by state
END_STOPS = {"extended": "input", "contracted": "input_contracted"}


class MeasuredTravel(NamedTuple):
    """A motion of an actuator to one of its ends, by its label and the state there."""

    actuator: str
    state: str
    seconds: float | None  # travel time measured by the executor; None if it could not be measured


def exercise(
    arm: ArmName,
    actuators: Annotated[list[str] | None, typer.Argument(metavar="ACTUATOR", help=ONLY, show_default=False)] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before the arm moves.")] = False,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Move each actuator once there and back, one at a time, and propose travel times for the arm's file.

    The daemon checks each motion as a jog. The executor measures from SYNC to the frame that reports the end-stop. The
    first fault ends the exercise. Ctrl-C cancels the motion.
    """
    with connected(arm, connect, zenoh_file) as client:
        description = client.describe()
        chosen = choose(actuators or [], description["actuators"])
        where = dict(zip(description["actuators"], commanded(client), strict=True))
        if not yes:
            what = f"{len(chosen)} actuators" if len(chosen) > 1 else chosen[0]
            question = f"The arm {arm_name(arm)} will move: {what}, one at a time, there and back. Continue?"
            if not typer.confirm(question, err=True):
                raise CommandFailed("nothing was moved")
        travels: list[MeasuredTravel] = []
        failure = None
        try:
            for label in chosen:
                for state in (STATES[1 - where[label]], STATES[where[label]]):
                    travels.append(move(client, label, state))
                    if as_json:
                        print_json(travels[-1]._asdict())
        except KeyboardInterrupt:
            common.errors.print("interrupted: canceling the motion")
            client.request("cancel")
            raise typer.Exit(130) from None
        except CommandFailed as error:
            failure = error
        report(travels, description, as_json)
    if failure is not None:
        raise failure


def choose(wanted: list[str], labels: list[str]) -> list[str]:
    """Returns the labels of the actuators to exercise; all if none is named."""
    if unknown := [label for label in wanted if label not in labels]:
        text = f"{unknown[0]!r} is no actuator of this arm, which has {labels[0]} to {labels[-1]}"
        raise InputFaults(Path("exercise"), [text])
    return list(dict.fromkeys(wanted)) or labels


def commanded(client: Client) -> list[int]:
    """Returns the commanded state of each actuator, shape (A,), of an arm in mode ready."""
    state = client.next_message("state")
    if state["mode"] != "ready":
        raise CommandFailed(f"the arm is {state['mode']}: {state['reason']}; `exercise` needs an arm in mode ready")
    if state["commanded"] is None:
        raise CommandFailed(
            "the state of some actuators is unknown: jog them first; `hyperbit watch` names them as faults"
        )
    return [int(bit) for bit in state["commanded"]]


def move(client: Client, label: str, state: str) -> MeasuredTravel:
    result = client.run({"actuators": {label: state}}, key="jog")
    if "status" not in result:
        raise CommandFailed(f"{label} to {state}: refused (code {result.get('code', -1)}): {result['message']}")
    result = filled("result", result)
    if result["code"] != 0:
        raise CommandFailed(f"{label} to {state}: {result['status']} (code {result['code']}): {result['message']}")
    measured = [t["seconds"] for t in result["travels"] if (t["actuator"], t["state"]) == (label, state)]
    return MeasuredTravel(label, state, measured[0] if measured else None)


def report(travels: list[MeasuredTravel], description: Mapping[str, Any], as_json: bool) -> None:
    lines = proposal(travels, description["actuators"])
    if as_json:
        print_json({"proposal": "\n".join(lines)})
        return
    wired = {f"{board['module']}.{board['actuator']}": board for board in description["boards"]}
    table = results_table("actuator", *(f"{field} [ms]" for field in FIELDS.values()))
    for label in dict.fromkeys(travel.actuator for travel in travels):
        own = {travel.state: travel for travel in travels if travel.actuator == label}
        table.add_row(label, *(shown(own.get(state), wired.get(label, {}), state) for state in FIELDS))
    common.print_table(table)
    if lines:
        common.console.print(f"\nproposal for the arm's file, {RESERVE - 1:.0%} over the longest measured:\n")
        for line in lines:
            common.console.print(line)


def shown(travel: MeasuredTravel | None, wired: Mapping[str, Any], state: str) -> str:
    """Returns a travel time as text [ms], or the reason why it is missing."""
    if travel is None:
        return ""
    if travel.seconds is not None:
        return f"{1000 * travel.seconds:.1f}"
    return f"no `{END_STOPS[state]}`" if wired.get(END_STOPS[state]) is None else "not measured"


def proposal(travels: Iterable[MeasuredTravel], labels: Sequence[str]) -> list[str]:
    """Returns YAML lines for the file of an arm with these actuators.

    The arm gets a travel time for a direction in which all its actuators were measured. An actuator gets its own travel
    time where the arm gets none, or if it is much faster. A direction that was not measured gets no time.
    """
    single: dict[str, dict[str, float]] = {}
    for label, state, seconds in travels:
        times = single.setdefault(label, {})
        if seconds is not None:
            reserved = math.ceil(round(1000 * RESERVE * seconds, 6)) / 1000  # rounded up to a millisecond
            times[FIELDS[state]] = max(times.get(FIELDS[state], 0.0), reserved)
    whole = {
        field: max(single[label][field] for label in labels)
        for field in FIELDS.values()
        if all(field in single.get(label, {}) for label in labels)
    }
    lines = [f"travel_time: {written(whole)}"] if whole else []
    for label, times in single.items():
        faster = len(times) == len(FIELDS) and all(DIFFERENT * times[field] < whole.get(field, 0.0) for field in times)
        if faster or times.keys() - whole.keys():
            lines.append(f"# actuator {label}:  travel_time: {written(times)}")
    for field in FIELDS.values():
        without = [label for label, times in single.items() if field not in times]
        if lines and without:
            whose = "any actuator" if len(without) == len(single) > 1 else ", ".join(without)
            lines.append(f"# {field} of {whose} was not measured: keep the present time for it")
    return lines


def written(times: Mapping[str, float]) -> str:
    """Returns times as YAML; the time of a direction that was not measured is left open, "..."."""
    numbers = (f"{times[field]:g}" if field in times else "..." for field in FIELDS.values())
    return "{" + ", ".join(f"{field}: {number}" for field, number in zip(FIELDS.values(), numbers, strict=True)) + "}"

"""The command that moves each actuator once there and back, and measures its travel times: exercise."""

from __future__ import annotations

import math
import queue
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from controller.commands import common
from controller.commands.common import (
    ENDPOINT,
    ArmName,
    AsJson,
    Connect,
    Failed,
    ZenohFile,
    arm_name,
    print_json,
    results_table,
)
from controller.commands.connection import connected
from controller.commands.requests import STATES
from controller.strict import InputFaults

if TYPE_CHECKING:
    from controller.gateway.client import Client

ONLY = "As in 5.left: exercise these actuators only."
RESERVE = 1.25  # of the proposed travel times over the longest measured
DIFFERENT = 1.5  # an actuator whose time is shorter than the arm's by this factor gets lines of its own
PATIENCE = 10.0  # [s] for the daemon's state
FIELDS = {"extended": "extend", "contracted": "contract"}  # in the arm's file, by state
END_STOPS = {"extended": "input", "contracted": "input_contracted"}


class Way(NamedTuple):
    """A motion of an actuator to one of its ends.

    Attributes:
        actuator: label.
        state: of the end, "contracted" or "extended".
        seconds: travel time by the executor's measurement [s]; None if it could not be measured.
    """

    actuator: str
    state: str
    seconds: float | None


def exercise(
    arm: ArmName,
    actuators: Annotated[
        list[str] | None, typer.Argument(metavar="[ACTUATOR]...", help=ONLY, show_default=False)
    ] = None,
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
        description = client.request("arm")
        chosen = choose(actuators or [], description["actuators"])
        where = dict(zip(description["actuators"], commanded(client), strict=True))
        if not yes:
            what = f"{len(chosen)} actuators" if len(chosen) > 1 else chosen[0]
            question = f"The arm {arm_name(arm)} will move: {what}, one at a time, there and back. Go on?"
            if not typer.confirm(question, err=True):
                raise Failed("nothing was moved")
        ways: list[Way] = []
        failure = None
        try:
            for label in chosen:
                for state in there_and_back(where[label]):
                    ways.append(move(client, label, state))
                    if as_json:
                        print_json(ways[-1]._asdict())
        except KeyboardInterrupt:
            common.errors.print("interrupted: canceling the motion", markup=False)
            client.request("cancel")
            raise typer.Exit(130) from None
        except Failed as error:
            failure = error
        report(ways, description, as_json)
    if failure is not None:
        raise failure


def choose(wanted: list[str], labels: list[str]) -> list[str]:
    """Returns the labels of the actuators to exercise; all if none is named.

    Raises:
        InputFaults: the arm has no such actuator.
    """
    if unknown := [label for label in wanted if label not in labels]:
        text = f"{unknown[0]!r} is no actuator of this arm, which has {labels[0]} to {labels[-1]}"
        raise InputFaults(Path("exercise"), [text])
    return list(dict.fromkeys(wanted)) or labels


def commanded(client: Client) -> list[int]:
    """Returns the commanded state of each actuator of an arm that holds.

    Raises:
        Failed: the arm does not hold, or its state is unknown.
    """
    states: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    subscriber = client.subscribe("state", states.put)
    try:
        state = states.get(timeout=PATIENCE)
    except queue.Empty:
        raise Failed(f"the daemon told no state for {PATIENCE:g} s") from None
    finally:
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    if state["mode"] != "ready":
        raise Failed(f"the arm is {state['mode']}: {state['reason']}; an exercise needs an arm that is ready")
    if state["commanded"] is None:
        raise Failed("nobody knows the state of some actuators: jog them first, see `faults` in `hyperbit watch`")
    return [int(bit) for bit in state["commanded"]]


def there_and_back(state: int) -> tuple[str, str]:
    """Returns the states to which an actuator is switched."""
    return STATES[1 - state], STATES[state]


def move(client: Client, label: str, state: str) -> Way:
    """Switches one actuator and returns its way.

    Raises:
        Failed: the daemon refused, or the actuator is not where it was sent.
    """
    result = client.run({"actuators": {label: state}}, key="jog")
    if "status" not in result:
        raise Failed(f"{label} to {state}: refused (code {result['code']}): {result['message']}")
    if result["code"] != 0:
        raise Failed(f"{label} to {state}: {result['status']} (code {result['code']}): {result['message']}")
    measured = [t["seconds"] for t in result["travels"] if (t["actuator"], t["state"]) == (label, state)]
    return Way(label, state, measured[0] if measured else None)


def report(ways: list[Way], description: Mapping[str, Any], as_json: bool) -> None:
    """Prints the ways and the proposal for the arm's file."""
    lines = proposal(ways)
    if as_json:
        print_json({"proposal": "\n".join(lines)})
        return
    wired = {f"{board['module']}.{board['actuator']}": board for board in description["boards"]}
    table = results_table("actuator", *(rf"{field} \[ms]" for field in FIELDS.values()))
    for label in dict.fromkeys(way.actuator for way in ways):
        own = {way.state: way for way in ways if way.actuator == label}
        table.add_row(label, *(shown(own.get(state), wired.get(label, {}), state) for state in FIELDS))
    common.console.print(table)
    if lines:
        common.console.print(f"\nproposal for the arm's file, {RESERVE - 1:.0%} over the longest measured:\n")
        for line in lines:
            common.console.print(line, markup=False)


def shown(way: Way | None, wired: Mapping[str, Any], state: str) -> str:
    """Returns the travel time of a way, or why there is none."""
    if way is None:
        return ""
    if way.seconds is not None:
        return f"{1000 * way.seconds:.1f}"
    return f"no `{END_STOPS[state]}`" if wired.get(END_STOPS[state]) is None else "not measured"


def proposal(ways: Iterable[Way]) -> list[str]:
    """Returns YAML lines for the arm's file: a travel time of the arm, and those of actuators that are much faster."""
    longest: dict[str, float] = {}
    single: dict[str, dict[str, float]] = {}
    for label, state, seconds in ways:
        if seconds is not None:
            time = reserved(seconds)
            single.setdefault(label, {})[FIELDS[state]] = time
            longest[FIELDS[state]] = max(longest.get(FIELDS[state], 0.0), time)
    if not longest:
        return []
    both: Callable[[Mapping[str, float]], bool] = lambda times: times.keys() == set(FIELDS.values())  # noqa: E731
    lines = [f"travel_time: {written(longest if both(longest) else {'': max(longest.values())})}"]
    if both(longest):
        for label, times in single.items():
            if both(times) and all(DIFFERENT * times[field] < longest[field] for field in times):
                lines.append(f"# actuator {label}:  travel_time: {written(times)}")
    return lines


def reserved(seconds: float) -> float:
    """Returns a measured time with the reserve, in whole milliseconds [s]."""
    return math.ceil(round(1000 * RESERVE * seconds, 6)) / 1000


def written(times: Mapping[str, float]) -> str:
    """Returns times as YAML: a number, or one for each direction."""
    if "" in times:
        return f"{times['']:g}"
    return "{" + ", ".join(f"{field}: {times[field]:g}" for field in FIELDS.values()) + "}"

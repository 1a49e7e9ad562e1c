"""Commands that talk to a running daemon: send and watch."""

from __future__ import annotations

import contextlib
import queue
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
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
    parse_goal,
    print_json,
    refusal,
)
from controller.strict import InputFaults, read_yaml

if TYPE_CHECKING:
    import zenoh

    from controller.gateway.client import Client

START = "start it by: hyperbit run ARM.yaml (--simulate without hardware), or name its endpoint by --connect"
ONE_GOAL = "Where to go now, with an orientation if it matters; in space X,Y,Z[,QX,QY,QZ,QW]."


@contextlib.contextmanager
def connected(arm: str, connect: str, zenoh_file: Path | None) -> Iterator[Client]:
    """Opens a session with an arm's daemon.

    Raises:
        Failed: there is no daemon, or it does not answer while the context lasts.
    """
    import zenoh

    from controller.gateway import session
    from controller.gateway.client import Client, Unanswered

    name = arm_name(arm)
    zenoh.init_log_from_env_or("error")
    try:
        config = session.from_file(zenoh_file) if zenoh_file else session.configuration("client", connect=connect)
    except ValueError as error:
        raise InputFaults(Path("--zenoh"), [str(error)]) from None
    try:
        opened = zenoh.open(config)
    except zenoh.ZError as error:
        raise Failed(f"no daemon at {zenoh_file or connect}: {session.reason(error)}", START) from None
    with opened as live, contextlib.closing(Client(live, name, lambda: zenoh.open(config))) as client:
        try:
            yield client
        except Unanswered as error:
            raise Failed(str(error), others(live, name)) from None


def others(session: zenoh.Session, arm: str) -> str:
    """Returns what to do next where the daemon of an arm did not answer: the other arms that are there, if any."""
    tokens = session.liveliness().get("hyperbit/*/alive", timeout=1.0)
    names = sorted({str(token.ok.key_expr).split("/")[1] for token in tokens if token.ok is not None})
    if arm in names:
        return "allow this client its key, or wait and ask again"
    return f"name an arm that is there: {', '.join(names)}" if names else START


def read_payload(path: Path, what: str, field: str) -> dict[str, Any]:
    """Returns the payload in a YAML or JSON file; `what` it is, with which `field`, is told where it is none.

    Raises:
        InputFaults: it holds no mapping, or one that cannot be sent.
    """
    value = read_yaml(path)  # JSON is YAML, too
    if not isinstance(value, dict):
        raise InputFaults(path, [f"no {what}: a mapping with `{field}` is needed"])
    try:
        msgspec.json.encode(value)
    except (TypeError, UnicodeEncodeError) as error:
        raise InputFaults(path, [f"no {what}: {error}"]) from None
    return value


def send(
    arm: ArmName,
    file: Annotated[Path | None, typer.Argument(metavar="GOAL.yaml", help="A goal, YAML or JSON.")] = None,
    to: Annotated[str | None, typer.Option(metavar="X,Y[,TH]", help=ONE_GOAL)] = None,
    configuration: Annotated[str | None, typer.Option(help="Module states to go to, as `fk` takes them.")] = None,
    path_tolerance: Annotated[float | None, typer.Option(help="Follow the straight lines between waypoints.")] = None,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Send a goal and follow it to its result; Ctrl-C cancels the goal."""
    if [file, to, configuration].count(None) != 2:
        raise InputFaults(Path("send"), ["give one of a goal's file, --to and --configuration"])
    goal = {} if file is None else read_payload(file, "goal", "waypoints")
    if configuration is not None:
        goal["waypoints"] = [{"configuration": configuration}]
    if path_tolerance is not None:
        goal["path_tolerance"] = path_tolerance
    numbers = 0 if to is None else to.count(",") + 1
    if to is not None and numbers != 3:
        goal["waypoints"] = [waypoint(to, 2 if numbers < 3 else 3)]

    def tell(message: dict[str, Any]) -> None:
        if as_json:
            print_json(message)
        elif "waypoint" in message:
            error = "unknown" if message["error"] is None else missed(message)
            common.console.print(
                f"waypoint {message['waypoint'] + 1} of {message['waypoints']}: error {error},"
                f" {message['switches']} switches so far"
            )
        elif message["accepted"]:
            common.console.print(message["message"])

    goal.setdefault("id", uuid.uuid4().hex[:12])
    with connected(arm, connect, zenoh_file) as client:
        if to is not None and numbers == 3:  # X,Y,Z or X,Y,TH, as the arm is
            goal["waypoints"] = [waypoint(to, client.request("arm")["dimension"])]
        try:
            result = client.run(goal, tell)
        except KeyboardInterrupt:
            cancel_goal(client, goal["id"], as_json)
            raise typer.Exit(130) from None
    if as_json and "status" in result:
        print_json(result)
    if result["code"] != 0:
        raise refusal(result, arm)
    if not as_json:
        position = ", ".join(f"{x:.4f}" for x in result["position"])
        common.console.print(f"reached ({position}), error {missed(result)}, {result['switches']} switches")


def cancel_goal(client: Client, goal: str, as_json: bool) -> None:
    """Cancels a goal whose command was interrupted, and prints the daemon's answer.

    Raises:
        Unanswered: the daemon did not answer; `connected` makes this a Failed.
    """
    common.errors.print(f"interrupted: canceling goal {goal}", markup=False)
    answer = client.request("cancel")
    if as_json:
        print_json(answer)
    else:
        common.console.print(f"goal {goal}: {answer['message']}", markup=False)


def missed(message: dict[str, Any]) -> str:
    """Returns the errors in a message, of the position and, if one was asked for, of the orientation."""
    angle = message["orientation_error"]
    return f"{message['error']:.4f}" + ("" if angle is None else f" and {angle:.4f} rad")


def waypoint(to: str, dimension: int) -> dict[str, Any]:
    """Returns the waypoint in "X,Y[,TH]" or "X,Y,Z[,QX,QY,QZ,QW]"."""
    position, orientation = parse_goal(to, dimension, "--to")
    return {"position": position} if orientation is None else {"position": position, "orientation": orientation}


def watch(
    arm: ArmName,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
    as_json: AsJson = False,
) -> None:
    """Show a running arm until interrupted; with --json, print a line for each state."""
    from rich.live import Live

    from controller.commands.view import View

    news: queue.SimpleQueue[tuple[str, dict[str, Any]]] = queue.SimpleQueue()
    with connected(arm, connect, zenoh_file) as client, contextlib.suppress(KeyboardInterrupt):
        _subscribers = [
            client.subscribe("state", lambda message: news.put(("state", message))),
            client.subscribe("diagnostics", lambda message: news.put(("diagnostics", message))),
        ]
        view = View(arm_name(arm))
        with contextlib.ExitStack() as stack:
            live = None if as_json else stack.enter_context(Live(view, console=common.console, auto_refresh=False))
            while True:
                try:
                    key, message = news.get(timeout=2.0)
                except queue.Empty:
                    if not client.alive():
                        raise Failed(f"arm {arm_name(arm)!r}: its daemon is not there, or is gone", START) from None
                    continue
                if live is None:
                    if key == "state":
                        print_json(message)
                    continue
                view.take(key, message)
                if news.empty():
                    live.update(view, refresh=True)

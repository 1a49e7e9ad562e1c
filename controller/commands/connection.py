"""Sessions with running daemons, and requests to them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import typer

from controller.armfile.strict import InputFaults, read_yaml
from controller.commands.common import CommandFailed, arm_name, print_json, refusal

if TYPE_CHECKING:
    import zenoh

    from controller.network.client import Client

START = "start it by: hyperbit run ARM.yaml (--simulate without hardware), or name its endpoint by --connect"


@contextlib.contextmanager
def connected(arm: str, connect: str, zenoh_file: Path | None) -> Iterator[Client]:
    """Opens a Zenoh session with an arm's daemon.

    Args:
        arm: file or name of the arm.
        connect: Zenoh endpoint of the daemon.
        zenoh_file: Zenoh configuration, instead of the endpoint.

    Raises:
        CommandFailed: no daemon is there, or the daemon does not answer a request inside the context.
        InputFaults: the arm's file or the Zenoh configuration is wrong.
    """
    import zenoh

    from controller.network import session
    from controller.network.client import Client, Unanswered

    name = arm_name(arm)
    zenoh.init_log_from_env_or("error")
    try:
        config = session.from_file(zenoh_file) if zenoh_file else session.configuration("client", connect=connect)
    except ValueError as error:
        raise InputFaults(Path("--zenoh"), [str(error)]) from None
    try:
        opened = zenoh.open(config)
    except zenoh.ZError as error:
        raise CommandFailed(f"no daemon at {zenoh_file or connect}: {session.reason(error)}", START) from None
    with opened as live, contextlib.closing(Client(live, name, lambda: zenoh.open(config))) as client:
        try:
            yield client
        except Unanswered as error:
            raise CommandFailed(str(error), after_silence(live, name)) from None


def after_silence(session: zenoh.Session, arm: str) -> str:
    """Returns the next step after a daemon did not answer; it names the arms that have a daemon."""
    tokens = session.liveliness().get("hyperbit/*/alive", timeout=1.0)
    names = sorted({str(token.ok.key_expr).split("/")[1] for token in tokens if token.ok is not None})
    if arm in names:
        return "allow this client its key, or wait and ask again"
    return f"name an arm that is there: {', '.join(names)}" if names else START


def ask(client: Client, arm: str, key: str, payload: dict[str, Any], as_json: bool) -> None:
    """Sends a request and prints the daemon's answer.

    Raises:
        CommandFailed: the daemon refused.
        Unanswered: the daemon did not answer; `connected` makes this a CommandFailed.
    """
    answer = client.request(key, payload)
    if as_json:
        print_json(answer)
    if not answer["accepted"]:
        raise refusal(answer, arm)
    if not as_json:
        typer.echo(answer["message"])


def read_payload(path: Path, what: str, field: str) -> dict[str, Any]:
    """Reads a payload from a YAML or JSON file.

    Args:
        path: of the file.
        what: kind of the payload, for messages.
        field: its main field, for messages.

    Raises:
        InputFaults: the file holds no mapping, or the mapping cannot be written as JSON.
    """
    value = read_yaml(path)  # JSON is a subset of YAML
    if not isinstance(value, dict):
        raise InputFaults(path, [f"no {what}: a mapping with `{field}` is needed"])
    try:
        msgspec.json.encode(value)
    except (TypeError, UnicodeEncodeError) as error:
        raise InputFaults(path, [f"no {what}: {error}"]) from None
    return value

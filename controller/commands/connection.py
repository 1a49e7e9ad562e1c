"""Zenoh sessions of the commands, and requests to running daemons."""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import CONNECT, ENDPOINT
from hyperbit.controller.commands.common import CommandFailed, arm_name, print_json, refusal
from hyperbit.controller.network.endpoints import START

if TYPE_CHECKING:
    import zenoh

    from hyperbit.controller.network.client import Client

# Zenoh logs to the standard output. A sample that is on its way while a subscriber is undeclared is an error to it.
LOG = "error,zenoh::api::session=off"


def zenoh_config(
    file: Path | None, *, mode: str = "client", listen: str | None = None, connect: str | None = None
) -> zenoh.Config:
    """Returns the configuration in a Zenoh file, or one with these endpoints if there is no file."""
    from hyperbit.controller.network import session

    try:
        return session.from_file(file) if file else session.configuration(mode, listen=listen, connect=connect)
    except ValueError as error:
        named_by_variable = connect is not None and connect == os.environ.get(CONNECT)
        where = CONNECT if named_by_variable else "endpoint"
        raise InputFaults(Path("--zenoh" if file else where), [str(error)]) from None


def open_session(connect: str, zenoh_file: Path | None) -> zenoh.Session:
    """Opens a session with a running daemon, or its router, as a client."""
    return open_zenoh(zenoh_config(zenoh_file, connect=connect))


def open_zenoh(config: zenoh.Config) -> zenoh.Session:
    """Opens a session; tells on stderr which of its certificates end soon."""
    import zenoh

    from hyperbit.controller.network import reach

    zenoh.init_log_from_env_or(LOG)
    for told in reach.ending(reach.certificates_of(config)):
        sys.stderr.write(f"Warning: {told}\n")
    try:
        return reach.open_session(config)
    except reach.NoSession as error:
        raise CommandFailed(str(error), error.step) from None


def named(arm: str, connect: str, zenoh_file: Path | None) -> str:
    """Returns how a further command line names an arm and the way to its daemon."""
    words = [arm]
    if zenoh_file is not None:
        words += ["--zenoh", str(zenoh_file)]
    elif connect != (os.environ.get(CONNECT) or ENDPOINT):
        words += ["--connect", connect]
    return shlex.join(words)


@contextlib.contextmanager
def connected(arm: str, connect: str, zenoh_file: Path | None, *, find: bool = True) -> Iterator[Client]:
    """Opens a Zenoh session with the daemon of an arm, given by its file or name.

    A request inside the context that is not answered ends the command. `find`: fail at once if other arms have a
    daemon, and this arm has none.
    """
    import zenoh

    from hyperbit.controller.network.client import Client, Unanswered

    name = arm_name(arm)
    with (
        open_session(connect, zenoh_file) as session,
        contextlib.closing(
            Client(session, name, lambda: zenoh.open(zenoh_config(zenoh_file, connect=connect)))
        ) as client,
    ):
        if find and (names := arms_alive(session)) and name not in names:
            raise CommandFailed(f"no daemon for arm {name!r} at {zenoh_file or connect}", step_after(name, names))
        try:
            yield client
        except Unanswered as error:
            raise CommandFailed(str(error), step_after(name, arms_alive(session))) from None


def arms_alive(session: zenoh.Session) -> list[str]:
    """Returns the names of the arms of this namespace that have a daemon, sorted; none if this client may not ask."""
    from hyperbit.controller.network.fleet import OWN, alive

    return [address.name for address in alive(session, [OWN])]


def step_after(arm: str, names: list[str]) -> str:
    """Returns the next step after a daemon did not answer, given the arms that have a daemon."""
    if arm in names:
        return "allow this client its key, or wait and ask again"
    return f"name an arm that is there: {', '.join(names)}" if names else START


def ask(client: Client, arm: str, key: str, payload: dict[str, Any], as_json: bool) -> None:
    """Sends a request and prints the daemon's answer. `arm`: see `named`."""
    answer = client.request(key, payload)
    if as_json:
        print_json(answer)
    if not answer["accepted"]:
        raise refusal(answer, arm)
    if not as_json:
        typer.echo(answer["message"])

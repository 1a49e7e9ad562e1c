"""The command `panel`: serves the operator's web page."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import CONNECT, ENDPOINT
from hyperbit.controller.commands.arguments import ZenohFile
from hyperbit.controller.commands.common import CommandFailed

LISTEN = "127.0.0.1:7480"
PEOPLE = "File of people who may view or command. Default: new tokens for one operator and one viewer at each start."
WAY_OUT = "give another port: hyperbit panel --listen 127.0.0.1:7481, or hyperbit run ARM.yaml --panel 7481"
PUBLIC = "Address of the page at a reverse proxy, such as https://robot.local/hyperbit/. Default: there is no proxy."
CLIENTS = "Authority of client certificates; people whose certificate is named in --people need no token."


def panel(
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Address of the page.")] = LISTEN,
    connect: Annotated[list[str], typer.Option(envvar=CONNECT, help="Zenoh endpoint of a daemon; repeatable.")] = [],  # noqa: B006  # typer needs a list
    zenoh_file: ZenohFile = None,
    people: Annotated[Path | None, typer.Option(metavar="PEOPLE.yaml", help=PEOPLE)] = None,
    new_token: Annotated[
        str | None, typer.Option(metavar="NAME", help="Only print a new token and its entry for PEOPLE.yaml.")
    ] = None,
    certificate: Annotated[Path | None, typer.Option(help="Certificate for TLS.")] = None,
    key: Annotated[Path | None, typer.Option(help="Private key of the certificate.")] = None,
    client_ca: Annotated[Path | None, typer.Option(help=CLIENTS)] = None,
    public: Annotated[str | None, typer.Option(metavar="URL", help=PUBLIC)] = None,
    prefix: Annotated[
        str, typer.Option(help="Prefix of all Zenoh keys; `replay` shows a recording that `hyperbit replay` serves.")
    ] = "hyperbit",
) -> None:
    """Serve the operator's web page, which shows and commands all connected arms, until SIGTERM."""
    if new_token is not None:
        print_token(new_token)
        return
    if (certificate is None) != (key is None) or (client_ca is not None and certificate is None):
        raise InputFaults(Path("panel"), ["--certificate and --key go together; --client-ca needs both"])
    from hyperbit.controller.host.journal import start_logging

    try:
        from hyperbit.controller.panel.log_limit import LogLimit
        from hyperbit.controller.panel.serve import Tls, parse_address, parse_public_address, serve, zenoh_configuration
    except ImportError as error:
        raise CommandFailed(str(error), "install the page's libraries: pip install 'hyperbit[panel]'") from None
    start_logging({})
    logging.getLogger().handlers[0].addFilter(LogLimit())
    tls = None if certificate is None or key is None else Tls(certificate, key, client_ca)
    try:
        config = zenoh_configuration(connect or [ENDPOINT], zenoh_file)
    except ValueError as error:
        raise InputFaults(Path("--connect" if zenoh_file is None else "--zenoh"), [str(error)]) from None
    try:
        at_proxy = None if public is None else parse_public_address(public)
        serve(parse_address(listen), tls, people, config, prefix, at_proxy)
    except OSError as error:
        raise CommandFailed(f"the page cannot be served at {listen}: {error.strerror or error}", WAY_OUT) from None


def print_token(name: str) -> None:
    """Prints a new token for a person, and the entry for the file of people, which holds only the token's digest."""
    from hyperbit.controller.panel.access.people import digest_of
    from hyperbit.controller.panel.access.people import new_token as make

    token = make()
    sys.stdout.write(
        f"token of {name}: {token}\nentry: - {{name: {name}, role: operator, token: {digest_of(token)}}}\n"
    )

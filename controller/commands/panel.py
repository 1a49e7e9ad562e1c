"""The command that serves the operator's page: panel."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated

import typer

from controller.commands.common import ENDPOINT, Failed, ZenohFile
from controller.strict import InputFaults

LISTEN = "127.0.0.1:7480"
PEOPLE = "Who may look and command; without, an operator and a viewer get a token at each start."
CLIENTS = "Authority of client certificates; whose certificate is named in --people needs no token."


def panel(
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where the page is served.")] = LISTEN,
    connect: Annotated[list[str], typer.Option(help="Zenoh endpoint of a daemon; may be given several times.")] = [],  # noqa: B006  # typer needs a list
    zenoh_file: ZenohFile = None,
    people: Annotated[Path | None, typer.Option(metavar="PEOPLE.yaml", help=PEOPLE)] = None,
    new_token: Annotated[
        str | None, typer.Option(metavar="NAME", help="Print a token and its entry; serve not.")
    ] = None,
    certificate: Annotated[Path | None, typer.Option(help="Certificate for TLS.")] = None,
    key: Annotated[Path | None, typer.Option(help="Its key.")] = None,
    client_ca: Annotated[Path | None, typer.Option(help=CLIENTS)] = None,
    prefix: Annotated[
        str, typer.Option(help="Of all Zenoh keys; `replay` for what `hyperbit replay` serves.")
    ] = "hyperbit",
) -> None:
    """Serve the operator's web page, which shows and commands all connected arms, until SIGTERM."""
    if new_token is not None:
        print_token(new_token)
        return
    if (certificate is None) != (key is None) or (client_ca is not None and certificate is None):
        raise InputFaults(Path("panel"), ["--certificate and --key go together; --client-ca needs both"])
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    try:
        from controller.panel.serve import Tls, parse_address, serve, zenoh_configuration
    except ImportError as error:
        raise Failed(f"{error}: install the page's libraries with: pip install 'hyperbit[panel]'") from None
    tls = None if certificate is None or key is None else Tls(certificate, key, client_ca)
    try:
        config = zenoh_configuration(connect or [ENDPOINT], zenoh_file)
    except ValueError as error:
        raise InputFaults(Path("--zenoh"), [str(error)]) from None
    try:
        serve(parse_address(listen), tls, people, config, prefix)
    except OSError as error:
        raise Failed(f"the page is not served at {listen}: {error}") from None


def print_token(name: str) -> None:
    """Prints a new token for somebody, and the entry for the file of people, which does not tell the token."""
    from controller.panel.access import digest_of
    from controller.panel.access import new_token as make

    token = make()
    sys.stdout.write(
        f"token of {name}: {token}\nentry: - {{name: {name}, role: operator, token: {digest_of(token)}}}\n"
    )

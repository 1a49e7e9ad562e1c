"""The command `router`: runs a Zenoh router, where no zenohd is installed."""

from __future__ import annotations

import json
import logging
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import ZenohFile
from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.commands.connection import ENDPOINT
from hyperbit.controller.commands.operate.endpoints import port_taken

if TYPE_CHECKING:
    import zenoh

CONNECT = "Zenoh router to join as well, as of a plant; it is tried again until it is there."
PERIOD = 2.0  # [s] between two messages to systemd's watchdog
log = logging.getLogger(__name__)


def router(
    listen: Annotated[str, typer.Option(help="Zenoh endpoint to accept connections at.")] = ENDPOINT,
    connect: Annotated[str | None, typer.Option(help=CONNECT, show_default=False)] = None,
    zenoh_file: ZenohFile = None,
) -> None:
    """Run a Zenoh router until SIGTERM: it connects arms, pages and commands of several computers."""
    import zenoh

    from hyperbit.controller.host.journal import start_logging
    from hyperbit.controller.host.notify import Notifier
    from hyperbit.controller.host.signals import end_on_signals
    from hyperbit.controller.network.session import reason

    config = router_config(listen, connect, zenoh_file)
    start_logging({})
    zenoh.init_log_from_env_or("error")
    ending, notifier = threading.Event(), Notifier()
    end_on_signals(ending.set)
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        taken = None if zenoh_file else port_taken(listen)
        raise CommandFailed(taken or f"no router at {zenoh_file or listen}: {reason(error)}") from None
    with session:
        notifier.notify("READY=1")
        log.info("routing at %s", ", ".join(json.loads(config.get_json("listen/endpoints"))))
        while not ending.wait(PERIOD):
            notifier.notify("WATCHDOG=1")
        notifier.notify("STOPPING=1")


def router_config(listen: str, connect: str | None, file: Path | None) -> zenoh.Config:
    """Returns the configuration of a router.

    Raises:
        InputFaults: the file is wrong, or not that of a router.
    """
    from hyperbit.controller.network import session

    if file is None:
        return session.configuration("router", listen=listen, connect=connect)
    if connect is not None:
        raise InputFaults(Path("router"), ["give either --connect or --zenoh, whose file can name the other router"])
    try:
        config = session.from_file(file)
    except ValueError as error:
        raise InputFaults(Path("--zenoh"), [str(error)]) from None
    if json.loads(config.get_json("mode")) != "router":
        raise InputFaults(file, ['mode: "router" is needed'])
    return config

"""The command `router`: runs a Zenoh router, where no zenohd is installed."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import Listen, ZenohFile
from hyperbit.controller.commands.connection import open_zenoh, zenoh_config
from hyperbit.controller.commands.process import Process

if TYPE_CHECKING:
    import zenoh

CONNECT = "Zenoh router to join as well, as of a plant; it is tried again until it is there."
PERIOD = 2.0  # [s] between two messages to systemd's watchdog
log = logging.getLogger(__name__)


def router(
    listen: Listen = ENDPOINT,
    connect: Annotated[str | None, typer.Option(help=CONNECT, show_default=False)] = None,
    zenoh_file: ZenohFile = None,
) -> None:
    """Run a Zenoh router until SIGTERM: it connects arms, pages and commands of several computers."""
    config = router_config(listen, connect, zenoh_file)
    process = Process()
    with open_zenoh(config):
        process.notifier.notify("READY=1")
        log.info("routing at %s", ", ".join(json.loads(config.get_json("listen/endpoints"))))
        while not process.wait(PERIOD):
            pass
        process.notifier.notify("STOPPING=1")


def router_config(listen: str, connect: str | None, file: Path | None) -> zenoh.Config:
    if file is not None and connect is not None:
        raise InputFaults(Path("router"), ["give either --connect or --zenoh, whose file can name the other router"])
    config = zenoh_config(file, mode="router", listen=listen, connect=connect)
    if json.loads(config.get_json("mode")) != "router":
        raise InputFaults(file or Path("router"), ['mode: "router" is needed'])
    return config

"""Refuses to talk to boards while an executor runs: two masters on a bus would spoil each other's SDO transfers."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterable, Iterator
from pathlib import Path

from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.host.sockets import found_sockets, socket_path
from hyperbit.controller.program import VERSION, Hello, encode
from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.tools.session import MasterHeard, Session
from hyperbit.drivers.canopen.wire.bus import CanBus
from hyperbit.drivers.canopen.wiring import MASTER, BusWiring

ANSWER_WITHIN = 1.0  # [s]


@contextlib.contextmanager
def session_without_executor(
    buses: Iterable[BusWiring], arm: str | None = None, path: Path | None = None, heartbeat: float = 0.0
) -> Iterator[Session]:
    """Opens a session with boards, unless the executor of the arm answers, or a master sends its heartbeat on a bus.

    Args:
        buses: the buses that the command is going to use.
        arm: name of the arm; None: the command knows none, and only listens to the buses.
        path: socket of the arm's executor, or its folder; None: the default.
        heartbeat: period of the master's heartbeat [s]; 0: not known.
    """
    for own in [] if arm is None else executor_places(arm, path):
        if answers(own, arm or ""):
            raise running(f"the executor of {arm} is running (it answers at {own})")
    try:
        with Session([CanBus(bus) for bus in buses], heartbeat) as session:
            yield session
    except MasterHeard as error:
        raise running(f"an executor is running (its heartbeat, node {MASTER}, is on {error})") from None
    except BusError as error:
        raise CommandFailed(str(error)) from None


def executor_places(arm: str, path: Path | None) -> list[Path]:
    """Returns where the socket of an arm's executor may be; `path`: it, or its folder; None: the default."""
    return list(dict.fromkeys([socket_path(path, arm), *(one for one in found_sockets() if one.stem == arm)]))


def running(who: str) -> CommandFailed:
    """Returns the error for an executor that runs; `who` names it."""
    return CommandFailed(f"{who}: stop it first, this command and an executor must not use a bus at the same time")


def answers(path: Path, arm: str) -> bool:
    """Returns whether the executor of an arm answers at a socket."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
            connection.settimeout(ANSWER_WITHIN)
            connection.connect(str(path))
            connection.send(encode(Hello(VERSION, "operator", arm)))
            return bool(connection.recv(1))
    except TimeoutError:
        return True  # the executor has accepted the connection, but is slow
    except OSError:
        return False

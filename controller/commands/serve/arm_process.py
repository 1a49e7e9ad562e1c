"""A process beside the daemon of one arm, as `record` and `ros2`: its end, systemd, and its session with the daemon."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.connection import LOG

if TYPE_CHECKING:
    import zenoh

RETRY = 1.0  # [s] between attempts to reach the daemon


class ArmProcess:
    """A process that serves one arm beside its daemon: its end by a signal, and its notifications to systemd.

    Attributes:
        arm: name of the arm.
        ending: set when the process is to end.
        notifier: sends notifications.

    Args:
        arm: name of the arm, which the process's log names.
    """

    def __init__(self, arm: str) -> None:
        from hyperbit.controller.host.journal import start_logging
        from hyperbit.controller.host.notify import Notifier
        from hyperbit.controller.host.signals import end_on_signals

        start_logging({"HYPERBIT_ARM": arm})
        self.arm, self.ending, self.notifier = arm, threading.Event(), Notifier()
        end_on_signals(self.ending.set)

    def feed_watchdog(self) -> None:
        """Tells systemd that the process runs."""
        self.notifier.notify("WATCHDOG=1")


@contextlib.contextmanager
def opened_session(connect: str, zenoh_file: Path | None, process: ArmProcess) -> Iterator[zenoh.Session | None]:
    """Opens a session with a daemon as soon as one is there.

    Args:
        connect: Zenoh endpoint of the daemon.
        zenoh_file: Zenoh configuration, instead of the endpoint.
        process: whose end ends the wait.

    Yields:
        The session, or None if the process is to end before a daemon was there.

    Raises:
        InputFaults: the Zenoh configuration is wrong.
    """
    import zenoh

    from hyperbit.controller.network import session

    zenoh.init_log_from_env_or(LOG)
    warned = False
    while True:
        try:
            config = session.from_file(zenoh_file) if zenoh_file else session.configuration("client", connect=connect)
        except ValueError as error:
            raise InputFaults(Path("--zenoh"), [str(error)]) from None
        try:
            live = zenoh.open(config)
            break
        except zenoh.ZError as error:
            if not warned:
                warned = True
                where, why = zenoh_file or connect, session.reason(error)
                logging.getLogger(__name__).warning("no daemon at %s yet, waiting for one: %s", where, why)
        process.feed_watchdog()
        if process.ending.wait(RETRY):
            yield None
            return
    with live:
        yield live

"""A command that runs until a signal: its end, its log, systemd's watchdog, and its wait for others."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from hyperbit.controller.commands.connection import LOG, zenoh_config

if TYPE_CHECKING:
    import zenoh

    from hyperbit.controller.host.signals import Ending

RETRY = 1.0  # [s] between two attempts to reach others
log = logging.getLogger(__name__)
T = TypeVar("T")


def ending_event() -> Ending:
    """Returns what each signal that ends the process sets."""
    from hyperbit.controller.host.signals import Ending, end_on_signals

    ending = Ending()
    end_on_signals(ending.set)
    return ending


class Process:
    """A process beside the daemons, which may be a service: `record`, `ros2` and `router`.

    Attributes:
        ending: set when the process is to end.
        notifier: sends notifications to systemd.

    Args:
        arm: name of the arm, which the process's log names; "": no arm's.
    """

    def __init__(self, arm: str = "") -> None:
        from hyperbit.controller.host.journal import start_logging
        from hyperbit.controller.host.notify import Notifier
        from hyperbit.controller.host.output import relay_zenoh_log

        start_logging({"HYPERBIT_ARM": arm} if arm else {})
        relay_zenoh_log()
        self.arm, self.ending, self.notifier = arm, ending_event(), Notifier()

    def feed_watchdog(self) -> None:
        from hyperbit.controller.host.output import flush_outputs

        self.notifier.notify("WATCHDOG=1")
        flush_outputs()

    def wait(self, seconds: float = RETRY) -> bool:
        """Waits; returns whether the process is to end."""
        self.feed_watchdog()
        return self.ending.wait(seconds)

    def retried(self, attempt: Callable[[], T], missing: type[Exception], words: str) -> T | None:
        """Repeats an attempt while it raises `missing`; `words`: what it waits for, for the log. None: the end came."""
        told = ""
        while not self.ending.is_set():
            try:
                return attempt()
            except missing as error:
                if str(error) != told:
                    told = str(error)
                    log.warning("%s: %s", words, told)
            self.wait()
        return None


@contextlib.contextmanager
def opened_session(connect: str, zenoh_file: Path | None, process: Process) -> Iterator[zenoh.Session | None]:
    """Opens a session with a daemon as soon as one is there; yields None if the process is to end before."""
    import zenoh

    from hyperbit.controller.network.reach import NoSession, open_session

    config = zenoh_config(zenoh_file, connect=connect)
    zenoh.init_log_from_env_or(LOG)
    session = process.retried(lambda: open_session(config), NoSession, "waiting for a daemon")
    if session is None:
        yield None
        return
    with session:
        yield session

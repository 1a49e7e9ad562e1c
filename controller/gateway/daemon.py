"""The planner's process: builds its parts from the Zenoh session to the server, and closes them in order."""

import contextlib
import gc
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import zenoh

from controller.config import Arm
from controller.flight_recorder import FlightRecorder, Label
from controller.gateway.arrivals import RepeatedGoals
from controller.gateway.one_daemon import Claim
from controller.gateway.outbox import Outbox, ResultHooks
from controller.gateway.server import Server
from controller.gateway.session import lease, reachable
from controller.gateway.warnings import Warnings
from controller.notify import Notifier
from controller.planning.core.core import OPAQUE
from controller.planning.core.events import Recorded
from controller.planning.inbox import Inbox
from controller.planning.ledger import Ledger
from controller.planning.link import ExecutorLink
from controller.planning.planner import Outside, planning
from controller.planning.published import PublishedResults, published_path
from controller.workspace.densities import Densities

log = logging.getLogger(__name__)

# Number of Zenoh's receiving threads. A flood on one key blocks the thread of each connection that it uses. With
# Zenoh's default of two, all would soon be blocked, and a `stop` from another client would wait.
RECEIVERS = "(rx: (worker_threads: 16))"


RECORDS = 500  # steps of the core that are recorded in one piece at most; the loop writes them when it is calm


class Daemon:
    """A daemon that serves an arm.

    Attributes:
        failure: why the process must end, so that the service manager starts it again; None while all is well.
    """

    def __init__(self) -> None:
        self.failure: str | None = None

    def fail(self, message: str) -> None:
        """Notes that the process must end. For any thread."""
        log.critical("the daemon must end: %s", message)
        self.failure = self.failure or message


@contextlib.contextmanager
def running(
    arm: Arm,
    densities: Densities,
    config: zenoh.Config,
    ledger: Path,
    socket: Path | Callable[[], Path],
    digest: str,
) -> Iterator[Daemon]:
    """Serves an arm while the context lasts.

    At the end the server closes its keys first, so that no more requests come. Then goals end, and their results and
    the last state are published. The connection to the executor closes last.

    Args:
        arm: with wiring.
        densities: of the arm reduced by locked actuators.
        config: of the Zenoh session.
        ledger: path of the ledger.
        socket: path of the executor's socket, or a function that returns it for each attempt to connect.
        digest: SHA-256 of the arm's file, in hexadecimal.

    Raises:
        zenoh.ZError: the session cannot be opened.
        AlreadyRunning: another daemon of this arm is in the network.
        LedgerInUse: another process writes the ledger.
    """
    name, daemon, inbox = arm.settings.name, Daemon(), Inbox()
    with ExitStack() as closing:
        os.environ.setdefault("ZENOH_RUNTIME", RECEIVERS)
        session = closing.enter_context(zenoh.open(config))
        claim = Claim(session, name)
        closing.callback(claim.close)
        book = Ledger(ledger, arm.manipulator.actuators, lambda entry: inbox.post(Recorded(entry)), daemon.fail)
        closing.callback(book.close)
        published = PublishedResults(published_path(name, socket() if callable(socket) else socket))
        goals, notifier = RepeatedGoals(), Notifier()
        hooks = ResultHooks(goals.ended, published.add, inbox.post)
        outbox = Outbox(session, f"hyperbit/{name}", hooks, daemon.fail, lease(config))
        closing.callback(outbox.close)
        warnings = Warnings(reachable(session, config), book.faults)
        outside = Outside(inbox, book, published, outbox, notifier, warnings.active, daemon.fail)
        label = Label("planner", name, digest, arm.path.read_text() if arm.path is not None else "")
        constant = {"manipulator": arm.manipulator}
        recorder = closing.enter_context(FlightRecorder(label, ledger.absolute().parent, OPAQUE, constant, RECORDS))
        link = ExecutorLink(socket, name, digest)
        planner = closing.enter_context(planning(arm, densities, link, outside, recorder))
        claim.confirm()
        server = Server(session, name, planner, outbox, goals, tracker=arm.settings.tracker is not None)
        closing.callback(planner.end_goals)
        closing.callback(server.close)
        planner.start()  # not before the keys are declared: who receives a state may send a request
        gc.collect()
        gc.freeze()  # the collector need not scan long-lived objects while a goal waits
        closing.callback(gc.unfreeze)
        notifier.send("READY=1")
        closing.callback(notifier.send, "STOPPING=1")
        log.info("serving the arm %s", name)
        yield daemon

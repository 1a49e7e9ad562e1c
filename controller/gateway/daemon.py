"""The planner's process: builds session, ledger, link, planning and server, and closes them in order."""

import contextlib
import gc
import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import zenoh

from controller.config import Arm
from controller.gateway.one_daemon import Claim
from controller.gateway.outbox import Outbox
from controller.gateway.repeated_goals import RepeatedGoals
from controller.gateway.server import Server
from controller.gateway.session import lease, reachable
from controller.gateway.status_reporter import StatusReporter
from controller.gateway.warnings import Warnings
from controller.journal import fields_of_result
from controller.notify import Notifier
from controller.planning.ledger import Ledger
from controller.planning.link import ExecutorLink
from controller.planning.messages import Payload
from controller.planning.planning import Planning
from controller.workspace.densities import Densities

log = logging.getLogger(__name__)

# Number of Zenoh's receiving threads. A flood on one key blocks the thread of each connection that it uses. With
# Zenoh's default of two, all would soon be blocked, and a `stop` from another client would wait.
RECEIVERS = "(rx: (worker_threads: 16))"


@contextlib.contextmanager
def running(
    arm: Arm,
    densities: Densities,
    config: zenoh.Config,
    ledger: Path,
    socket: Path | Callable[[], Path],
    digest: str,
) -> Iterator[Planning]:
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
    name = arm.settings.name
    with ExitStack() as closing:
        os.environ.setdefault("ZENOH_RUNTIME", RECEIVERS)
        session = closing.enter_context(zenoh.open(config))
        claim = Claim(session, name)
        closing.callback(claim.close)
        book = Ledger(ledger, arm.manipulator.actuators)
        closing.callback(book.close)
        outbox = Outbox(session, f"hyperbit/{name}", lease(config))
        closing.callback(outbox.close)
        goals, changed, notifier = RepeatedGoals(), threading.Event(), Notifier()

        def publish(key: str, payload: Payload) -> None:
            if key != "feedback":
                goals.ended(payload.get("id"))
            outbox.publish(key, payload)
            if key != "feedback":  # after the publication, because writing the log may block
                fields, message = fields_of_result(payload), payload.get("message")
                log.info("goal %s %s: %s", payload.get("id"), payload.get("status"), message, extra={"journal": fields})

        link = ExecutorLink(socket, name, digest, 2.0 * arm.settings.planner_timeout)
        planning = Planning(arm, densities, link, book, publish, changed.set)
        warnings = Warnings(reachable(session, config), book.faults)
        claim.confirm()
        planning.start()
        closing.callback(planning.close)
        reporter = StatusReporter(
            session,
            f"hyperbit/{name}",
            planning.state,
            planning.diagnostics,
            changed,
            warnings.active,
            outbox.waiting,
            notifier,
        )
        closing.callback(reporter.close)  # its end is no fault while the executor is connected
        closing.callback(planning.end_goals)
        server = Server(session, name, planning, outbox, goals, tracker=arm.settings.tracker is not None)
        closing.callback(server.close)
        gc.collect()
        gc.freeze()  # the collector need not scan long-lived objects while a goal waits
        closing.callback(gc.unfreeze)
        notifier.send("READY=1")
        closing.callback(notifier.send, "STOPPING=1")
        log.info("serving the arm %s", name)
        yield planning

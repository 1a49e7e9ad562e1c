"""The planner's process: builds its parts from the Zenoh session to the server, and closes them in order.

It claims its arm first: two daemons of one arm would both run each goal. Its own warnings concern the system's clock,
the Zenoh network and the ledger; none of them stops the arm.
"""

import contextlib
import gc
import logging
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
import zenoh

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.warnings import file_warnings
from hyperbit.controller.flight_recorder import FlightRecorder, Label
from hyperbit.controller.gateway.arrivals import RepeatedGoals
from hyperbit.controller.gateway.claim import Claim
from hyperbit.controller.gateway.outbox import Outbox
from hyperbit.controller.gateway.poses import Poses
from hyperbit.controller.gateway.server import GatewayParts, Server
from hyperbit.controller.host.files import read_file
from hyperbit.controller.host.journal import fields_of_fault
from hyperbit.controller.host.notify import Notifier
from hyperbit.controller.manipulator.notation import format_configuration
from hyperbit.controller.network.reach import certificates_of, ending, open_session
from hyperbit.controller.network.session import lease, reachable
from hyperbit.controller.planning.core.core import OPAQUE
from hyperbit.controller.planning.core.events import Recorded
from hyperbit.controller.planning.ledger import Ledger, PublishedResults, published_path
from hyperbit.controller.planning.ledger_file import find
from hyperbit.controller.planning.link import ExecutorLink, Inbox
from hyperbit.controller.planning.loop import Services
from hyperbit.controller.planning.planner import planning
from hyperbit.controller.program import Fault
from hyperbit.controller.workspace.densities import Densities

log = logging.getLogger(__name__)

# Number of Zenoh's receiving threads. A flood on one key blocks the thread of each connection that it uses. With
# Zenoh's default of two, all would soon be blocked, and a `stop` from another client would wait.
RECEIVERS = "(rx: (worker_threads: 16))"

RECORDS = 500  # most steps of the core in one recorded block; the loop writes a block when it is calm
CLOCK_STEP = 0.5  # [s]; a greater jump of the clock was set, not slewed
CERTIFICATES_EVERY = 3600.0  # [s]
REMEMBERED = 10.0  # [s] for which a warning stays after its cause


class Daemon:
    def __init__(self) -> None:
        self.failure: str | None = None  # why the process must end, so that the service manager starts it again

    def fail(self, message: str) -> None:  # for any thread
        log.critical("the daemon must end: %s", message)
        self.failure = self.failure or message


@contextlib.contextmanager
def running(
    arm: Arm, densities: Densities, digest: str, config: zenoh.Config, ledger: Path, executor: Path, *, simulated: bool
) -> Iterator[Daemon]:
    """Serves an arm, which has its wiring, while the context lasts.

    `densities` are of the arm reduced by locked actuators, `digest` is the SHA-256 of the arm's file, `executor` is
    the socket of the executor, which simulates the boards if `simulated`. At the end the server closes its keys first,
    so that no more requests come. Then goals end, and their results and the last state are published. The connection to
    the executor closes last.

    Raises:
        NoSession: the session cannot be opened.
        AlreadyRunning: another daemon of this arm is in the network.
        FileInUse: another process writes the ledger.
    """
    name, daemon, inbox = arm.settings.name, Daemon(), Inbox()
    with ExitStack() as closing:
        os.environ.setdefault("ZENOH_RUNTIME", RECEIVERS)
        session = closing.enter_context(open_session(config))
        claim = Claim(session, name, simulated=simulated)
        closing.callback(claim.close)
        book = Ledger(ledger, arm.manipulator.actuators, lambda entry: inbox.post(Recorded(entry)), daemon.fail)
        closing.callback(book.close)
        published = PublishedResults(published_path(name, executor))
        goals, notifier = RepeatedGoals(), Notifier()
        hooks = goals.ended, published.add, inbox.post, daemon.fail
        outbox = Outbox(session, f"hyperbit/{name}", *hooks, lease(config))
        outbox.start()
        closing.callback(outbox.close)
        certificates = partial(ending, certificates_of(config))
        warnings = Warnings(reachable(session, config), book.faults, certificates=certificates)
        services = Services(inbox, book, published, outbox, notifier, warnings.active, daemon.fail)
        label = Label("planner", name, digest, read_file(arm.path).decode() if arm.path is not None else "")
        constant = {"manipulator": arm.manipulator}
        recorder = closing.enter_context(FlightRecorder(label, ledger.absolute().parent, OPAQUE, constant, RECORDS))
        link = ExecutorLink(executor, name, digest, simulated=simulated)
        planner = closing.enter_context(planning(arm, densities, link, services, recorder, simulated=simulated))
        claim.confirm()
        first = format_configuration(arm.manipulator, np.zeros(len(arm.manipulator.modules), np.int64))
        poses = Poses(ledger.with_name(f"{ledger.stem}.poses.json"), first)
        server = Server(session, name, GatewayParts(planner, outbox, goals, poses, partial(find, ledger)))
        closing.callback(server.close)
        planner.loop.start()  # after the keys are declared: a receiver of a state may send a request
        gc.collect()
        gc.freeze()  # the collector need not scan long-lived objects while a goal waits
        closing.callback(gc.unfreeze)
        notifier.notify("READY=1")
        closing.callback(notifier.notify, "STOPPING=1")
        for warning in file_warnings(arm):
            log.warning("%s", warning)
        log.info("serving the arm %s%s", name, ", whose boards are simulated" if simulated else "")
        yield daemon


class Warnings:
    """Detects the causes of warnings. Belongs to one thread.

    `reachable` returns whether the session is connected to an endpoint of its configuration, `others` the active
    warnings of other parts, such as the ledger, `certificates` which certificates end soon.
    `wall` is the system's clock, `clock` is never set.
    """

    def __init__(
        self,
        reachable: Callable[[], bool] = lambda: True,
        others: Callable[[], tuple[Fault, ...]] = tuple,
        wall: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
        certificates: Callable[[], list[str]] = list,
    ) -> None:
        self._reachable, self._others, self._wall, self._clock = reachable, others, wall, clock
        self._certificates, self._certificates_at = certificates, -math.inf
        self._ending = list[str]()
        self._offset = wall() - clock()
        self._lost_at = 0.0
        self._own: dict[str, tuple[Fault, float]] = {}  # by code; each with its end [s]

    def active(self) -> tuple[Fault, ...]:
        now = self._clock()
        self._own = {code: own for code, own in self._own.items() if now < own[1]}
        offset = self._wall() - now
        if abs(by := offset - self._offset) > CLOCK_STEP:
            self._own.pop("clock-set", None)  # each setting is logged
            message = f"the system's clock was set by {by:+.1f} s: stamps follow it, motions do not"
            self._warn(Fault("clock-set", "system", message), now)
        self._offset = offset
        if not self._reachable():
            if "network-lost" not in self._own:
                self._lost_at = now
            message = f"no peer was connected over Zenoh for {now - self._lost_at:.1f} s: the arm continued by itself"
            self._warn(Fault("network-lost", "zenoh", message), now)
        if now >= self._certificates_at + CERTIFICATES_EVERY:
            self._certificates_at, self._ending = now, self._certificates()
        if self._ending:
            self._warn(Fault("certificate-ends", "zenoh", "; ".join(self._ending)), now)
        return (*(fault for _, (fault, _) in sorted(self._own.items())), *self._others())

    def _warn(self, fault: Fault, now: float) -> None:
        if fault.code not in self._own:
            fields = fields_of_fault(fault.code, fault.source)
            log.warning("%s: %s", fault.code, fault.message, extra={"journal": fields})
        self._own[fault.code] = fault, now + REMEMBERED

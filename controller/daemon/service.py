"""The whole daemon: boards, loop, planner, ledger and Zenoh put together, and taken apart in order."""

import itertools
import logging
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import zenoh
from numpy.typing import NDArray

from controller.config import Arm
from controller.daemon.arrivals import Arrivals
from controller.daemon.avoidance import Avoidance, keeping
from controller.daemon.degradation import Degradation
from controller.daemon.events import Quit
from controller.daemon.follower import Follower
from controller.daemon.garbage import Garbage
from controller.daemon.ledger import Ledger, counted
from controller.daemon.loop import ControlLoop
from controller.daemon.notify import Notifier
from controller.daemon.outbox import Outbox
from controller.daemon.planner import Planner
from controller.daemon.realtime import RealTime
from controller.daemon.server import Server
from controller.daemon.session import reachable
from controller.daemon.telemetry import Publisher
from controller.daemon.tip import KEY, TipWatch
from controller.manipulator.held import Held, hold
from controller.search.solver import Solver
from controller.workspace.densities import Densities
from controller.workspace.mapping import map_densities
from drivers.boards import Boards
from drivers.simulation.simulation import Simulation
from drivers.wiring import BusSettings, Channel, Timing, Wiring

log = logging.getLogger(__name__)

EMBEDDED = itertools.count()


def wiring_of(arm: Arm) -> Wiring:
    """Returns the drivers' view of an arm's buses and actuators."""
    return Wiring(
        buses=tuple(BusSettings(b.name, b.interface, b.channel, b.bitrate) for b in arm.settings.buses),
        channels=tuple(
            Channel(label, a.bus, a.node, a.output, a.input)
            for label, a in zip(arm.manipulator.actuators, arm.wiring, strict=True)
        ),
        on_loss=arm.settings.boards.on_loss,
        shared_rpdo=arm.settings.boards.shared_rpdo,
    )


def timing_of(arm: Arm) -> Timing:
    """Returns the drivers' view of an arm's times."""
    boards = arm.settings.boards
    return Timing(
        heartbeat=boards.heartbeat,
        heartbeat_timeout=boards.heartbeat_timeout,
        boot_timeout=boards.boot_timeout,
        travel_time=arm.settings.travel_time,
    )


def patient(timing: Timing) -> Timing:
    """Returns times for boards that share this computer's processors with the daemon, and may be kept waiting there."""
    return replace(timing, heartbeat_timeout=timing.heartbeat_timeout + 1.0, settle_margin=0.5)


def embedded(wiring: Wiring) -> Wiring:
    """Returns the wiring on virtual buses of this process, named so that no other arm of it is met."""
    number = next(EMBEDDED)
    buses = (replace(bus, interface="virtual", channel=f"{bus.channel}-{number}") for bus in wiring.buses)
    return replace(wiring, buses=tuple(buses))


@contextmanager
def simulated(wiring: Wiring, timing: Timing) -> Iterator[Simulation]:
    """Runs simulated boards for a wiring while the context lasts."""
    simulation = Simulation(wiring, timing)
    simulation.start()
    try:
        yield simulation
    finally:
        simulation.stop()


class Daemon:
    """A running daemon.

    Args:
        arm: with wiring.
        densities: of `arm.left`.
        wiring: the arm's, or an embedded one.
        config: of the Zenoh session.
        ledger: path of the ledger.
        timing: the arm's if absent.

    Raises:
        BusError: a bus cannot be opened.
        zenoh.ZError: the session cannot be opened.
    """

    def __init__(
        self,
        arm: Arm,
        densities: Densities,
        wiring: Wiring,
        config: zenoh.Config,
        ledger: Path,
        timing: Timing | None = None,
    ) -> None:
        self._garbage, self._real_time = Garbage(), RealTime(arm.settings.real_time)
        weights = arm.weights(counted(ledger))
        solver, follower_solver = (Solver(arm.left, densities, weights) for _ in range(2))
        solver.prepare()
        boards = Boards(wiring, timing or timing_of(arm))
        with ExitStack() as closing:  # from the last to the first: no more requests, all told, then the boards
            boards.connect()
            closing.callback(boards.close)
            session = closing.enter_context(zenoh.open(config))
            prefix = f"hyperbit/{arm.settings.name}"
            book = Ledger(ledger, arm.manipulator.actuators)
            closing.callback(book.close)
            outbox = Outbox(session, prefix)
            closing.callback(outbox.close)
            telemetry = Publisher(
                session,
                prefix,
                arm.manipulator,
                outbox.waiting,
                lambda: planner.waiting(),
                lambda: follower.status(),
                lambda: self._real_time.status,
                lambda: tip.told() if tip else {},
                lambda: {"tracker": tip.status()} if tip else {},
            )
            closing.callback(telemetry.close)
            ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(1)  # the latest wins
            setpoints = closing.enter_context(session.declare_subscriber(f"{prefix}/setpoint", ring))
            arrivals = Arrivals(setpoints.try_recv)
            travel, avoidance = arm.settings.travel_time, Avoidance(keeping(arm))
            self.loop = ControlLoop(
                arm.manipulator,
                boards,
                travel,
                outbox.publish,
                telemetry,
                book,
                Notifier(),
                arrivals.request,
                inrush=arm.settings.inrush,
                rest=arm.settings.rest_time,
                collect=self._garbage.collect,
                reachable=reachable(session, config),
                degradation=Degradation(
                    arm.manipulator,
                    arm.held,
                    arm.settings.on_stuck == "continue",
                    lambda held: self._adapt(arm, held, weights, planner, follower),
                ),
                avoidance=avoidance,
            )
            closing.callback(self.loop.inbox.close)
            tip = TipWatch(arm.manipulator, arm.settings.tracker, self.loop) if arm.settings.tracker else None
            bias = tip.bias if tip else lambda: None
            follower = Follower(arm, follower_solver, self.loop, bias=bias, avoidance=avoidance)
            planner = Planner(arm, solver, self.loop, bias, avoidance)
            closing.callback(planner.close)
            server = Server(session, arm, self.loop, planner, outbox, arrivals)
            closing.callback(server.close)
            follower.listen(arrivals)
            closing.callback(follower.close)
            if tip:
                ring = zenoh.handlers.RingChannel(1)
                tips = closing.enter_context(session.declare_subscriber(f"{prefix}/{KEY}", ring))
                tip.listen(tips.try_recv)
                closing.callback(tip.close)
            self._closing = closing.pop_all()

    def run(self) -> None:
        """Runs the control loop in this thread until `quit`; then closes all, the boards last."""
        with self._closing, self._garbage, self._real_time:
            self.loop.run()

    def _adapt(self, arm: Arm, held: Held, weights: NDArray[np.float64], planner: Planner, follower: Follower) -> None:
        """Has planner and follower go by other actuators held."""
        left = hold(arm.manipulator, held)
        densities = map_densities(left, arm.pixel, arm.level_pixels)
        solver = Solver(left, densities, weights)
        solver.prepare()
        follower.use(Solver(left, densities, weights))
        planner.use(solver)

    def quit(self) -> None:
        """Asks the loop to end; from any thread or signal handler."""
        self.loop.inbox.put(Quit())


@contextmanager
def running(daemon: Daemon) -> Iterator[Daemon]:
    """Runs a daemon in a thread of its own while the context lasts."""
    thread = threading.Thread(target=daemon.run, name="control", daemon=True)
    thread.start()
    try:
        yield daemon
    finally:
        daemon.quit()
        thread.join(10.0)


def run_until_signal(daemon: Daemon) -> None:
    """Runs a daemon in the main thread until SIGTERM or SIGINT."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: daemon.quit())
    daemon.run()

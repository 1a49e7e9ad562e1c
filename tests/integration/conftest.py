"""The whole chain: a real daemon and a real client on Zenoh, simulated boards on a bus of python-can."""

import itertools
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import can
import pytest
import zenoh

from controller.config import Arm
from controller.daemon import follower, loop, planner, session, telling
from controller.daemon.client import Client
from controller.daemon.service import Daemon, running, simulated, timing_of, wiring_of
from controller.motion.tracking import Tracking
from controller.workspace.densities import Densities
from drivers.simulation import simulation
from drivers.simulation.simulation import Simulation
from drivers.wiring import BusSettings, Timing, Wiring
from tests import emulated, vcan
from tests.daemon.waiting import SLOWNESS
from tests.integration.harness import Observer
from tests.integration.motions import Motions

CHANNELS = itertools.count()

# Where the machine is slow, so are the control loop and the boards, who would have no time left for their work.
if SLOWNESS > 1:
    loop.PERIOD = follower.PERIOD = planner.PERIOD = 0.01 * SLOWNESS
    telling.STATE_EVERY = 0.05 * SLOWNESS
    simulation._LONGEST_WAIT = 0.01 * SLOWNESS
    session.LEASE = SLOWNESS
    usual = Tracking()
    slow = {name: SLOWNESS * getattr(usual, name) for name in ("timeout", "validity", "slack")}
    follower.Tracking = partial(Tracking, **slow)
    follower.POLL, follower.IDLE_POLL = 0.005 * SLOWNESS, 0.02 * SLOWNESS


@pytest.fixture
def bus(request: pytest.FixtureRequest) -> Iterator[BusSettings]:
    """The bus that daemon and boards share: python-can's virtual one, and one of the kernel where it has vcan.

    The faults of interfaces are made on an emulated one, and on that of the kernel.
    """
    if request.param == "emulated":
        yield BusSettings("can0", "emulated", request.getfixturevalue("emulation").channel)
        return
    if request.param == "virtual":
        yield BusSettings("can0", "virtual", f"test-{os.getpid()}-{next(CHANNELS)}")
        return
    if reason := vcan.missing():
        (pytest.fail if request.config.getoption("bus") else pytest.skip)(reason)
    with vcan.made() as interface:
        yield BusSettings("can0", "socketcan", interface.name)


@pytest.fixture
def emulation() -> Iterator[emulated.Interface]:
    """An interface that is emulated, for faults that the kernel's vcan does not have."""
    with tempfile.TemporaryDirectory(prefix="can") as folder:  # of a short name, for the socket in it
        interface = emulated.Interface(Path(folder))
        yield interface
        interface.close()


@pytest.fixture
def interface(request: pytest.FixtureRequest, bus: BusSettings) -> emulated.Interface | vcan.Interface:
    """The interface of that bus, to be taken down or away and brought back; the first thing to ask for."""
    if bus.interface == "emulated":
        return request.getfixturevalue("emulation")
    if bus.interface != "socketcan":
        pytest.skip("only a bus of the kernel, or an emulated one, has an interface")
    return vcan.Interface(bus.channel)


@pytest.fixture
def queue(interface: emulated.Interface | vcan.Interface) -> emulated.Interface | vcan.Interface:
    """The interface, where its frames can be made to wait."""
    if isinstance(interface, vcan.Interface) and (reason := vcan.queueless()):
        pytest.skip(reason)
    return interface


@pytest.fixture
def wiring(arm: Arm, bus: BusSettings) -> Wiring:
    return replace(wiring_of(arm), buses=(bus,))


def bearing(arm: Arm) -> Timing:
    """The arm's times, but that a board or the daemon may wait for its turn on a loaded machine; faults still show."""
    timing = timing_of(arm)
    return replace(timing, heartbeat_timeout=timing.heartbeat_timeout + 0.25 * SLOWNESS, settle_margin=0.3 * SLOWNESS)


def enduring(timing: Timing) -> Timing:
    """Times for what is not about the boards' own, however loaded the machine is."""
    return replace(timing, heartbeat_timeout=timing.heartbeat_timeout + SLOWNESS, settle_margin=0.5 * SLOWNESS)


@pytest.fixture
def timing(arm: Arm) -> Timing:
    return bearing(arm)


@pytest.fixture
def boards(wiring: Wiring, timing: Timing) -> Iterator[Simulation]:
    """The simulated boards, running."""
    with simulated(wiring, timing) as boards:
        for port in boards._ports.values():
            assert port._bus
            vcan.give_way(port._bus, vcan.FIRST)  # in the queues of an interface, which theirs would not be in
        yield boards


@pytest.fixture
def listener(bus: BusSettings) -> Iterator[can.BusABC]:
    """Hears all that is on the bus from now on."""
    with can.Bus(interface=bus.interface, channel=bus.channel, bitrate=bus.bitrate, ignore_config=True) as listening:
        vcan.make_room(listening)
        yield listening


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


class Bench:
    """Starts daemons, and sessions that talk to them; all are ended with the test."""

    def __init__(self, stack: ExitStack, arm: Arm, densities: Densities, wiring: Wiring, endpoint: str, ledger: Path):
        self.stack, self.arm, self.endpoint, self.ledger = stack, arm, endpoint, ledger
        self.mode = "peer"  # of the daemons' sessions; a client connects to the endpoint in place of listening there
        self._densities, self._wiring = densities, wiring

    def daemon(self, timing: Timing | None = None) -> Daemon:
        """Builds a daemon that does not run yet."""
        there = {"connect" if self.mode == "client" else "listen": self.endpoint}
        config = session.configuration(self.mode, **there)
        return Daemon(self.arm, self._densities, self._wiring, config, self.ledger, timing or bearing(self.arm))

    def run(self, timing: Timing | None = None) -> Daemon:
        """Runs a daemon until the test's end."""
        return self.stack.enter_context(running(self.daemon(timing)))

    def session(self) -> zenoh.Session:
        return self.stack.enter_context(zenoh.open(session.configuration("client", connect=self.endpoint)))

    def observer(self) -> Observer:
        """A client that hears everything."""
        return Observer(Client(self.session(), self.arm.settings.name))


@pytest.fixture
def bench(arm: Arm, densities: Densities, wiring: Wiring, endpoint: str, tmp_path: Path) -> Iterator[Bench]:
    with ExitStack() as stack:
        yield Bench(stack, arm, densities, wiring, endpoint, tmp_path / "ledger.sqlite")


@pytest.fixture
def daemon(bench: Bench, boards: Simulation) -> Daemon:
    """A daemon that runs on simulated boards."""
    return bench.run()


@pytest.fixture
def client(bench: Bench, daemon: Daemon) -> Observer:
    """A client of a daemon that is ready."""
    observer = bench.observer()
    observer.wait_for("ready")
    return observer


@pytest.fixture
def motions(wiring: Wiring, listener: can.BusABC, boards: Simulation, client: Observer) -> Iterator[Motions]:
    """Sees at the end that nothing moved but for accepted goals, and that each of those had one result."""
    motions = Motions(wiring, listener)
    yield motions
    motions.check(client, boards)

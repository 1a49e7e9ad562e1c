"""One running arm: simulated boards on a bus, an executor's process, a planner, and their clients."""

import hashlib
import itertools
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import zenoh

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.executor.arm.arm import read_arm
from hyperbit.controller.gateway import daemon
from hyperbit.controller.gateway.daemon import Daemon
from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client
from hyperbit.controller.planning.ledger_file import read
from hyperbit.controller.workspace.cache import load_or_map
from hyperbit.drivers.canopen.wiring import BusWiring, Wiring
from hyperbit.drivers.simulation.simulation import Simulation
from tests import emulated, vcan
from tests.endpoints import free_endpoint
from tests.shared import shared_folder
from tests.system.stack import arms
from tests.system.stack.motions import Listener
from tests.system.stack.observer import Observer
from tests.system.stack.processes import Nursery, Process, nursery, tail
from tests.waiting import PATIENCE, eventually

NUMBERS = itertools.count()
LEASE = "transport/link/tx/lease"  # path in a Zenoh configuration


class System:
    """Starts and ends the parts of one arm. They run until `close`.

    Attributes:
        kind: of bus, "emulated" or "socketcan".
        interface: the bus, which tests take down and bring back.
        wiring: of the boards, on the bus as this process opens it.
        boards: the simulated boards, in threads of this process.
        planner: its process, if it has one of its own.
        daemon: of the planner, if it is in this process.
        clock: file with the seconds by which the system's clock is ahead in a planner's process; None: there is none.
        config: of the planner's Zenoh session; by default it listens at the endpoint.
        clients: returns the configuration of clients' sessions.

    Args:
        kind: of bus.
        base: of `arms.KINDS`.
        planners: forks the planners; by default the one of all tests.
    """

    def __init__(self, kind: str, base: str, fields: dict[str, Any], planners: Nursery | None = None) -> None:
        self.kind, self._planners = kind, planners
        self.folder = Path(tempfile.mkdtemp(prefix="hb"))  # with a short name, because of the sockets in it
        self._closing = ExitStack()
        self._closing.callback(shutil.rmtree, self.folder, ignore_errors=True)
        self.interface = self._make_interface()
        channel = self.interface.channel if isinstance(self.interface, emulated.Interface) else self.interface.name
        named = {"interface": "virtual" if kind == "emulated" else kind, "channel": channel}
        self.name = str(fields.get("name", f"{base}-{os.getpid()}-{next(NUMBERS)}"))
        self.file = arms.write(self.folder, base, self.name, named, fields)
        self.arm: Arm = load(self.file)
        executed = read_arm(self.file)
        self.bus = BusWiring("can0", kind, channel, executed.wiring.buses[0].bitrate)
        self.wiring: Wiring = replace(executed.wiring, buses=(self.bus,))
        self.timing = executed.timing
        self.socket, self.ledger = self.folder / "executor.sock", self.folder / "ledger.sqlite"
        self.endpoint = free_endpoint()
        self.config: zenoh.Config | None = None
        self.clients = lambda: session.configuration("client", connect=self.endpoint)
        self.executor: Process | None = None
        self.planner: Process | None = None
        self.daemon: Daemon | None = None
        self.clock: Path | None = None
        self._planner_end = ExitStack()
        self.boards = self._start_boards()

    def start(self) -> "System":
        """Starts executor and planner, and waits until the arm is ready."""
        self.start_executor()
        self.start_planner()
        with self.client() as client:
            client.wait_for("ready")
        return self

    def close(self) -> None:
        """Ends everything, the planner first."""
        self.end_planner()
        if self.executor is not None:
            self.executor.kill()
        self._closing.close()

    def _make_interface(self) -> emulated.Interface | vcan.Interface:
        if self.kind == "socketcan":
            return self._closing.enter_context(vcan.made())
        folder = self.folder / "can"
        folder.mkdir()
        interface = emulated.Interface(folder)
        self._closing.callback(interface.close)
        return interface

    def _start_boards(self) -> Simulation:
        boards = Simulation(self.wiring, self.timing)
        for port in boards.ports.values():
            assert port.bus
            vcan.give_way(port.bus, vcan.FIRST)  # in the queues of an interface, which theirs would not be in
        boards.start()
        self._closing.callback(boards.stop)
        return boards

    def start_executor(self) -> Process:
        arguments = [str(self.file), "--socket", str(self.socket)]
        self.executor = nursery("executor").start(arguments, self.folder / "executor.log", self._environment)
        return self.executor

    def start_planner(self) -> Daemon:
        config = self.config or session.configuration("peer", listen=self.endpoint)
        self.daemon = self._planner_end.enter_context(self.serving(config, self.ledger))
        return self.daemon

    def serving(self, config: zenoh.Config, ledger: Path) -> AbstractContextManager[Daemon]:
        arm = self.arm
        densities = load_or_map(arm.reduced, arm.pixel, arm.level_pixels, shared_folder() / "cache" / "hyperbit")
        digest = hashlib.sha256(self.file.read_bytes()).hexdigest()
        return daemon.running(arm, densities, digest, config, ledger, self.socket, simulated=False)

    def start_planner_process(self, lease: float = PATIENCE) -> Process:
        """Starts a planner in a process of its own; it connects to the endpoint, where a session must listen.

        With a long lease [s], a stopped planner keeps its session.
        """
        file = self.folder / "zenoh.json5"
        config = session.configuration("client", connect=self.endpoint)
        config.insert_json5(LEASE, str(round(1e3 * lease)))
        file.write_text(str(config))
        arguments = [str(self.file), "--socket", str(self.socket), "--zenoh", str(file), "--ledger", str(self.ledger)]
        environment = self._environment | ({} if self.clock is None else {"CLOCK": str(self.clock)})
        planners = self._planners or nursery("planner")
        self.planner = planners.start(arguments, self.folder / "planner.log", environment)
        return self.planner

    def end_planner(self) -> None:
        self._planner_end.close()
        self._planner_end, self.daemon = ExitStack(), None
        if self.planner is not None and self.planner.alive:
            self.planner.thaw()
            self.planner.end(signal.SIGTERM)

    @property
    def _environment(self) -> dict[str, str]:
        return {
            "STATE_DIRECTORY": str(self.folder),
            "XDG_CACHE_HOME": str(shared_folder() / "cache"),
            "NOTIFY_SOCKET": "",
        }

    def session(self) -> zenoh.Session:
        """A client's session; the caller closes it."""
        return zenoh.open(self.clients())

    @contextmanager
    def client(self) -> Iterator[Observer]:
        """A client that has received a state."""

        def connect() -> zenoh.Session | None:
            try:
                return self.session()
            except zenoh.ZError:
                return None

        with eventually(connect, told=self.logs) as opened:
            observer = Observer(Client(opened, self.name))
            eventually(lambda: observer.heard["state"], told=self.logs)
            yield observer

    @contextmanager
    def listener(self) -> Iterator[Listener]:
        """Receives all frames on the bus from now on."""
        with can.Bus(interface=self.bus.interface, channel=self.bus.channel, ignore_config=True) as listening:
            vcan.make_room(listening)
            with closing(Listener(listening)) as listener:
                yield listener

    def drives(self) -> list[int]:
        with self.boards.lock:
            return self.boards.boards.drives()

    def counts(self) -> list[int]:
        switches = read(self.ledger)[0]
        return [switches.get(label, 0) for label in self.arm.manipulator.actuators]

    def logs(self) -> str:
        names = ("executor", "planner")
        return "\n".join(f"--- {name}\n{tail(self.folder / f'{name}.log')}" for name in names)


def settled(observer: Observer) -> bool:
    """Whether the arm is ready, with nothing left of an earlier test."""
    state = observer.next_state()
    clean = not state["faults"] and not state["degraded"] and state["goal"] is None
    return state["mode"] == "ready" and clean and observer.ask("obstacles", regions=[])["accepted"]

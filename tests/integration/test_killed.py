"""The daemon's process killed or halted at any instant: boards hold, counts are exact, and nothing stale moves."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
import zenoh

from controller.config import Arm
from controller.daemon import session
from controller.daemon.client import Client
from controller.daemon.ledger import read
from drivers import cia301
from drivers.simulation.simulation import Simulation
from drivers.wiring import BusSettings, Wiring
from tests import emulated
from tests.daemon.waiting import PATIENCE, SLOWNESS, eventually
from tests.integration.conftest import Bench
from tests.integration.harness import Observer, board_names
from tests.integration.motions import Motions
from tests.integration.test_faults import reset
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT

pytestmark = [pytest.mark.buses("emulated", "socketcan"), pytest.mark.timeout(600)]

KILLS = 20 if SLOWNESS == 1 else 5
ROOT = Path(__file__).parents[2]


class Process:
    """One daemon after another, each in a process of its own.

    Attributes:
        pid: of the one that runs.
        log: what all of them wrote to their journals.
    """

    def __init__(self, nursery: subprocess.Popen[str], bench: Bench, bus: BusSettings, log: Path) -> None:
        self._nursery, self._endpoint, self.log, self.pid = nursery, bench.endpoint, log, 0
        self._wanted = json.dumps([bus.interface, bus.channel, bench.endpoint, str(bench.ledger), str(log)])
        self._session: zenoh.Session | None = None

    def start(self) -> Observer:
        """Starts a daemon; returns a client of it."""
        assert self._nursery.stdin
        assert self._nursery.stdout
        self._nursery.stdin.write(self._wanted + "\n")
        self._nursery.stdin.flush()
        self.pid = int(self._nursery.stdout.readline())

        return eventually(self._connect)

    def _connect(self) -> Observer | None:
        """A client in place of the last one's, if there is somebody to be heard."""
        self.close()
        try:
            self._session = zenoh.open(session.configuration("client", connect=self._endpoint))
            observer = Observer(Client(self._session, "planar16"))
            eventually(lambda: observer.heard["state"], 5.0 * SLOWNESS)
        except (zenoh.ZError, AssertionError):
            return None
        return observer

    def close(self) -> None:
        """Ends the client."""
        if self._session is not None:
            self._session.close()
            self._session = None

    def end(self, number: signal.Signals) -> None:
        """Ends it by a signal, and waits until it is gone."""
        os.kill(self.pid, number)
        eventually(lambda: not os.path.exists(f"/proc/{self.pid}"))


@pytest.fixture(scope="module")
def nursery(arm_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "tests.integration.nursery", str(arm_file), str(tmp_path_factory.getbasetemp())]
    environment = {**os.environ, "NOTIFY_SOCKET": ""}
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment
    ) as nursery:
        assert nursery.stdout
        assert nursery.stdout.readline() == "ready\n"
        yield nursery
        nursery.kill()


@pytest.fixture
def process(nursery: subprocess.Popen[str], bench: Bench, bus: BusSettings, tmp_path: Path) -> Iterator[Process]:
    process = Process(nursery, bench, bus, tmp_path / "journal")
    yield process
    process.close()
    if os.path.exists(f"/proc/{process.pid}"):
        process.end(signal.SIGKILL)


def zigzag(client: Observer, goal: str) -> None:
    """Sends a goal of many waypoints, as fast as the arm may follow, that begins at once."""
    points = [(LEFT, RIGHT, MIDDLE)[k % 3] for k in range(30)]
    assert client.goal(*points, times=[0.08 * k for k in range(30)], id=goal)["accepted"]


def at_random(motions: Motions, process: Process, chance: random.Random) -> None:
    """Kills the daemon somewhere in a goal, which it has begun."""
    before = motions.switched.sum()

    def begun() -> bool:
        motions.read()
        return motions.switched.sum() > before

    eventually(begun)
    time.sleep(chance.uniform(0.0, 0.3))  # the one thing here that is no waiting for: the instant of the kill
    process.end(signal.SIGKILL)


def test_the_ledger_is_exact_after_many_kills_and_no_daemon_moves_by_itself(
    process: Process, boards: Simulation, listener: can.BusABC, wiring: Wiring, bench: Bench, bus: BusSettings,
    request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    motions, chance = Motions(wiring, listener), random.Random(1)
    if bus.interface == "emulated":
        at_the_sync = _killer(request.getfixturevalue("emulation"), process)
    for k in range(KILLS):
        before = boards.switches().tolist()
        client = process.start()
        state = client.wait_for("ready")
        assert boards.switches().tolist() == before, "nothing moved by itself"
        assert state["commanded"] == state["measured"] == boards.positions().astype(int).tolist()
        assert client.results("zigzag") == []
        zigzag(client, "zigzag")
        if bus.interface == "emulated" and k % 2:
            at_the_sync(chance.randrange(1, 5))
        else:
            at_random(motions, process, chance)
    client = process.start()
    client.wait_for("ready")
    process.end(signal.SIGTERM)
    motions.read()
    assert motions.switched.tolist() == boards.switches().tolist()
    assert motions.switched.sum() > 5 * KILLS
    counts, names = read(bench.ledger)[0], bench.arm.manipulator.actuators
    assert [counts.get(name, 0) for name in names] == motions.switched.tolist()


def _killer(emulation: emulated.Interface, process: Process) -> Callable[[int], None]:
    """Kills the daemon at its n-th SYNC from now, which reaches the boards: it dies before it can know."""

    def kill(count: int) -> None:
        left = [count]

        def on_sent(cob_id: int, data: bytes) -> None:
            left[0] -= cob_id == cia301.SYNC
            if left[0] == 0:
                os.kill(process.pid, signal.SIGKILL)

        emulation.on_sent = on_sent
        eventually(lambda: not os.path.exists(f"/proc/{process.pid}"))
        emulation.on_sent = lambda cob_id, data: None

    return kill


def test_a_halted_daemon_sends_nothing_stale_when_it_goes_on(
    process: Process, boards: Simulation, arm: Arm, listener: can.BusABC, wiring: Wiring
) -> None:
    motions = Motions(wiring, listener)
    client = process.start()
    client.wait_for("ready")
    client.move(MIDDLE)
    assert client.goal(RIGHT, LEFT, MIDDLE, times=[0.0, 0.3, 0.4], id="passed")["accepted"]
    begun = time.time()
    eventually(lambda: client.feedback("passed"))
    os.kill(process.pid, signal.SIGSTOP)
    eventually(lambda: all(state != 5 for state in _states(boards, arm)))  # the boards fail safe
    eventually(lambda: time.time() > begun + 0.5 * SLOWNESS)  # the last waypoint has passed, Zenoh's lease has not
    before, sent = boards.switches().tolist(), time.time()
    client.client._session.put("hyperbit/planar16/goal", b'{"id": "late", "waypoints": [{"position": [0.55, 2.9]}]}')
    os.kill(process.pid, signal.SIGCONT)
    state = client.wait_fault("halted", sent, within=1.0)
    assert (state["mode"], state["faults"][0]["code"]) == ("fault", "halted")
    result = client.result("passed")
    assert (result["status"], "halted" in result["message"]) == ("aborted", True)
    eventually(lambda: client.results("late") or client.results(None))
    assert {it["status"] for it in client.results("late") + client.results(None)} == {"refused"}
    assert "halted" in process.log.read_text()
    reset(client)
    assert boards.switches().tolist() == before
    client.move(LEFT, goal="after")
    motions.check(client, boards)


def _states(boards: Simulation, arm: Arm) -> list[int | None]:
    states = []
    for name in board_names(arm):
        with boards.board(name) as board:
            states.append(board.state)
    return states


def test_boards_of_a_killed_daemon_hold_in_the_middle_of_a_goal(
    process: Process, boards: Simulation, arm: Arm, listener: can.BusABC, wiring: Wiring
) -> None:
    motions = Motions(wiring, listener)
    client = process.start()
    client.wait_for("ready")
    assert client.goal(MIDDLE, RIGHT, LEFT, times=[0.0, 0.1, HOUR], id="a")["accepted"]
    eventually(lambda: client.feedback("a"))
    process.end(signal.SIGKILL)
    held = boards.switches().tolist()
    eventually(lambda: all(state != 5 for state in _states(boards, arm)), PATIENCE)
    motions.read()
    assert boards.switches().tolist() == held == motions.switched.tolist()

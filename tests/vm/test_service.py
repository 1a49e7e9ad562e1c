"""The installed service under systemd, simulated boards on the other side of a real bus, and a client outside of it.

In the order in which they stand, on one robot: what one test leaves, the next one finds.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import can
import pytest
import zenoh

from controller.config import Arm
from controller.daemon import session
from controller.daemon.client import Client, Message
from controller.daemon.ledger import read
from tests import vcan
from tests.daemon.waiting import SLOWNESS, eventually
from tests.integration.harness import Observer, board_names
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT, drain, syncs
from tests.integration.test_inrush import changes
from tests.vm.prepare import PROJECT

ARM = Path("/etc/hyperbit/arm.yaml")
CACHE, STATE = Path("/var/cache/private/hyperbit"), Path("/var/lib/private/hyperbit")
ENVIRONMENT = {**os.environ, "NUMBA_CACHE_DIR": str(CACHE / "numba")}  # where its kernels are compiled already
ASKING = {0x580, 0x600}  # SDO answers and requests (CiA 301, 7.3.5)

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(
        not Path("/etc/systemd/system/hyperbit-tests.service").exists(),
        reason="needs the installed service: only in the virtual machine of `make vm-test`",
    ),
]


@pytest.fixture(scope="module")
def can0(arm_file: Path) -> Iterator[vcan.Interface]:
    """The robot's bus; its arm's file has the times of a slow machine, and asks for real time.

    The robot is as it was installed, also where these tests ran before.
    """
    systemctl("stop", "hyperbit")
    shutil.rmtree(STATE, ignore_errors=True)
    shutil.copy(PROJECT / "deploy/zenoh.json5", "/etc/hyperbit/zenoh.json5")
    ARM.write_text(arm_file.read_text() + "real_time: {priority: 50}\n")
    interface = vcan.Interface("can0")
    interface.make()
    yield interface
    interface.delete()


@pytest.fixture(scope="module", autouse=True)
def boards(can0: vcan.Interface) -> Iterator[None]:
    """The simulated boards, a process of their own."""
    command, pipe = ["hyperbit", "simulate", str(ARM)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=ENVIRONMENT) as process:
        assert process.stdout is not None
        assert "simulating the boards" in process.stdout.readline()
        yield
        process.terminate()


@pytest.fixture
def frames(can0: vcan.Interface) -> Iterator[can.BusABC]:
    """Hears all that is on the bus."""
    with can.Bus(interface="socketcan", channel=can0.name, ignore_config=True) as listening:
        vcan.make_room(listening)
        yield listening


@pytest.fixture
def client() -> Iterator[Observer]:
    """A client outside the service."""
    with ExitStack() as stack:

        def connect() -> zenoh.Session | None:
            try:
                return zenoh.open(session.configuration("client", connect="tcp/127.0.0.1:7447"))
            except zenoh.ZError:
                return None

        yield Observer(Client(stack.enter_context(eventually(connect)), "planar16"))


def hyperbit(*words: str) -> str:
    """What the installed command prints; it must succeed."""
    done = subprocess.run(["hyperbit", *words], capture_output=True, text=True, env=ENVIRONMENT)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def systemctl(*words: str) -> str:
    done = subprocess.run(["systemctl", *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr + journal()
    return done.stdout


def journal() -> str:
    return subprocess.run(["journalctl", "-u", "hyperbit", "--no-pager"], capture_output=True, text=True).stdout


def shown(name: str) -> str:
    """A property of the service."""
    return systemctl("show", "hyperbit", "--value", "--property", name).strip()


def comes_up() -> None:
    """Waits until the service says how it is, which must be ready."""
    status = eventually(lambda: re.match("(ready|fault): .*", shown("StatusText")))
    assert status[1] == "ready", journal()


def test_the_unit_is_confined() -> None:
    report = subprocess.run(["systemd-analyze", "security", "hyperbit", "--no-pager"], capture_output=True, text=True)
    exposure = re.search(r"exposure level for hyperbit\.service: ([0-9.]+)", report.stdout)
    assert exposure, report.stdout + report.stderr
    assert float(exposure[1]) <= 2.0


def test_the_boards_are_asked_before_the_service_runs(arm: Arm, frames: can.BusABC) -> None:
    drain(frames)
    boards = json.loads(hyperbit("check", str(ARM), "--bus", "--json"))["boards"]
    answers = [board["answer"] for board in boards]
    assert answers == ["device type 00030191h, error register 00h"] * len(board_names(arm))
    assert {frame.arbitration_id & 0x780 for frame in drain(frames)} == ASKING


def test_it_starts_moves_nothing_and_is_ready(frames: can.BusABC) -> None:
    drain(frames)
    systemctl("start", "hyperbit")
    comes_up()
    assert shown("ActiveState") == "active"
    assert syncs(drain(frames)) == []


def test_a_goal_is_reached_by_the_frames_on_the_bus(frames: can.BusABC, client: Observer) -> None:
    drain(frames)
    result = client.move(MIDDLE, goal="first")
    counts = changes(drain(frames))
    assert sum(counts) == result["switches"] > 0
    state = client.wait_now("ready")
    assert state["measured"] == state["commanded"]
    assert sum(state["measured"]) == result["switches"], "all began contracted"
    assert "reached (" in hyperbit("send", str(ARM), "--to", "0.4,2.9")


def test_it_runs_confined_and_writes_its_cache_and_ledger() -> None:
    status = dict(re.findall(r"(\w+):\t(.*)", Path(f"/proc/{shown('MainPID')}/status").read_text()))
    uid = int(status["Uid"].split()[0])
    assert 61184 <= uid <= 65519, "a user of DynamicUser"
    assert (int(status["CapEff"], 16), status["NoNewPrivs"], status["Seccomp"]) == (0, "1", "2")
    (densities,) = CACHE.glob("densities/*.npz")
    (ledger,) = STATE.glob("**/*.sqlite")
    assert {densities.stat().st_uid, ledger.stat().st_uid} == {uid}
    switches, goals = read(ledger)
    assert sum(switches.values()) > 0
    assert [goal["status"] for goal in goals] == ["succeeded", "succeeded"]


def test_it_runs_in_real_time(client: Observer) -> None:
    pid = int(shown("MainPID"))
    assert os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
    assert os.sched_getparam(pid).sched_priority == 50
    locked = re.search(r"VmLck:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    assert locked
    assert int(locked[1]) > 10_000
    assert eventually(lambda: client.heard["diagnostics"])[-1]["real_time"] == "on"


@pytest.mark.parametrize("hours", [1, -1], ids=["forward", "back"])
def test_it_goes_on_when_the_clock_is_set(client: Observer, hours: int) -> None:
    goal = f"by {hours} h"
    assert client.goal(LEFT, RIGHT, times=[0.0, 1.0], id=goal)["accepted"]
    eventually(lambda: client.feedback(goal))
    told, sign = len(client.heard["state"]), "+" if hours > 0 else "-"
    time.clock_settime(time.CLOCK_REALTIME, time.time() + hours * HOUR)
    begun = time.time()

    def named() -> Message | None:
        states = client.heard["state"][told:]
        return next((s for s in states if any(f"was set by {sign}" in f["message"] for f in s["faults"])), None)

    state = eventually(named)
    assert state["mode"] == "executing"
    assert abs(state["stamp"] - begun) < 1.0 * SLOWNESS
    assert client.result(goal)["status"] == "succeeded"
    assert "clock-set" in journal()


def test_a_restart_moves_nothing(frames: can.BusABC, client: Observer) -> None:
    before = client.wait_now("ready")["measured"]
    client.goal(RIGHT, LEFT, times=[HOUR, 2 * HOUR], id="never")
    pid = shown("MainPID")
    drain(frames)
    systemctl("restart", "hyperbit")
    assert client.result("never")["message"] == "the daemon is shutting down; the arm holds"
    assert shown("MainPID") != pid
    comes_up()
    assert syncs(drain(frames)) == []
    assert client.wait_now("ready")["measured"] == before


def test_it_lives_on_when_the_interface_goes_down_and_up(
    can0: vcan.Interface, frames: can.BusABC, client: Observer
) -> None:
    before, pid = client.wait_now("ready")["measured"], shown("MainPID")
    drain(frames)
    can0.down()
    client.wait_now("fault", "can0")
    can0.up()
    told = len(client.heard["diagnostics"])
    eventually(lambda: any(it["buses"][0]["state"] == "active" for it in client.heard["diagnostics"][told:]))
    client.ask("reset")
    assert client.wait_now("ready")["measured"] == before
    with can.Bus(interface="socketcan", channel=can0.name, ignore_config=True) as listening:
        client.move(MIDDLE, goal="after the interface was down")
        assert syncs(drain(listening))
    assert shown("MainPID") == pid


def test_systemd_starts_it_again_after_sigkill(frames: can.BusABC, client: Observer) -> None:
    before, pid = client.wait_now("ready")["measured"], shown("MainPID")
    drain(frames)
    os.kill(int(pid), signal.SIGKILL)
    eventually(lambda: shown("NRestarts") == "1")
    eventually(lambda: shown("MainPID") not in ("0", pid))
    comes_up()
    assert syncs(drain(frames)) == []
    assert client.wait_now("ready")["measured"] == before


def test_it_lets_in_whom_its_authority_knows_as_far_as_they_may(frames: can.BusABC, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    for words in (["daemon", "localhost"], ["client", "operator", "viewer"]):
        subprocess.run([PROJECT / "deploy/certificates.sh", keys, *words], check=True)
    for part in ("ca", "certificate", "key"):
        to = f"/etc/credstore/hyperbit.{part}.pem"
        subprocess.run(["install", "-D", "-m", "600", keys / "daemon" / f"{part}.pem", to], check=True)
    shutil.copy(PROJECT / "deploy/zenoh-tls.json5", "/etc/hyperbit/zenoh.json5")
    systemctl("restart", "hyperbit")
    comes_up()
    drain(frames)
    goal = json.dumps({"waypoints": [{"position": RIGHT}]})
    with pytest.raises(zenoh.ZError):
        zenoh.open(session.configuration("client", connect="tcp/127.0.0.1:7447"))
    with zenoh.open(session.from_file(keys / "viewer/zenoh.json5")) as viewer:
        Observer(Client(viewer, "planar16")).wait_now("ready")
        assert [reply.ok for reply in viewer.get("hyperbit/planar16/goal", payload=goal) if reply.ok] == []
    assert syncs(drain(frames)) == []
    operator = str(keys / "operator/zenoh.json5")
    assert "reached (" in hyperbit("send", str(ARM), "--to", "3.0,0.7", "--zenoh", operator)
    assert syncs(drain(frames))


def test_it_stops_in_order(frames: can.BusABC) -> None:
    drain(frames)
    systemctl("stop", "hyperbit")
    assert [shown(name) for name in ("ActiveState", "Result", "ExecMainStatus")] == ["inactive", "success", "0"]
    assert syncs(drain(frames)) == []

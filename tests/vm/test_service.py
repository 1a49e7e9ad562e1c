"""The two installed services under systemd, simulated boards on the kernel's CAN, and a client outside of them.

The tests run in the order in which they stand, on one robot: a test begins in the state that the test before left.
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

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client, Message
from tests import vcan
from tests.system.stack import arms
from tests.system.stack.observer import Observer
from tests.vm import robot
from tests.vm.prepare import PROJECT
from tests.vm.robot import (
    ARM,
    EXECUTOR,
    PLANNER,
    disturbances,
    drain,
    eventually_shown,
    hyperbit,
    pid,
    shown,
    syncs,
    systemctl,
)
from tests.waiting import SLOWNESS, eventually

LEFT, MIDDLE, RIGHT = (0.4, 2.9), (0.55, 2.9), (3.0, 0.7)
HOUR = 3600.0
PATIENCE = 1.0 * SLOWNESS  # of the boards for a heartbeat of the master [s]
UPGRADED = {"actuator": "1.left", "switches": 1000}  # in the ledger that robot.sh left from the version of one service
NOBODY = ("setpriv", "--reuid=65534", "--regid=65534")

pytestmark = pytest.mark.skipif(
    not Path("/etc/systemd/system/tests-of-hyperbit.service").exists(),
    reason="needs the installed services: only in the virtual machine of `make vm-test`",
)


@pytest.fixture(scope="module")
def can0() -> Iterator[vcan.Interface]:
    """The robot's bus. The arm's file has the times of a slow machine."""
    times = {"heartbeat_timeout": 1.0, "settle_margin": 0.2}  # on a machine that is not slow
    bus = {"interface": "socketcan", "channel": "can0"}
    assert arms.write(ARM.parent, "planar", "planar16", bus, {"boards": times}) == ARM
    interface = vcan.Interface("can0")
    interface.make()
    yield interface
    interface.delete()


@pytest.fixture(scope="module", autouse=True)
def boards(can0: vcan.Interface) -> Iterator[None]:
    command, pipe = ["hyperbit", "simulate", str(ARM)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=robot.ENVIRONMENT) as process:
        assert process.stdout is not None
        assert "simulating the boards" in process.stdout.readline(), "it says why on the console"
        yield
        process.terminate()


@pytest.fixture
def frames(can0: vcan.Interface) -> Iterator[can.BusABC]:
    with can.Bus(interface="socketcan", channel=can0.name, ignore_config=True) as listening:
        vcan.make_room(listening)
        yield listening


@pytest.fixture
def client() -> Iterator[Observer]:
    with ExitStack() as stack:

        def connect() -> zenoh.Session | None:
            try:
                return zenoh.open(session.configuration("client", connect="tcp/127.0.0.1:7447"))
            except zenoh.ZError:
                return None

        yield Observer(Client(stack.enter_context(eventually(connect)), "planar16"))


def comes_up(service: str = PLANNER) -> None:
    """Waits until a service reports a mode, which must be ready."""
    found = eventually_shown(lambda: re.match("(ready|fault|stopped): .*", shown(service, "StatusText")))
    assert found[1] == "ready", robot.journal()


def state_of(service: str) -> list[str]:
    return [shown(service, name) for name in ("ActiveState", "Result", "ExecMainStatus")]


def test_each_bus_of_the_installed_arm_has_a_network_file_with_its_bit_rate() -> None:
    for channel, rate in (("can0", 500_000), ("can1", 250_000)):
        lines = Path(f"/etc/systemd/network/80-{channel}.network").read_text().splitlines()
        assert {f"Name={channel}", f"BitRate={rate}"} <= set(lines)


def test_units_are_confined() -> None:
    assert robot.exposure(EXECUTOR) <= 1.2
    assert robot.exposure(PLANNER) <= 1.6


def test_boards_are_asked_before_the_services_run(frames: can.BusABC) -> None:
    drain(frames)
    boards = json.loads(hyperbit("check", ARM, "--bus", "--json"))["boards"]
    nodes = {channel["node"] for channel in arms.planar()["actuators"]}
    assert len(boards) == len(nodes)
    good = "can be booted: device type 00030191h, error register 00h"
    assert all(board["answer"].startswith(good) for board in boards)
    assert {frame.arbitration_id & 0x780 for frame in drain(frames)} == {robot.SDO_ANSWER, robot.SDO_REQUEST}


def test_start_of_the_planner_starts_both_and_moves_nothing(frames: can.BusABC) -> None:
    drain(frames)
    systemctl("start", PLANNER)
    comes_up(EXECUTOR)
    comes_up()
    assert [shown(name, "ActiveState") for name in (PLANNER, EXECUTOR)] == ["active", "active"]
    assert syncs(drain(frames)) == []


def test_goal_is_reached_by_the_frames_on_the_bus(frames: can.BusABC, client: Observer) -> None:
    drain(frames)
    result = client.move(MIDDLE, goal="first")
    assert robot.switches(drain(frames)) == result["switches"] > 0
    state = client.wait_now("ready")
    assert state["measured"] == state["commanded"]
    assert sum(state["measured"]) == result["switches"], "all began contracted"
    assert "reached (" in hyperbit("send", ARM, "--to", "0.4,2.9")


def test_upgrade_keeps_counts_and_goals_of_the_version_of_one_service() -> None:
    switches, goals = eventually(lambda: found if len((found := robot.ledger())[1]) == 3 else None)
    assert switches[UPGRADED["actuator"]] >= UPGRADED["switches"]
    assert goals[-1]["id"] == "old"
    assert [goal["status"] for goal in goals] == ["succeeded"] * 3


def test_upgrade_makes_an_instance_of_services_that_had_none() -> None:
    assert systemctl("is-enabled", PLANNER).strip() == "enabled"
    for gone in ("hyperbit.service", "hyperbit-executor.service", "multi-user.target.wants/hyperbit.service"):
        assert not Path("/etc/systemd/system", gone).is_symlink()
        assert not Path("/etc/systemd/system", gone).exists()
    assert not Path("/var/lib/private/hyperbit").exists()
    assert (robot.STATE[EXECUTOR] / "other.switches").exists()
    assert not Path("/etc/hyperbit/zenoh.json5").exists()
    assert "/run/credentials/hyperbit@arm.service/" in Path("/etc/hyperbit/arm.json5").read_text()


def test_both_run_confined_as_users_of_their_own() -> None:
    users = set()
    group = subprocess.run(["getent", "group", "hyperbit"], capture_output=True, text=True).stdout.split(":")[2]
    for service in (PLANNER, EXECUTOR):
        process = robot.status(service)
        users.add(uid := int(process["Uid"].split()[0]))
        assert 61184 <= uid <= 65519, "a user of DynamicUser"
        assert process["Gid"].split()[0] == group
        assert (int(process["CapEff"], 16), process["NoNewPrivs"], process["Seccomp"]) == (0, "1", "2")
        owners = {path.stat().st_uid for path in (robot.STATE[service], *robot.STATE[service].iterdir())}
        assert owners == {uid}
    assert len(users) == 2


def test_executor_holds_neither_machine_code_of_its_own_nor_the_planners_libraries() -> None:
    maps = Path(f"/proc/{pid(EXECUTOR)}/maps").read_text()
    assert not re.search(r"^\S+ .wx", maps, re.MULTILINE)
    assert not re.search("llvmlite|numba|zenoh|scipy", maps)
    assert "zenoh" in Path(f"/proc/{pid(PLANNER)}/maps").read_text()


def test_executor_runs_in_real_time_and_the_planner_does_not(client: Observer) -> None:
    executor = pid(EXECUTOR)
    assert os.sched_getscheduler(executor) == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    assert os.sched_getparam(executor).sched_priority == 50
    assert int(robot.status(EXECUTOR)["VmLck"].split()[0]) > 10_000  # kB
    assert os.sched_getscheduler(pid(PLANNER)) == os.SCHED_OTHER
    assert eventually(lambda: client.heard["diagnostics"])[-1]["real_time"] == "on"


def test_planner_killed_ends_its_goal_once_and_leaves_boards_operational(frames: can.BusABC, client: Observer) -> None:
    before, executor, planner = client.wait_now("ready")["measured"], pid(EXECUTOR), pid(PLANNER)
    client.goal(RIGHT, LEFT, times=[HOUR, 2 * HOUR], id="orphan")
    eventually(lambda: client.state["goal"] == "orphan")
    drain(frames)
    os.kill(planner, signal.SIGKILL)
    eventually_shown(lambda: pid(PLANNER) not in (0, planner))
    comes_up()
    assert client.result("orphan")["status"] == "aborted"
    heard = drain(frames)
    assert (syncs(heard), disturbances(heard, PATIENCE)) == ([], [])
    assert (pid(EXECUTOR), shown(EXECUTOR, "NRestarts"), shown(PLANNER, "NRestarts")) == (executor, "0", "1")
    assert client.wait_now("ready")["measured"] == before
    client.move(MIDDLE, goal="after the planner was killed")


def test_executor_killed_moves_nothing_until_a_fresh_goal(frames: can.BusABC, client: Observer) -> None:
    assert client.goal(LEFT, RIGHT, times=[0.0, HOUR], id="cut")["accepted"]
    eventually(lambda: client.feedback("cut"))
    before, executor, planner = client.wait_now("executing")["measured"], pid(EXECUTOR), pid(PLANNER)
    counts, _ = robot.ledger()
    drain(frames)
    os.kill(executor, signal.SIGKILL)
    assert client.result("cut")["status"] == "aborted"
    eventually_shown(lambda: pid(EXECUTOR) not in (0, executor))
    comes_up(EXECUTOR)
    comes_up()
    assert client.wait_now("ready")["measured"] == before
    time.sleep(SLOWNESS)
    assert syncs(drain(frames)) == []
    assert (pid(PLANNER), shown(EXECUTOR, "NRestarts")) == (planner, "1")
    assert "memfd:switches" in os.readlink(f"/proc/{pid(EXECUTOR)}/fd/3"), "systemd gave the switch journal back"
    switched = client.move(MIDDLE, goal="after the executor was killed")["switches"]
    assert syncs(drain(frames))
    eventually(lambda: sum(robot.ledger()[0].values()) >= sum(counts.values()) + switched)


def test_stop_of_the_executor_does_not_fail_the_planner(frames: can.BusABC, client: Observer) -> None:
    before, planner = client.wait_now("ready")["measured"], pid(PLANNER)
    drain(frames)
    systemctl("stop", EXECUTOR)
    assert state_of(EXECUTOR) == ["inactive", "success", "0"]
    client.wait_now("fault")
    assert not client.ask("goal", waypoints=[{"t": 0.0, "position": list(RIGHT)}])["accepted"]
    systemctl("start", EXECUTOR)
    assert client.wait_now("ready")["measured"] == before
    assert syncs(drain(frames)) == []
    assert pid(PLANNER) == planner


def test_restart_of_the_planner_leaves_boards_operational_and_a_halt_in_force(
    frames: can.BusABC, client: Observer
) -> None:
    before, executor = client.wait_now("ready")["measured"], pid(EXECUTOR)
    client.goal(RIGHT, LEFT, times=[HOUR, 2 * HOUR], id="never")
    drain(frames)
    systemctl("stop", PLANNER)
    assert client.result("never")["status"] == "aborted"
    comes_up(EXECUTOR)
    outsider = [*NOBODY, "--clear-groups", "hyperbit", "halt", str(ARM)]
    assert subprocess.run(outsider, capture_output=True).returncode != 0, "only the group may open the socket"
    hyperbit("halt", ARM, prefix=[*NOBODY, f"--groups={robot.status(EXECUTOR)['Gid'].split()[0]}"])
    eventually_shown(lambda: shown(EXECUTOR, "StatusText").startswith("stopped: "))
    systemctl("start", PLANNER)
    eventually_shown(lambda: shown(PLANNER, "StatusText").startswith("stopped: "))
    heard = drain(frames)
    assert (syncs(heard), disturbances(heard, PATIENCE)) == ([], [])
    assert pid(EXECUTOR) == executor
    assert client.wait_now("stopped")["measured"] == before


def test_reset_ends_the_halt(frames: can.BusABC, client: Observer) -> None:
    client.wait_now("stopped")
    drain(frames)
    client.ask("reset")
    client.wait_now("ready")
    assert syncs(drain(frames)) == []


@pytest.mark.parametrize("hours", [1, -1], ids=["forward", "back"])
def test_goal_goes_on_when_the_clock_is_set(client: Observer, hours: int) -> None:
    goal = f"by {hours} h"
    client.wait_now("ready")
    assert client.goal(LEFT, RIGHT, times=[0.0, 1.0], id=goal)["accepted"]
    eventually(lambda: client.feedback(goal))
    told, sign = len(client.heard["state"]), "+" if hours > 0 else "-"
    time.clock_settime(time.CLOCK_REALTIME, time.time() + hours * HOUR)
    begun = time.time()

    def named() -> Message | None:
        states = client.heard["state"][told:]
        return next((s for s in states if any(f"was set by {sign}" in f["message"] for f in s["faults"])), None)

    state = eventually(named)
    assert abs(state["stamp"] - begun) < 2.0 * SLOWNESS
    assert client.result(goal)["status"] == "succeeded"
    assert "clock-set" in robot.journal()


def test_services_live_on_when_the_interface_goes_down_and_up(
    can0: vcan.Interface, frames: can.BusABC, client: Observer
) -> None:
    before, processes = client.wait_now("ready")["measured"], (pid(PLANNER), pid(EXECUTOR))
    drain(frames)
    can0.down()
    client.wait_now("fault", "can0")
    can0.up()
    assert client.wait_now("ready")["measured"] == before
    with can.Bus(interface="socketcan", channel=can0.name, ignore_config=True) as listening:
        client.move(MIDDLE, goal="after the interface was down")
        assert syncs(drain(listening))
    assert (pid(PLANNER), pid(EXECUTOR)) == processes


def test_certificates_let_in_whom_their_authority_knows(frames: can.BusABC, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    for words in (["daemon", "localhost"], ["client", "operator", "viewer"]):
        subprocess.run([PROJECT / "deploy/certificates.sh", keys, *words], check=True)
    for part in ("ca", "certificate", "key"):
        to = f"/etc/credstore/hyperbit.{part}.pem"
        subprocess.run(["install", "-D", "-m", "600", keys / "daemon" / f"{part}.pem", to], check=True)
    shutil.copy(PROJECT / "deploy/zenoh-tls.json5", "/etc/hyperbit/arm.json5")
    systemctl("restart", PLANNER)
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
    assert "reached (" in hyperbit("send", ARM, "--to", "3.0,0.7", "--zenoh", operator)
    assert syncs(drain(frames))


def test_stop_of_the_planner_leaves_the_arm_holding(frames: can.BusABC) -> None:
    executor = pid(EXECUTOR)
    drain(frames)
    systemctl("stop", PLANNER)
    assert state_of(PLANNER) == ["inactive", "success", "0"]
    time.sleep(2 * PATIENCE)
    heard = drain(frames)
    assert (syncs(heard), disturbances(heard, PATIENCE)) == ([], [])
    assert pid(EXECUTOR) == executor


def test_stop_of_the_executor_moves_nothing(frames: can.BusABC) -> None:
    drain(frames)
    systemctl("stop", EXECUTOR)
    assert state_of(EXECUTOR) == ["inactive", "success", "0"]
    assert syncs(drain(frames)) == []
    assert not Path("/run/hyperbit-arms/arm").exists()

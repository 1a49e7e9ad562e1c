"""The daemon's messages, its robustness against bad peers, and what else may run beside it."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from typing import Any

import pytest
import zenoh

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.gateway import daemon
from hyperbit.controller.network.client import Client, Message
from hyperbit.controller.network.session import configuration
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT
from tests.system.stack.processes import ROOT
from tests.system.stack.system import System
from tests.waiting import PATIENCE, SLOWNESS, eventually

pytestmark = pytest.mark.buses("virtual")


def test_the_arm_is_described(client: Observer, arm: Arm, system: System) -> None:
    described = client.ask("arm")
    assert (described["name"], described["dimension"]) == (system.name, 2)
    assert described["length"] == arm.manipulator.length
    assert described["states"] == [8] * 16
    assert described["actuators"] == list(arm.manipulator.actuators)
    assert described["frames"][0][0] == arm.manipulator.frames[0][0].tolist()
    assert described["tolerance"]["position"] == arm.tolerance
    assert described["daemon"]["pid"] == os.getpid()
    wired = arm.wiring[arm.manipulator.actuators.index("2.diagonal")]
    told = {name: value for name, value in described["boards"][4].items() if value is not None}
    assert told == {
        "module": 2, "actuator": "diagonal", "bus": "can0", "node": wired.node, "output": wired.output,
        "input": wired.input, "weight": 1.0,
    }  # fmt: skip


@pytest.mark.buses("virtual", "socketcan")
def test_diagnostics_tell_of_loop_bus_boards_and_queues(client: Observer, arm: Arm) -> None:
    client.move(MIDDLE)
    it = client.diagnosed()
    it = client.diagnosed()
    assert it["loop"]["ticks"] > 0
    assert it["buses"][0]["name"] == "can0"
    assert it["buses"][0]["tx_frames"] > 0
    assert 0 < it["buses"][0]["worst_case"]["load"] < 0.1, "nine tenths of 1 Mbit/s are left"
    assert [board["state"] for board in it["boards"]] == ["operational"] * len({w.node for w in arm.wiring})
    assert it["switches"] > 0
    assert set(it["queues"]) == {"inbox", "outbox", "planning"}
    assert it["ledger"] == "ok"
    assert it["real_time"] == "off"


def test_a_flood_is_refused_and_a_stop_gets_through(client: Observer, system: System, stack: ExitStack) -> None:
    flooding, prefix = stack.enter_context(system.session()), f"hyperbit/{system.name}"
    there_and_back = enumerate([LEFT, RIGHT] * int(80 / SLOWNESS))
    far = json.dumps({"waypoints": [{"t": 0.2 * k * SLOWNESS, "position": p} for k, p in there_and_back]})
    flood = [flooding.get(f"{prefix}/plan", payload=far, timeout=2 * PATIENCE) for _ in range(60)]
    assert client.ask("stop")["accepted"]
    client.wait_now("stopped")
    answers = [json.loads(reply.ok.payload.to_bytes()) for replies in flood for reply in replies]
    assert len(answers) == 60
    assert all("busy" in a["message"] for a in answers if not a["accepted"])
    client.reset()


FROZEN = """
import sys, zenoh
from hyperbit.controller.network import session

def hear(sample):
    print("heard", flush=True)

with zenoh.open(session.configuration("client", connect=sys.argv[1])) as it:
    it.declare_subscriber(sys.argv[2], hear)
    sys.stdin.read()
"""


def test_frozen_and_slow_readers_delay_nobody(client: Observer, system: System, stack: ExitStack) -> None:
    reader = subprocess.Popen(
        [sys.executable, "-c", FROZEN, system.endpoint, "hyperbit/**"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    ending, slow = threading.Event(), Client(stack.enter_context(system.session()), system.name)
    for key in ("state", "feedback", "result", "diagnostics"):
        slow.subscribe(key, lambda message: ending.wait(0.5) and None)
    far = [{"t": 0.2 * k * SLOWNESS, "position": LEFT} for k in range(int(50 / SLOWNESS))]
    try:
        assert reader.stdout
        assert reader.stdout.readline() == "heard\n"
        reader.send_signal(signal.SIGSTOP)
        for k in range(6):
            client.move((LEFT, RIGHT)[k % 2], goal=f"goal {k}")
            for _ in range(10):
                assert client.ask("plan", waypoints=far)["accepted"]
        assert client.diagnosed()["queues"]["outbox"] < 100
        assert client.faults(client.wait_now("ready")) == []
    finally:
        ending.set()
        reader.send_signal(signal.SIGKILL)
        reader.communicate()


@pytest.mark.fresh
def test_a_client_that_hears_a_state_is_answered(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[Message] = []
    before: list[int] = []

    class LateServer(daemon.Server):
        def __init__(self, *given: Any, **options: Any) -> None:
            time.sleep(0.3)  # a state would come meanwhile
            super().__init__(*given, **options)
            before.append(len(heard))

    monkeypatch.setattr(daemon, "Server", LateServer)
    system.config = system.clients()
    with zenoh.open(configuration("peer", listen=system.endpoint)) as session:
        client = Client(session, system.name)
        subscriber = client.subscribe("state", heard.append)
        system.start_executor()
        system.start_planner()
        eventually(lambda: heard)
        assert client.request("arm")["name"] == system.name
        assert before == [0]
        system.end_planner()
        subscriber.undeclare()


@pytest.mark.fresh
def test_a_planner_that_comes_back_finds_the_arm_as_it_is(system: System, motions: Motions) -> None:
    threads = {thread.name for thread in threading.enumerate()}
    system.start()
    with system.client() as client:
        client.move(RIGHT)
        eventually(lambda: client.client.alive())
        client.goal(MIDDLE, LEFT, times=[HOUR, 2 * HOUR], id="never")
        before, switches = system.boards.positions().tolist(), system.boards.switches().tolist()
        system.end_planner()
        assert client.result("never")["message"] == "the daemon is shutting down"
        eventually(lambda: not client.client.alive())
    eventually(lambda: {thread.name for thread in threading.enumerate()} <= threads)
    motions.clear()
    system.start_planner()
    with system.client() as client:
        state = client.wait_for("ready")
        assert state["measured"] == [int(position) for position in before]
        assert motions.still()
        assert system.boards.switches().tolist() == switches
        client.move(MIDDLE)
        assert client.results("never") == []

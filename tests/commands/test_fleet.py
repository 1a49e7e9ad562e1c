"""The commands `fleet`, `watch` and `stop --all`, with a router and arms in two namespaces."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
import threading
from contextlib import ExitStack

import pytest
import zenoh
from msgspec import convert
from msgspec.structs import replace
from rich.console import Console

from hyperbit.controller.commands.use import fleet
from hyperbit.controller.commands.use.watch import View, line_of, progress_of
from hyperbit.controller.messages.state import Diagnostics, Fault, Progress, State
from hyperbit.controller.network.fleet import ArmAddress, ArmStatus, alive
from tests import told
from tests.endpoints import free_endpoint
from tests.network.played import PlayedArm, Router
from tests.waiting import PATIENCE, eventually

HERE, THERE = ArmAddress("", "a"), ArmAddress("cell1", "a")
READY = State("ready", reason="holding", goal="g1")
INTERLOCK = Fault("interlock", "gate", "interlock gate is open")
STUCK = Fault("stuck", "2.1", "actuator 2.1 did not move")
STATE = State("fault", reason=INTERLOCK.message, faults=[STUCK, INTERLOCK], measured=[0, 1, None, 1])


class Plant:
    """A router, and two arms of one name that publish their states."""

    def __init__(self, stack: ExitStack) -> None:
        self.router = Router(stack)
        self.there = ("--connect", self.router.endpoint)
        self.arms = [PlayedArm(stack, self.router.client(namespace)) for namespace in ("", "cell1")]
        with zenoh.open(self.router.client()) as looking:
            eventually(lambda: alive(looking) == [HERE, THERE])
        self._ending = threading.Event()
        publishing = threading.Thread(target=self._publish)
        publishing.start()
        stack.callback(publishing.join)
        stack.callback(self._ending.set)

    def _publish(self) -> None:
        while not self._ending.wait(0.05):
            for arm in self.arms:
                arm.state(simulated=True, faults=[{"code": "stuck", "message": "5.left", "source": "5.left"}])


@pytest.fixture
def plant(stack):
    return Plant(stack)


def command(*words: str, **streams: int) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-m", "hyperbit", *words], text=True, **streams)


def test_all_arms_are_printed_once_in_a_pipe(plant, hyperbit):
    code, out, err = hyperbit("fleet", *plant.there)
    assert (code, err, len(out.splitlines())) == (0, "", 3)
    assert re.search(r"^ +a \(simulated\) here 9.9 +ready +stuck: 5.left", out, re.MULTILINE)
    assert re.search(r"^cell1 +a \(simulated\) here 9.9 +ready +stuck: 5.left", out, re.MULTILINE)
    code, out, err = hyperbit("fleet", *plant.there, "--json")
    assert (code, err) == (0, "")
    keys = ("namespace", "name", "host", "version", "alive", "gone_at", "old", "mode")
    assert [[json.loads(line)[key] for key in keys] for line in out.splitlines()] == [
        [namespace, "a", "here", "9.9", True, None, False, "ready"] for namespace in ("", "cell1")
    ]


def test_without_an_arm_fleet_and_stop_all_fail(told, stack):
    there = ("--connect", Router(stack).endpoint)
    for words in (("fleet",), ("stop", "--all")):
        assert "no arm at tcp/" in told(*words, *there, code=1)


def test_changes_are_followed_as_lines(plant):
    with command("fleet", "--follow", *plant.there, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as following:
        lines = (line.partition(" ")[2].strip() for line in following.stdout)
        ready = "(simulated): ready, holding; stuck: 5.left"
        assert {next(lines), next(lines)} == {f"a {ready}", f"cell1/a {ready}"}
        plant.arms[1].end()
        assert next(lines) == "cell1/a: gone"
        plant.router.end()
        assert following.stderr.readline().startswith(f"no connection to {plant.router.endpoint}: ")
        following.send_signal(signal.SIGINT)
        assert following.wait(PATIENCE) == 0


def test_a_terminal_shows_the_loss_of_arm_and_router_and_ends_by_an_interrupt(plant):
    leader, follower = pty.openpty()
    shown = bytearray()

    def read():
        try:
            while data := os.read(leader, 4096):
                shown.extend(data)
        except OSError:  # the terminal is closed
            return

    def says(*words):
        eventually(lambda: all(word.encode() in shown for word in words), told=lambda: f"{words} in {shown[-2000:]}")
        shown.clear()

    with command("fleet", *plant.there, stdin=follower, stdout=follower, stderr=follower) as following:
        os.close(follower)
        reading = threading.Thread(target=read)
        reading.start()
        says("2 alive, 0 gone, 2 with faults", "cell1", "9.9")
        plant.arms[0].end()
        says("1 alive, 1 gone, 1 with faults", "gone since")
        plant.router.end()
        says("no connection to tcp/", "not reached since")
        plant.router.start()
        says("1 alive, 1 gone, 1 with faults")
        following.send_signal(signal.SIGINT)
        assert following.wait(PATIENCE) == 0
        reading.join()
    os.close(leader)
    assert b"Traceback" not in shown


@pytest.mark.parametrize(
    ("state", "age", "new", "mode"),
    [
        (READY, 0.1, False, "ready"),
        (READY, 7.0, False, "ready 7 s ago"),
        (None, None, False, "no state"),
        (None, None, True, ""),
    ],
)
def test_an_old_state_is_told(state, age, new, mode):
    assert fleet.mode_of(ArmStatus(HERE, None, state, age, "h", "1", is_new=new), "gone").plain == mode


def test_stop_all_names_each_arm(plant, hyperbit, monkeypatch):
    assert hyperbit("stop", "--all", *plant.there) == (0, "a: stopped\ncell1/a: stopped\n", "")
    assert [arm.commands().count("stop") for arm in plant.arms] == [1, 1]
    code, out, _ = hyperbit("stop", "--all", "--json", *plant.there)
    told = [json.loads(line) for line in out.splitlines()]
    assert (code, [arm["namespace"] for arm in told], [arm["accepted"] for arm in told]) == (
        0,
        ["", "cell1"],
        [True, True],
    )
    monkeypatch.setattr(
        "hyperbit.controller.network.stop_all.stop_all.__defaults__", (("hyperbit/*", "*/**/hyperbit/*"), 1.0)
    )
    plant.arms[1].answer = None
    code, out, err = hyperbit("stop", "--all", *plant.there)
    assert (code, out, err.startswith("cell1/a: no answer: ")) == (1, "a: stopped\n", True)


def test_a_fault_that_is_the_reason_of_the_mode_is_printed_once():
    arm = ArmStatus(HERE, None, STATE, 0.0, None, None, is_new=False)
    stuck = "stuck: actuator 2.1 did not move"
    assert fleet.line_of_arm(arm) == f"a: fault, interlock: interlock gate is open; {stuck}"
    assert line_of(STATE, "") == f"fault: interlock: interlock gate is open; tip unknown; {stuck}"
    ready = replace(STATE, mode="ready", reason="holding", faults=[STUCK])
    assert line_of(ready, "") == f"ready: holding; tip unknown; {stuck}"


def test_the_progress_of_a_goal_is_told():
    running = replace(STATE, stamp=100.0, progress=Progress(5, 2, ends=103.2))
    assert progress_of(running) == "2 of 5 waypoints, 3.2 s left"
    assert progress_of(replace(running, stamp=104.0)) == "2 of 5 waypoints, 0.8 s late"
    assert progress_of(STATE) == ""


def shown(labels: list[str], diagnostics: dict | None = None) -> str:
    """Returns what `watch` shows of STATE."""
    view = View("a", labels, " mm")
    view.receive_message(STATE)
    if diagnostics:
        view.receive_message(convert(diagnostics, Diagnostics))
    with open(os.devnull, "w") as nothing:
        console = Console(width=200, record=True, file=nothing)
        console.print(view)
        return console.export_text()


def test_watch_separates_the_actuators_of_modules_and_shows_whole_numbers():
    assert "│ ▯▮ ?▮ " in shown(["1.1", "1.2", "2.left", "2.right"])
    assert "│ ▯▮?▮ " in shown([])
    assert "simulated" not in shown([])
    diagnostics = told.published()["diagnostics"]
    assert ", 3 overruns" in shown([], {**diagnostics, "loop": {**diagnostics["loop"], "overruns": 3.0}})


# Three arms that publish thousands of states a second, until their standard input ends.
ARMS = """
import sys, threading, time, zenoh
from hyperbit.controller.network import session
state = b'{"mode": "fault", "reason": "a test", "faults": []}'
with zenoh.open(session.configuration("peer", listen=sys.argv[1])) as opened:
    publishers = [opened.declare_publisher(f"hyperbit/a{k}/state") for k in range(3)]
    tokens = [opened.liveliness().declare_token(f"hyperbit/a{k}/alive") for k in range(3)]
    print(flush=True)
    reader = threading.Thread(target=sys.stdin.read)
    reader.start()
    while reader.is_alive():
        for publisher in publishers:
            publisher.put(state)
        time.sleep(0.0001)
"""


def test_states_that_arrive_at_the_end_of_a_list_cause_no_message():
    endpoint = free_endpoint()
    lists = "from hyperbit.controller.commands.use.fleet import fleet\nfor _ in range(3): fleet(connect='{}')"
    with subprocess.Popen(
        [sys.executable, "-c", ARMS, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as arms:
        assert arms.stdout is not None
        arms.stdout.readline()
        listed = subprocess.run([sys.executable, "-c", lists.format(endpoint)], capture_output=True, text=True)
        arms.communicate()
    assert (listed.returncode, listed.stderr) == (0, "")
    rows = {" ".join(line.split()) for line in listed.stdout.splitlines()}
    assert rows == {"namespace arm host version mode goal faults", *(f"a{k} fault" for k in range(3))}  # no log

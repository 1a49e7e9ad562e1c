"""The commands `fleet` and `stop --all`, with a router and arms in two namespaces."""

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

from hyperbit.controller.commands.use import fleet
from hyperbit.controller.network.fleet import ArmAddress, ArmStatus, alive
from tests.network.played import PlayedArm, Router
from tests.waiting import PATIENCE, eventually

HERE, THERE = ArmAddress("", "a"), ArmAddress("cell1", "a")
READY = {"mode": "ready", "reason": "holding", "simulated": False, "goal": "g1", "faults": []}


class Plant:
    """A router, and two arms of one name that publish their states."""

    def __init__(self, stack: ExitStack) -> None:
        self.router = Router(stack)
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


def test_all_arms_are_printed_once_in_a_pipe(plant, hyperbit):
    code, out, err = hyperbit("fleet", "--connect", plant.router.endpoint)
    assert (code, err) == (0, "")
    rows = [re.split(r"  +", line.strip()) for line in out.splitlines()]
    assert len(rows) == 3
    assert re.search(r"^ +a \(simulated\) here 9.9 +ready +stuck: 5.left", out, re.MULTILINE)
    assert re.search(r"^cell1 +a \(simulated\) here 9.9 +ready +stuck: 5.left", out, re.MULTILINE)
    code, out, err = hyperbit("fleet", "--connect", plant.router.endpoint, "--json")
    assert (code, err) == (0, "")
    told = [json.loads(line) for line in out.splitlines()]
    assert [(arm["namespace"], arm["name"], arm["host"], arm["version"]) for arm in told] == [
        ("", "a", "here", "9.9"),
        ("cell1", "a", "here", "9.9"),
    ]
    assert all((arm["alive"], arm["gone_at"], arm["old"], arm["mode"]) == (True, None, False, "ready") for arm in told)


def test_fleet_follows_or_prints_once(told):
    assert "give either --follow or --once" in told("fleet", "--follow", "--once", code=2)


def test_without_an_arm_fleet_fails(hyperbit, stack):
    code, out, err = hyperbit("fleet", "--connect", Router(stack).endpoint)
    assert (code, out) == (1, "")
    assert "no arm at tcp/" in err


def test_changes_are_followed_as_lines(plant):
    command = [sys.executable, "-m", "hyperbit", "fleet", "--follow", "--connect", plant.router.endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as following:
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
    command = [sys.executable, "-m", "hyperbit", "fleet", "--connect", plant.router.endpoint]
    shown = bytearray()

    def read():
        while True:
            try:
                if not (data := os.read(leader, 4096)):
                    return
            except OSError:  # the terminal is closed
                return
            shown.extend(data)

    def says(*words):
        eventually(lambda: all(word.encode() in shown for word in words), told=lambda: f"{words} in {shown[-2000:]}")
        shown.clear()

    with subprocess.Popen(command, stdin=follower, stdout=follower, stderr=follower) as following:
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
    ("arm", "mode"),
    [
        (ArmStatus(HERE, None, READY, 0.1, "h", "1", is_new=False), "ready"),
        (ArmStatus(HERE, None, READY, 7.0, "h", "1", is_new=False), "ready 7 s ago"),
        (ArmStatus(HERE, None, None, None, "h", "1", is_new=False), "no state"),
        (ArmStatus(HERE, None, None, None, None, None, is_new=True), ""),
    ],
)
def test_an_old_state_is_told(arm, mode):
    assert fleet.mode_of(arm, "gone").plain == mode


def test_stop_all_names_each_arm(plant, hyperbit):
    code, out, err = hyperbit("stop", "--all", "--connect", plant.router.endpoint)
    assert (code, out, err) == (0, "a: stopped\ncell1/a: stopped\n", "")
    assert [arm.commands().count("stop") for arm in plant.arms] == [1, 1]
    code, out, _ = hyperbit("stop", "--all", "--json", "--connect", plant.router.endpoint)
    assert code == 0
    assert [(arm["namespace"], arm["name"], arm["accepted"]) for arm in map(json.loads, out.splitlines())] == [
        ("", "a", True),
        ("cell1", "a", True),
    ]


def test_stop_all_fails_and_names_an_arm_that_does_not_answer(plant, hyperbit, monkeypatch):
    monkeypatch.setattr(
        "hyperbit.controller.network.stop_all.stop_all.__defaults__", (("hyperbit/*", "*/**/hyperbit/*"), 1.0)
    )
    plant.arms[1].answer = None
    code, out, err = hyperbit("stop", "--all", "--connect", plant.router.endpoint)
    assert (code, out) == (1, "a: stopped\n")
    assert err.startswith("cell1/a: no answer: ")


def test_stop_takes_either_an_arm_or_all(told):
    for words in (["stop"], ["stop", "a", "--all"]):
        assert "give either the arm's name" in told(*words, code=2)


def test_stop_all_without_an_arm_fails(told, stack):
    assert "no arm at tcp/" in told("stop", "--all", "--connect", Router(stack).endpoint, code=1)

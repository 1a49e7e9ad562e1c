"""The command exercise: requests to the daemon, and the proposed travel times."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import contextmanager
from typing import Any

import pytest

from hyperbit.controller.commands.configure import exercise
from hyperbit.controller.commands.configure.exercise import MeasuredTravel, proposal

LABELS = ["1.left", "1.right"]
STUCK = {"status": "aborted", "code": -4, "message": "stuck"}


class Daemon:
    """Answers for an arm of two actuators. The second is extended, and has no end-stop at its contracted end."""

    def __init__(self) -> None:
        self.mode, self.commanded = "ready", [0, 1]
        self.jogs: list[dict[str, str]] = []
        self.canceled = False
        self.result: Callable[[str, str], dict[str, Any]] = self.well

    def describe(self) -> dict[str, Any]:
        names = [label.partition(".") for label in LABELS]
        boards = [{"module": int(m), "actuator": a, "input": 1, "input_contracted": None} for m, _, a in names]
        boards[0]["input_contracted"] = 2
        return {"actuators": LABELS, "boards": boards}

    def request(self, key: str) -> dict[str, Any]:
        self.canceled |= key == "cancel"
        return {"accepted": True, "message": "canceled"}

    def next_message(self, key: str) -> dict[str, Any]:
        return {"mode": self.mode, "reason": "why", "commanded": self.commanded}

    def run(self, payload: dict[str, Any], key: str) -> dict[str, Any]:
        assert key == "jog"
        self.jogs.append(payload["actuators"])
        [(label, state)] = payload["actuators"].items()
        return self.result(label, state)

    def well(self, label: str, state: str) -> dict[str, Any]:
        seconds = {"extended": 0.0812, "contracted": 0.0641}[state]
        measured = (label, state) != ("1.right", "contracted")
        travels = [{"actuator": label, "state": state, "seconds": seconds}] if measured else []
        return {"status": "succeeded", "code": 0, "message": "switched", "travels": travels}


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> Daemon:
    made = Daemon()

    @contextmanager
    def connected(*_: object):
        yield made

    monkeypatch.setattr(exercise, "connected", connected)
    return made


def test_each_actuator_moves_alone_there_and_back(hyperbit, daemon):
    code, out, err = hyperbit("exercise", "a", "--yes")
    assert (code, err) == (0, "")
    assert daemon.jogs == [
        {"1.left": "extended"},
        {"1.left": "contracted"},
        {"1.right": "contracted"},
        {"1.right": "extended"},
    ]
    assert [line.split() for line in out.splitlines()[1:3]] == [
        ["1.left", "81.2", "64.1"],
        ["1.right", "81.2", "no", "`input_contracted`"],
    ]
    assert out.endswith(
        "\ntravel_time: {extend: 0.102, contract: ...}\n"
        "# actuator 1.left:  travel_time: {extend: 0.102, contract: 0.081}\n"
        "# contract of 1.right was not measured: keep the present time for it\n"
    )
    _, out, _ = hyperbit("exercise", "a", "1.left", "--yes", "--json")
    assert [json.loads(line) for line in out.splitlines()] == [
        {"actuator": "1.left", "state": "extended", "seconds": 0.0812},
        {"actuator": "1.left", "state": "contracted", "seconds": 0.0641},
        {"proposal": "# actuator 1.left:  travel_time: {extend: 0.102, contract: 0.081}"},
    ]


def test_nothing_moves_without_confirmation(hyperbit, daemon, monkeypatch):
    monkeypatch.setattr("typer.confirm", lambda question, err: "2 actuators" in question and False)
    assert hyperbit("exercise", "a")[0] == 1
    assert daemon.jogs == []


def refused(daemon: Daemon) -> None:
    daemon.result = lambda label, state: {"accepted": False, "code": -1, "message": "the arm is in fault"}


def stuck(daemon: Daemon) -> None:
    daemon.result = lambda label, state: daemon.well(label, state) if label == "1.left" else STUCK


def interrupted(daemon: Daemon) -> None:
    def interrupt(label: str, state: str) -> dict[str, Any]:
        raise KeyboardInterrupt

    daemon.result = interrupt


def in_fault(daemon: Daemon) -> None:
    daemon.mode = "fault"


def unknown(daemon: Daemon) -> None:
    daemon.commanded = None


@pytest.mark.parametrize(
    ("change", "words", "code", "jogs", "sentence"),
    [
        (refused, (), 1, 1, "1.left to extended: refused (code -1)"),
        (stuck, (), 1, 3, "1.right to contracted: aborted (code -4): stuck"),
        (interrupted, (), 130, 1, ""),
        (in_fault, (), 1, 0, "the arm is fault: why"),
        (unknown, (), 1, 0, "jog them first"),
        (stuck, ("9.left",), 2, 0, "'9.left' is no actuator of this arm, which has 1.left to 1.right"),
    ],
)
def test_the_first_fault_ends_it(hyperbit, daemon, change, words, code, jogs, sentence):
    change(daemon)
    ended, out, err = hyperbit("exercise", "a", *words, "--yes")
    assert (ended, len(daemon.jogs), sentence in err) == (code, jogs, True), err
    assert daemon.canceled == (code == 130)
    if jogs == 3:  # times measured before the fault are printed
        assert out.splitlines()[0].split() == ["actuator", "extend", "[ms]", "contract", "[ms]"]
        assert ["1.left", "81.2", "64.1"] in [line.split() for line in out.splitlines()]


@pytest.mark.parametrize(
    ("times", "labels", "lines"),
    [
        (
            {"a": (0.08, None)},
            "a",
            [
                "travel_time: {extend: 0.1, contract: ...}",
                "# contract of a was not measured: keep the present time for it",
            ],
        ),
        (
            {"a": (0.08, None), "b": (0.08, None)},
            "ab",
            [
                "travel_time: {extend: 0.1, contract: ...}",
                "# contract of any actuator was not measured: keep the present time for it",
            ],
        ),
        ({"a": (None,)}, "a", []),
        ({"a": (0.02, 0.03)}, "ab", ["# actuator a:  travel_time: {extend: 0.025, contract: 0.038}"]),
        (
            {"a": (0.12, 0.1), "b": (0.04, 0.04)},
            "ab",
            [
                "travel_time: {extend: 0.15, contract: 0.125}",
                "# actuator b:  travel_time: {extend: 0.05, contract: 0.05}",
            ],
        ),
    ],
    ids=["a direction", "a direction of all", "nothing", "one of two", "much faster"],
)
def test_times_are_proposed_for_what_was_measured(times, labels, lines):
    ways = ("extended", "contracted")
    measured = [
        MeasuredTravel(label, way, time) for label, own in times.items() for way, time in zip(ways, own, strict=False)
    ]
    assert proposal(measured, list(labels)) == lines

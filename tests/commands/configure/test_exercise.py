"""The command exercise: requests to the daemon, and the proposed travel times."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import contextmanager
from typing import Any

import pytest
import yaml

from hyperbit.controller.commands.configure import exercise
from hyperbit.controller.commands.configure.exercise import MeasuredTravel, proposal
from tests.commands.conftest import ARM

LABELS = ["1.left", "1.right"]


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


def test_json_has_a_line_for_each_way_and_the_proposal(hyperbit, daemon):
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


@pytest.mark.parametrize(
    ("result", "sentence"),
    [
        ({"accepted": False, "code": -1, "message": "the arm is in fault"}, "1.left to extended: refused (code -1)"),
        ({"status": "aborted", "code": -4, "message": "stuck"}, "1.left to extended: aborted (code -4): stuck"),
    ],
)
def test_the_first_fault_ends_it(hyperbit, daemon, result, sentence):
    daemon.result = lambda label, state: result
    code, _, err = hyperbit("exercise", "a", "--yes")
    assert (code, len(daemon.jogs)) == (1, 1)
    assert sentence in err


def test_times_measured_before_a_fault_are_printed(hyperbit, daemon):
    daemon.result = lambda label, state: (
        daemon.well(label, state) if label == "1.left" else {"status": "aborted", "code": -4, "message": "stuck"}
    )
    code, out, err = hyperbit("exercise", "a", "--yes")
    assert code == 1
    assert out.splitlines()[0].split() == ["actuator", "extend", "[ms]", "contract", "[ms]"]
    assert ["1.left", "81.2", "64.1"] in [line.split() for line in out.splitlines()]
    assert "1.right to contracted" in err


def test_an_interrupt_cancels_the_motion(hyperbit, daemon):
    def interrupted(label: str, state: str) -> dict[str, Any]:
        raise KeyboardInterrupt

    daemon.result = interrupted
    assert hyperbit("exercise", "a", "--yes")[0] == 130
    assert daemon.canceled


def test_an_arm_that_is_not_ready_is_not_exercised(hyperbit, daemon):
    daemon.mode = "fault"
    code, _, err = hyperbit("exercise", "a", "--yes")
    assert (code, "the arm is fault: why" in err) == (1, True)
    daemon.mode, daemon.commanded = "ready", None
    code, _, err = hyperbit("exercise", "a", "--yes")
    assert (code, "jog them first" in err) == (1, True)
    assert daemon.jogs == []


def test_an_unknown_actuator_is_unusable_input(hyperbit, daemon):
    code, _, err = hyperbit("exercise", "a", "9.left", "--yes")
    assert (code, "'9.left' is no actuator of this arm, which has 1.left to 1.right" in err) == (2, True)


def test_a_direction_that_was_not_measured_gets_no_time():
    assert proposal([MeasuredTravel("a", "extended", 0.08), MeasuredTravel("a", "contracted", None)], ["a"]) == [
        "travel_time: {extend: 0.1, contract: ...}",
        "# contract of a was not measured: keep the present time for it",
    ]
    both = [MeasuredTravel(label, "extended", 0.08) for label in "ab"] + [
        MeasuredTravel(label, "contracted", None) for label in "ab"
    ]
    assert proposal(both, ["a", "b"]) == [
        "travel_time: {extend: 0.1, contract: ...}",
        "# contract of any actuator was not measured: keep the present time for it",
    ]
    assert proposal([MeasuredTravel("a", "extended", None)], ["a"]) == []


def test_one_actuator_gives_the_arm_no_time():
    measured = [MeasuredTravel("a", "extended", 0.02), MeasuredTravel("a", "contracted", 0.03)]
    assert proposal(measured, ["a", "b"]) == ["# actuator a:  travel_time: {extend: 0.025, contract: 0.038}"]


def test_much_faster_actuators_get_times_of_their_own():
    travels = [
        MeasuredTravel("a", "extended", 0.12),
        MeasuredTravel("a", "contracted", 0.1),
        MeasuredTravel("b", "extended", 0.04),
    ]
    assert proposal([*travels, MeasuredTravel("b", "contracted", 0.04)], ["a", "b"]) == [
        "travel_time: {extend: 0.15, contract: 0.125}",
        "# actuator b:  travel_time: {extend: 0.05, contract: 0.05}",
    ]


def test_a_daemon_moves_and_measures(hyperbit, endpoint):
    code, out, err = hyperbit("exercise", "planar16", "5.left", "--yes", "--json", "--connect", endpoint)
    assert code == 0, err
    extended, contracted, last = (json.loads(line) for line in out.splitlines())
    assert (extended["actuator"], extended["state"]) == ("5.left", "extended")
    assert extended["seconds"] == pytest.approx(0.5 * yaml.safe_load(ARM.read_text())["travel_time"], rel=0.1)
    assert (contracted["state"], contracted["seconds"]) == ("contracted", None)  # which has no end-stop there
    assert last["proposal"].startswith("# actuator 5.left:  travel_time: {extend: 0.0")
    assert last["proposal"].endswith("# contract of 5.left was not measured: keep the present time for it")

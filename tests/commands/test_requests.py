"""Commands that send requests: what reaches the daemon, what a refusal leads to, and completion in the shell."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest
from msgspec import to_builtins

from hyperbit.controller.commands.common import refusal
from hyperbit.controller.commands.connection import named
from hyperbit.controller.commands.operate import demo
from hyperbit.controller.commands.use import halt
from hyperbit.controller.commands.use.send import cancel_goal, counted
from hyperbit.controller.messages.goals import refused
from hyperbit.controller.motion.decoding.requests import DegradeMessage
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.drivers.simulation.fault_commands import VERBS, usage
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.gateway.conftest import NO_ACTUATOR


@pytest.mark.parametrize(
    ("words", "heard", "told"),
    [
        (
            "jog a 5.left=extended 7.right=contracted --no-wait",
            ("jog", {"5.left": "extended", "7.right": "contracted"}),
            (0, "jog\n", ""),
        ),
        ("stop a", ("stop", None), (0, "stop\n", "")),
        (
            "lock a 5.left=contracted",
            ("degrade", DegradeMessage("5.left", 0)),
            (1, "", f"refused (code -1): {NO_ACTUATOR}\n"),
        ),
    ],
)
def test_a_command_sends_one_request(hyperbit, gateway, words, heard, told):
    assert hyperbit(*words.split(), "--connect", gateway.endpoint) == told
    assert gateway.planner.heard == [heard]


def test_the_variable_names_the_endpoint_and_the_option_overrides_it(hyperbit, gateway, monkeypatch):
    monkeypatch.setenv("HYPERBIT_CONNECT", gateway.endpoint)
    assert hyperbit("stop", "a") == (0, "stop\n", "")
    assert named("a", gateway.endpoint, None) == "a"
    assert named("an arm.yaml", "tcp/10.0.0.2:7447", None) == "'an arm.yaml' --connect tcp/10.0.0.2:7447"
    assert named("a", gateway.endpoint, Path("tls.json5")) == "a --zenoh tls.json5"
    monkeypatch.setenv("HYPERBIT_CONNECT", "10.0.0.2:7447")
    assert hyperbit("stop", "a")[2].startswith("HYPERBIT_CONNECT: '10.0.0.2:7447' is no endpoint: ")
    monkeypatch.delenv("HYPERBIT_CONNECT")
    assert hyperbit("run", "ARM.yaml", "--listen", "here")[2].startswith("endpoint: 'here' is no endpoint: ")
    assert hyperbit("stop", "a", "--connect", gateway.endpoint)[0] == 0


@pytest.mark.parametrize(("arm", "file"), [("a", "ARM.yaml"), ("'my arm.yaml' --connect x", "'my arm.yaml'")])
def test_advice_names_the_file_that_was_given(arm, file):
    told = str(refusal(to_builtins(refused(Refusal(Reason.NOT_SIMULATED))), arm))
    assert told.endswith(f"Next: start a simulated arm by: hyperbit run {file} --simulate")


def test_a_fault_is_sent_as_it_is_typed_and_refused_by_real_boards(hyperbit, gateway, monkeypatch):
    monkeypatch.setattr(gateway.planner, "decode", lambda key, payload: payload)
    words = ("fault", "a", "stick", "5.left", "1", "--connect", gateway.endpoint)
    assert hyperbit(*words) == (0, "fault\n", "")
    assert gateway.planner.heard == [("fault", b'{"fault":"stick 5.left 1"}')]
    monkeypatch.setattr(gateway.planner, "_answer", lambda key, message: refused(Refusal(Reason.NOT_SIMULATED)))
    code, out, err = hyperbit(*words)
    assert (code, out) == (1, "")
    assert "the boards of this arm are real; faults are played in simulated boards only" in err
    assert "hyperbit run ARM.yaml --simulate" in err


def test_help_lists_the_verbs_of_faults_and_the_variants_of_boards(hyperbit):
    lines = [line.strip() for line in hyperbit("fault", "--help")[1].splitlines()]
    assert not [verb for verb in VERBS if not any(line.startswith(usage(verb)) for line in lines)]
    lines = [line.strip().split(maxsplit=1) for line in hyperbit("simulate", "--help")[1].splitlines()]
    assert not [name for name, variant in VARIANTS.items() if [name, variant.text] not in lines]


@pytest.mark.parametrize(
    ("reason", "step"),
    [
        ({"reason": "arm-stopped"}, "\nNext: leave the stop by: hyperbit reset left"),
        ({"reason": "arm-in-fault"}, "\nNext: remove the cause, then: hyperbit reset left"),
        ({"reason": "invalid-fields"}, ""),
        ({"reason": "unknown to this client"}, ""),
        ({}, ""),  # of an older daemon, or a result that is no refusal
    ],
)
def test_a_refusal_leads_to_the_next_step(reason, step):
    failed = refusal({"accepted": False, "code": -1, "message": "the arm is stopped", **reason}, "left")
    assert str(failed) == f"refused (code -1): the arm is stopped{step}"


@pytest.mark.parametrize(("switches", "words"), [(0, "0 switches"), (1, "1 switch"), (2, "2 switches")])
def test_switches_are_counted_in_words(switches, words):
    assert counted(switches) == words


def test_a_halt_has_a_line_for_each_arm(hyperbit, tmp_path, monkeypatch):
    def halt_at(path, name):
        if path.stem == "c":
            raise ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused")
        return f"stopped by process {path.stem}"

    monkeypatch.setattr(halt, "halt_at", halt_at)
    words = ("halt", "--socket", str(tmp_path))
    for name in ("a", "b"):
        (tmp_path / f"{name}.sock").touch()
    assert hyperbit(*words) == (0, "a: stopped by process a\nb: stopped by process b\n", "")
    (tmp_path / "c.sock").touch()
    code, out, err = hyperbit(*words, "--json")
    told = [json.loads(line) for line in out.splitlines()]
    assert told[0] == {"arm": "a", "accepted": True, "message": "stopped by process a"}
    assert (code, [line["accepted"] for line in told]) == (1, [True, True, False])
    assert "c.sock: no executor answers (Connection refused)" in err


def test_an_interrupt_cancels_no_goal_of_others(capsys):
    class Answering:
        def request(self, key, payload):
            self.asked = (key, payload)
            return {"accepted": False, "message": "goal long has ended"}

    client = Answering()
    cancel_goal(client, "long", False)
    assert client.asked == ("cancel", {"id": "long"})
    assert capsys.readouterr().out == "goal long: goal long has ended\n"


def test_the_demo_runs_and_draws(hyperbit, tmp_path, monkeypatch):
    """Takes seconds: a daemon starts in a process of its own, and the arm follows a curve in real time."""
    monkeypatch.setattr(demo, "CURVE_WAYPOINTS", 9)
    picture = tmp_path / "demo.png"
    code, out, err = hyperbit("demo", "--picture", str(picture))
    assert (code, err) == (0, "")
    assert f"closed curve, {demo.CURVE_WAYPOINTS} waypoints" in out
    assert picture.read_bytes().startswith(b"\x89PNG")


FILE = "deploy/planar16.yaml"


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("st", "stop"),
        ("stop --js", "--json"),
        ("send --path", "--path-tolerance"),
        ("watch deploy/planar", FILE),
        ("watch --connect tcp/127.0.0.1:1 pl", ""),
        ("check deploy/platform", "deploy/platform8.yaml"),
        (f"jog {FILE} 5.", "5.left= 5.diagonal= 5.right="),
        (f"jog {FILE} 5.left", "5.left=contracted 5.left=extended"),
        (f"lock {FILE} 5.left=f", "5.left=free"),
        (f"lock {FILE} 5.left =", "contracted extended free"),  # bash divides words at =
        (f"lock {FILE} 5.left = ex", "extended"),
        ("jog no-such-file.yaml 5.", ""),
    ],
)
def test_bash_completes_the_last_word(completed, words, found):
    assert completed(words) == found.split()

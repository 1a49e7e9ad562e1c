"""The command fault: its help, its request, and refusals."""

from __future__ import annotations

from hyperbit.controller.planning.core.events import refused
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.drivers.simulation.fault_commands import VERBS, usage

NOWHERE = ("--connect", "tcp/127.0.0.1:1")


def test_help_names_each_verb_with_a_line(hyperbit):
    code, out, _ = hyperbit("fault", "--help")
    assert code == 0
    lines = [line.strip() for line in out.splitlines()]
    for verb in VERBS:
        assert any(line.startswith(usage(verb)) for line in lines), verb


def test_a_fault_is_sent_as_it_is_typed(hyperbit, gateway, monkeypatch):
    monkeypatch.setattr(gateway.planner, "decode", lambda key, payload: payload)
    words = ("fault", "a", "stick", "5.left", "1", "--connect", gateway.endpoint)
    assert hyperbit(*words) == (0, "fault\n", "")
    assert gateway.planner.heard == [("fault", b'{"fault":"stick 5.left 1"}')]


def test_an_arm_with_real_boards_refuses_in_words(hyperbit, gateway, monkeypatch):
    refusal = refused(Refusal(Reason.NOT_SIMULATED))
    monkeypatch.setattr(gateway.planner, "_answer", lambda key, message: refusal)
    code, out, err = hyperbit("fault", "a", "silence", "can0/5", "--connect", gateway.endpoint)
    assert (code, out) == (1, "")
    assert "the boards of this arm are real; faults are played in simulated boards only" in err
    assert "hyperbit run ARM.yaml --simulate" in err


def test_words_that_are_no_text_are_unusable_input(hyperbit):
    code, _, err = hyperbit("fault", "a", "silence", "can0/\udcff", *NOWHERE)
    assert (code, "as in silence can0/5" in err) == (2, True)

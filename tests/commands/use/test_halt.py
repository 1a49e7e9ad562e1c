"""The command halt: what it prints for several arms."""

from __future__ import annotations

import json

import pytest

from hyperbit.controller.commands.use import halt


@pytest.fixture
def arms(tmp_path, monkeypatch):
    """Two arms whose executors answer, and one whose executor does not."""

    def halt_at(path, name):
        if path.stem == "c":
            raise ConnectionRefusedError(111, "Connection refused")
        return f"stopped by process {path.stem}"

    monkeypatch.setattr(halt, "halt_at", halt_at)
    for name in ("a", "b"):
        (tmp_path / f"{name}.sock").touch()
    return tmp_path


def test_each_arm_has_a_line(hyperbit, arms):
    words = ("halt", "--socket", str(arms))
    assert hyperbit(*words) == (0, "a: stopped by process a\nb: stopped by process b\n", "")
    code, out, err = hyperbit(*words, "--json")
    assert (code, err) == (0, "")
    assert [json.loads(line) for line in out.splitlines()] == [
        {"arm": name, "accepted": True, "message": f"stopped by process {name}"} for name in ("a", "b")
    ]


def test_an_arm_that_does_not_answer_is_told_beside_those_that_stopped(hyperbit, arms):
    (arms / "c.sock").touch()
    code, out, err = hyperbit("halt", "--socket", str(arms), "--json")
    assert code == 1
    assert [json.loads(line)["accepted"] for line in out.splitlines()] == [True, True, False]
    assert "c.sock: no executor answers (Connection refused)" in err

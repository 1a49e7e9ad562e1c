"""Completion in the shell, as bash asks for it."""

from __future__ import annotations

import pytest

from hyperbit.controller import cli

FILE = "deploy/planar16.yaml"


@pytest.fixture
def completed(hyperbit, monkeypatch):
    """Returns the completions of the last word of a command line; words that bash would divide are divided."""

    def complete(*words: str) -> list[str]:
        monkeypatch.setenv("_HYPERBIT_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", " ".join(["hyperbit", *words]))
        monkeypatch.setenv("COMP_CWORD", str(len(words)))
        monkeypatch.setattr(cli.app, "_add_completion", True)
        code, out, err = hyperbit()
        assert (code, err) == (0, "")
        return out.split()

    return complete


def test_arms_complete_by_file_and_by_name(completed, endpoint):
    assert completed("watch", "deploy/planar") == [FILE]
    assert completed("watch", "--connect", endpoint, "pl") == ["planar16"]
    assert completed("watch", "--connect", "tcp/127.0.0.1:1", "pl") == []
    assert completed("check", "deploy/platform") == ["deploy/platform8.yaml"]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("jog", FILE, "5."), ["5.left=", "5.diagonal=", "5.right="]),
        (("jog", FILE, "5.left"), ["5.left=contracted", "5.left=extended"]),
        (("lock", FILE, "5.left=f"), ["5.left=free"]),
        (("lock", FILE, "5.left", "="), ["contracted", "extended", "free"]),
        (("lock", FILE, "5.left", "=", "ex"), ["extended"]),
        (("jog", "no-such-file.yaml", "5."), []),
    ],
)
def test_actuators_complete_with_their_states(completed, words, found):
    assert completed(*words) == found


def test_actuators_of_a_running_arm_complete(completed, endpoint):
    assert completed("jog", "--connect", endpoint, "planar16", "16.") == ["16.left=", "16.diagonal=", "16.right="]

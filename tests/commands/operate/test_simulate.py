"""The option --board, which selects the kinds of simulated boards."""

from __future__ import annotations

import subprocess
import sys

import pytest

from hyperbit.controller.commands.operate.simulate import WIDEST
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.commands.conftest import ARM


def test_help_lists_the_variants(hyperbit):
    code, out, _ = hyperbit("simulate", "--help")
    assert code == 0
    for name, variant in VARIANTS.items():
        assert f"{name:{WIDEST}} {variant.text}\n" in out


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        ("can0/5=x", "no variant x of boards, there are standard, guarding-only,"),
        ("can9/1=standard", "no board can9/1,"),
    ],
)
def test_boards_and_variants_that_are_not_there_are_unusable_input(hyperbit, word, sentence):
    code, _, err = hyperbit("simulate", str(ARM), "--board", word)
    assert (code, sentence in err.replace("\n", " ")) == (2, True), err
    run = subprocess.run(
        [sys.executable, "-m", "hyperbit.controller.executor", str(ARM), "--simulate", f"--board={word}"],
        capture_output=True,
        text=True,
    )
    assert (run.returncode, sentence in run.stderr) == (2, True), run.stderr
    code, out, err = hyperbit("run", str(ARM), "--simulate", "--board", word)  # before a process is started
    assert (code, out, err) == (2, "", f"--board: {err.removeprefix('--board: ')}")
    assert sentence in err


def test_a_daemon_takes_them_for_simulated_boards_only(hyperbit):
    code, _, err = hyperbit("run", str(ARM), "--board", "standard")
    assert (code, "give --simulate as well" in err) == (2, True)

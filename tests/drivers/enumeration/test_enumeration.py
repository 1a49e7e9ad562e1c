"""A boot in which one thing fails switches no output: a fixed share of all such boots."""

from __future__ import annotations

import pytest

from tests.drivers.enumeration.bench import HISTORIES, SLOW
from tests.drivers.enumeration.mixed import MIXED
from tests.drivers.enumeration.trials import Verdict, run, trials
from tests.drivers.variants.cases import CASES, Case

EVERY, EVERY_SLOW = 601, 2003  # prime, so that all kinds of failures are among them
EVERY_RESTART = 7  # a restart is dangerous between some successive frames


@pytest.mark.parametrize(("number", "case"), list(enumerate([*CASES, *MIXED])), ids=lambda it: getattr(it, "name", ""))
def test_a_boot_with_one_failure_switches_nothing(number: int, case: Case):
    """Each board has two of the histories in turn, because each one takes boots of its own."""
    every = EVERY_SLOW if case.variant in SLOW else EVERY
    chosen = [HISTORIES[k % len(HISTORIES)] for k in (number, number + 3)]
    verdicts = [(trial.name, run(trial)) for trial in trials(case, every, chosen=chosen)]
    assert any(verdict.ready for _, verdict in verdicts) == (not case.refused)
    require_unbroken(verdicts)


def test_a_board_with_outputs_of_all_kinds_may_restart_in_its_boot():
    restarts = [trial for case in MIXED[1::5] for trial in trials(case, EVERY_RESTART, "power-cycled")]
    require_unbroken([(trial.name, run(trial)) for trial in restarts])


def test_another_program_may_stop_a_boot_that_found_a_board_operational_in_its_error_state():
    found = [trial for trial in trials(MIXED[7], 1, "NMT 80h", HISTORIES[-1:])]
    require_unbroken([(trial.name, run(trial)) for trial in found])


def test_the_command_that_ends_an_error_state_may_be_lost():
    found = [
        trial for trial in trials(MIXED[7], 1, "frame lost", HISTORIES[-1:]) if trial.failure.text.startswith("000h")
    ]
    assert found
    require_unbroken([(trial.name, run(trial)) for trial in found])


def require_unbroken(verdicts: list[tuple[str, Verdict]]) -> None:
    broken = [f"{name}: {sentence}" for name, verdict in verdicts for sentence in verdict.broken]
    assert not broken, "\n".join(broken[:10])

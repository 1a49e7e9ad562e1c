"""A boot in which one thing fails switches no output: a fixed share of all such boots."""

from __future__ import annotations

import pytest

from tests.drivers.enumeration.histories import SLOW
from tests.drivers.enumeration.trials import run, trials
from tests.drivers.variants.cases import CASES, Case

EVERY, EVERY_SLOW = 1187, 8009  # prime, so that all kinds of failures are among them


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_boot_with_one_failure_switches_nothing(case: Case):
    every = EVERY_SLOW if case.variant in SLOW else EVERY
    verdicts = [(trial.name, run(trial)) for trial in trials(case, every)]
    assert any(verdict.ready for _, verdict in verdicts) == (not case.refused)
    broken = [f"{name}: {sentence}" for name, verdict in verdicts for sentence in verdict.broken]
    assert not broken, "\n".join(broken[:10])

"""A boot in which one thing fails switches no output: a fixed share of all such boots."""

from __future__ import annotations

import pytest

from tests.drivers.enumeration.histories import SLOW, Subject, subjects
from tests.drivers.enumeration.trials import run, trials

EVERY, EVERY_SLOW = 499, 1999  # prime, so that all kinds of failures are among them


@pytest.mark.parametrize("subject", subjects(), ids=lambda subject: subject.name)
def test_a_boot_with_one_failure_switches_nothing(subject: Subject):
    every = EVERY_SLOW if subject.case.variant in SLOW else EVERY
    verdicts = [(trial.name, run(trial)) for trial in trials(subject, every)]
    assert verdicts
    broken = [f"{name}: {sentence}" for name, verdict in verdicts for sentence in verdict.broken]
    assert not broken, "\n".join(broken[:10])

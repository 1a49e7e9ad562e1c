"""Silences the planner's logs while worlds run."""

import logging
from collections.abc import Iterator

import pytest

from tests.simulation.whole.planner_process import LOGS


@pytest.fixture(autouse=True)
def silent() -> Iterator[None]:
    levels = [log.level for log in LOGS]
    for log in LOGS:
        log.setLevel(logging.CRITICAL + 1)
    yield
    for log, level in zip(LOGS, levels, strict=True):
        log.setLevel(level)

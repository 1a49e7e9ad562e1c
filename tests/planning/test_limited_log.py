"""A log with a limit of a few lines a second."""

import logging

import pytest

from controller.planning.request_queue import MOST_LINES, LimitedLog


def test_of_a_flood_a_few_lines_are_written_and_the_others_counted(caplog: pytest.LogCaptureFixture) -> None:
    now = [10.0]
    log = LimitedLog(logging.getLogger("flood"), lambda: now[0])
    with caplog.at_level(logging.INFO, "flood"):
        for k in range(100):
            log.info("refused: %d", k)
        assert caplog.messages == [f"refused: {k}" for k in range(MOST_LINES)]
        now[0] += 1.0
        log.info("refused: last")
    assert caplog.messages[MOST_LINES:] == ["refused: last", f"{100 - MOST_LINES} lines like this were omitted before"]

"""A limit of log lines."""

import logging

from hyperbit.controller.panel.log_limit import MOST_LINES, WITHIN, LogLimit


def test_a_flood_writes_few_lines_and_hides_no_other_line() -> None:
    now, lines = [0.0], list[str]()
    limit = LogLimit(lambda: now[0])

    def say(text: str, *values: object) -> None:
        record = logging.LogRecord("panel", logging.WARNING, "", 0, text, values, None)
        if limit.filter(record):
            lines.append(record.getMessage())

    for k in range(8628):
        say("arm %s: not JSON", f"a{k}")
    say("another line")
    assert lines == [f"arm a{k}: not JSON" for k in range(MOST_LINES)] + ["another line"]
    now[0] += WITHIN
    say("arm %s: not JSON", "b")
    assert lines[-1] == f"arm b: not JSON ({8628 - MOST_LINES} such lines were dropped)"
    say("arm %s: not JSON", "c")
    assert lines[-1] == "arm c: not JSON"


def test_texts_that_differ_each_time_use_bounded_memory() -> None:
    limit = LogLimit()
    for k in range(3000):
        limit.filter(logging.LogRecord("panel", logging.WARNING, "", 0, f"text {k}", (), None))
    assert len(limit.kinds) <= 1000

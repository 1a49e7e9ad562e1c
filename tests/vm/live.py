"""A plugin of pytest that tells of failures and of times at once, not at the end, which a time-out may prevent."""

import pytest


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.duration > 5:
        print(f"\n{report.duration:.0f} s for {report.when} of {report.nodeid}", flush=True)
    if report.failed:
        print(f"\n{report.nodeid}, {report.when}:\n{report.longreprtext}\n{report.caplog}", flush=True)

"""A plugin of pytest that tells of a failure when it happens, not at the end, which a time-out may prevent."""

import pytest


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed:
        print(f"\n{report.nodeid}, {report.when}:\n{report.longreprtext}\n{report.caplog}", flush=True)

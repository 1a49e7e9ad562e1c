"""Each example of each page runs and prints the lines on the page."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.documents import page, running
from tests.system.stack import daemon
from tests.system.stack.processes import commands

PAGES = page.find()


@pytest.fixture(scope="module", autouse=True)
def folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name in ("CACHE", "STATE"):
            patch.setenv(f"XDG_{name}_HOME", str(tmp_path_factory.mktemp(name.lower())))
            patch.delenv(f"{name}_DIRECTORY", raising=False)
        yield


@pytest.fixture(scope="module")
def endpoint(folders, tmp_path_factory: pytest.TempPathFactory) -> Iterator[running.Daemon]:
    """Returns the endpoint of a daemon of an arm with simulated boards, started at the first use."""
    with ExitStack() as stack:

        @functools.cache
        def started(arm: Path) -> str:
            return stack.enter_context(daemon.running(arm, tmp_path_factory.mktemp("daemon")))

        def start(arm: Path) -> str:
            daemon.wait_until_ready(arm, started(arm))  # the previous example may have stopped the arm
            return started(arm)

        yield start


@pytest.mark.timeout(900)
@pytest.mark.parametrize("path", PAGES, ids=lambda path: page.read(path).name)
def test_the_examples_run(path, tmp_path, monkeypatch, endpoint):
    running.prepare(tmp_path, commands().script())
    monkeypatch.chdir(tmp_path)
    running.run(page.read(path), tmp_path, endpoint)

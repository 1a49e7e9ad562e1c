"""Each example of each page runs and prints the lines on the page."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hyperbit.controller.commands.common import arm_name
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.commands.operate import demo
from tests.documents import forks, page, running

PAGES = page.find()


@pytest.fixture(scope="module", autouse=True)
def folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name in ("CACHE", "STATE"):
            patch.setenv(f"XDG_{name}_HOME", str(tmp_path_factory.mktemp(name.lower())))
            patch.delenv(f"{name}_DIRECTORY", raising=False)
        yield


@pytest.fixture(scope="module")
def daemon(folders, tmp_path_factory: pytest.TempPathFactory) -> Iterator[running.Daemon]:
    """Returns the endpoint of a daemon of an arm with simulated boards, started at the first use."""
    with ExitStack() as stack:
        endpoints: dict[Path, tuple[subprocess.Popen[bytes], str]] = {}

        def start(arm: Path) -> str:
            if arm not in endpoints:
                endpoints[arm] = stack.enter_context(demo.started(arm, tmp_path_factory.mktemp("daemon")))
            process, endpoint = endpoints[arm]
            with connected(arm_name(str(arm)), endpoint, None) as client:
                demo.wait_until_ready(client, process.poll)  # the previous example may have stopped the arm
            return endpoint

        yield start


@pytest.fixture(scope="module")
def hyperbit(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with forks.forking(tmp_path_factory.mktemp("forks")) as script:
        yield script


@pytest.mark.timeout(900)
@pytest.mark.parametrize("path", PAGES, ids=lambda path: page.read(path).name)
def test_the_examples_run(path, tmp_path, monkeypatch, daemon, hyperbit):
    running.prepare(tmp_path, hyperbit)
    monkeypatch.chdir(tmp_path)
    running.run(page.read(path), tmp_path, daemon)

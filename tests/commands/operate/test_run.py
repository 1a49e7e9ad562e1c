"""The command `run`: what it sets in its process. What it serves is tested in tests/gateway and tests/system."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import zenoh

import hyperbit.controller.commands.operate.run as run_module
from hyperbit.controller import cli
from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.commands.operate import executor_process
from hyperbit.controller.gateway import daemon
from hyperbit.controller.host import signals

MEASURE = """
import re
import numpy as np
from pathlib import Path
from hyperbit.controller.commands.operate.run import return_large_blocks

def resident():
    return int(re.search(r"RssAnon:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024  # [MiB]

SETUP
np.ones(30 << 17)  # glibc keeps smaller blocks from now on
begun = resident()
blocks = [np.ones(1 << 17) for _ in range(40)]  # of 1 MiB
del blocks
print(resident() - begun)
"""


def left(setup: str) -> float:
    """Returns how much memory a process keeps that has freed 40 MiB in large blocks [MiB]."""
    words = [sys.executable, "-c", MEASURE.replace("SETUP", setup)]
    # Dask sets MALLOC_TRIM_THRESHOLD_ in a process that starts workers, as other tests do.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}
    return float(subprocess.run(words, capture_output=True, text=True, check=True, env=environment).stdout)


def test_large_blocks_are_returned_to_the_system() -> None:
    assert left("return_large_blocks()") < 8
    assert left("") > 30, "what this protects from is gone"


def test_a_daemon_whose_thread_has_died_ends_the_process_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextlib.contextmanager
    def failing(*_: object, **options: object) -> Iterator[daemon.Daemon]:
        made = daemon.Daemon()
        made.fail("the planner's thread for goals has ended: MemoryError()")
        yield made

    monkeypatch.setattr(daemon, "running", failing)
    monkeypatch.setattr(run_module, "load_wired", lambda file: SimpleNamespace(settings=SimpleNamespace(name="a")))
    monkeypatch.setattr(run_module, "densities_of", lambda arm: None)
    monkeypatch.setattr(signals, "end_on_signals", lambda end: None)
    file = tmp_path / "a.yaml"
    file.write_text("")
    executor = run_module.RunningExecutor(tmp_path / "a.sock", lambda: None)
    with pytest.raises(CommandFailed, match="thread for goals has ended: MemoryError\\(\\): the log has details"):
        run_module.serve(file, executor, zenoh.Config(), None, tmp_path / "l.sqlite", simulated=False)


@pytest.mark.parametrize(
    ("words", "port"),
    [
        (["arm.yaml"], None),
        (["arm.yaml", "--panel"], 7480),
        (["--panel", "arm.yaml"], 7480),
        (["arm.yaml", "--panel", "--simulate"], 7480),
        (["arm.yaml", "--panel", "7481", "--simulate"], 7481),
        (["arm.yaml", "--panel=0"], 0),
    ],
)
def test_the_port_of_the_page_may_be_left_out(
    monkeypatch: pytest.MonkeyPatch, words: list[str], port: int | None
) -> None:
    pages = list[int | None]()

    @contextlib.contextmanager
    def started_page(endpoint: str, panel: int | None) -> Iterator[None]:
        pages.append(panel)
        yield

    monkeypatch.setattr(run_module, "started_page", started_page)
    monkeypatch.setattr(run_module, "started_executor", lambda *_: contextlib.nullcontext())
    monkeypatch.setattr(run_module, "prepare_process", lambda: None)
    monkeypatch.setattr(run_module, "serve", lambda *_, **__: None)
    cli.app(["run", *words], standalone_mode=False)
    assert pages == [port]


def test_a_page_listens_at_the_given_port(monkeypatch: pytest.MonkeyPatch) -> None:
    commands = list[list[str]]()
    monkeypatch.setattr(executor_process, "start_child", commands.append)
    monkeypatch.setattr(executor_process, "end_child", lambda child: None)
    with run_module.started_page("tcp/0.0.0.0:7448", 7481), run_module.started_page("tcp/[::]:7449", None):
        pass
    (command,) = commands
    assert command[2:] == ["hyperbit", "panel", "--connect", "tcp/127.0.0.1:7448", "--listen", "127.0.0.1:7481"]

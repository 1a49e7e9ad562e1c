"""The command `run`: what it sets in its process. What it serves is tested in tests/gateway and tests/system."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

import controller.commands.operate.run as run_module
from controller.commands.common import CommandFailed
from controller.gateway import daemon

MEASURE = """
import re
import numpy as np
from pathlib import Path
from controller.commands.operate.run import return_large_blocks

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
    return float(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


def test_large_blocks_are_returned_to_the_system() -> None:
    assert left("return_large_blocks()") < 8
    assert left("") > 30, "what this protects from is gone"


def test_a_daemon_whose_thread_has_died_ends_the_process_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextlib.contextmanager
    def failing(*_: object) -> Iterator[daemon.Daemon]:
        made = daemon.Daemon()
        made.fail("the planner's thread for goals has ended: MemoryError()")
        yield made

    monkeypatch.setattr(daemon, "running", failing)
    monkeypatch.setattr(run_module, "load_wired", lambda file: SimpleNamespace(settings=SimpleNamespace(name="a")))
    monkeypatch.setattr(run_module, "densities_of", lambda arm: None)
    monkeypatch.setattr(run_module, "SIGNALS", ())
    file = tmp_path / "a.yaml"
    file.write_text("")
    executor = run_module.RunningExecutor(tmp_path / "a.sock", lambda: None)
    with pytest.raises(CommandFailed, match="thread for goals has ended: MemoryError\\(\\): the log has details"):
        run_module.serve(file, executor, "tcp/127.0.0.1:0", None, tmp_path / "l.sqlite")

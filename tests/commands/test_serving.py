"""The commands run, router, record and ros2: what they set, need and refuse."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

import hyperbit.controller.commands.operate.run as run_module
from hyperbit.controller import cli
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.commands.operate import executor_process
from hyperbit.controller.commands.operate.router import router_config
from hyperbit.controller.commands.serve import record, ros2
from hyperbit.controller.commands.serve.record import parse_size
from hyperbit.controller.gateway import daemon
from hyperbit.controller.host import signals
from hyperbit.controller.ros2.arm_node import ROSOUT, Settings
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.commands.conftest import Told
from tests.network.played import Router
from tests.waiting import PATIENCE, eventually

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


# Lines typed into the terminal of `run --simulate` reach the executor in its own process group.
PARENT = """
import os, subprocess, sys, threading
from hyperbit.controller.commands.operate.executor_process import pass_lines, start_child

if os.isatty(0):
    import fcntl, termios
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
child = start_child([sys.executable, "-c", "print(input(), input(), flush=True)"], stdin=subprocess.PIPE)
threading.Thread(target=pass_lines, args=(child.stdin,), daemon=True).start()
sys.exit(child.wait())
"""
LINES = b"silence can0/5\nhelp\n"


@pytest.mark.parametrize("kind", ["terminal", "pipe"])
def test_typed_lines_reach_the_child(kind: str) -> None:
    reader, writer = os.openpty()[::-1] if kind == "terminal" else os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", PARENT], stdin=reader, stdout=subprocess.PIPE, start_new_session=True
    ) as parent:
        os.close(reader)
        os.write(writer, LINES)
        out, _ = parent.communicate(timeout=60)
    os.close(writer)
    assert (parent.returncode, out) == (0, b"silence can0/5 help\n")


def test_a_port_that_is_taken_is_told(told: Told, stack: contextlib.ExitStack) -> None:
    endpoint = Router(stack).endpoint
    port = endpoint.rpartition(":")[2]
    assert f"port {port} of 127.0.0.1 is taken by " in told("router", "--listen", endpoint, code=1)


def test_a_router_joins_another() -> None:
    config = router_config("tcp/127.0.0.1:1", "tcp/127.0.0.1:2", None)
    assert (config.get_json("mode"), config.get_json("connect/endpoints")) == ('"router"', '["tcp/127.0.0.1:2"]')


@pytest.mark.parametrize(
    ("text", "size"), [("100000", 100_000), ("200M", 200 * 10**6), ("2g", 2 * 10**9), ("1T", 10**12), ("500k", 500_000)]
)
def test_sizes(text: str, size: int) -> None:
    assert parse_size(text, "--size") == size


@pytest.mark.parametrize("text", ["", "M", "-5M", "1.5G", "10", "2GB", "x", "٣M"])
def test_no_sizes(text: str) -> None:
    with pytest.raises(InputFaults):
        parse_size(text, "--size")


def printed(script: str) -> str:
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.strip()


def test_recording_needs_neither_kernels_nor_pictures() -> None:
    script = (
        "import sys, hyperbit.controller.commands.serve.record, hyperbit.controller.recorder.recorder\n"
        "import hyperbit.controller.network.listener\n"
        "print([name for name in ('numba', 'scipy', 'matplotlib', 'canopen', 'can') if name in sys.modules])"
    )
    assert printed(script) == "[]"


def test_the_planner_needs_no_board() -> None:
    script = (
        "import sys, hyperbit.controller.commands.operate.run, hyperbit.controller.gateway.daemon\n"
        "print([name for name in ('canopen', 'can', 'matplotlib', 'scipy.linalg') if name in sys.modules])"
    )
    assert printed(script) == "[]"


def test_the_daemon_needs_nothing_of_the_recorder() -> None:
    script = (
        "import sys\nsys.modules['mcap'] = None\n"
        "import hyperbit.controller.gateway.daemon, hyperbit.controller.executor.process.run\n"
        "import hyperbit.controller.commands.operate.run, hyperbit.controller.cli\n"
        "from hyperbit.controller.commands.serve.record import require\n"
        "print(any(name.startswith('hyperbit.controller.recorder') for name in sys.modules))"
    )
    assert printed(script) == "False"


def test_events_of_another_user_need_sudo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def deny(path: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(path))

    (tmp_path / "hyperbit-1001-planar16-executor-7.0.events").touch()
    (tmp_path / "hyperbit-1001-other-planar16-planner-7.0.events").touch()
    monkeypatch.setattr(record, "SHARED", tmp_path)
    assert record.record_events("planar16", tmp_path)[0] == []
    monkeypatch.setattr(record, "read_generation", deny)
    saved, missing = record.record_events("planar16", tmp_path)
    assert saved == []
    assert "the executor runs as another user: use sudo" in missing[0]


SETTINGS = Settings("", 0, "jazzy", "world", oriented=False)


@pytest.fixture
def router(stack: contextlib.ExitStack) -> Router:
    return Router(stack)


def test_a_second_bridge_of_one_name_is_refused_in_words(
    told: Told, router: Router, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros2, "GONE_WITHIN", 0.0)
    said: list[str] = []
    with Session(router.endpoint, PATIENCE) as session:
        other = Node(session, "hyperbit", "/planar16")
        other.subscriber("/rosout", "rcl_interfaces/msg/Log", lambda it: said.append(it.message.msg), ROSOUT)
        words = told("ros2", "planar16", "--connect", router.endpoint, "--ros", router.endpoint, code=1)
        assert "another node /planar16/hyperbit is there on domain 0" in words
        assert "--namespace" in words
        eventually(lambda: any("two bridges of one name" in it for it in said))


def test_a_bridge_waits_for_the_end_of_the_one_before(router: Router) -> None:
    """The token of a bridge that was killed stays for a while."""
    with Session(router.endpoint, PATIENCE) as session, Session(router.endpoint, PATIENCE) as own:
        other = Node(session, "hyperbit", "/planar16")
        eventually(own.tokens)
        ends = iter([other.close])  # its token may be seen a few times more
        process: Any = SimpleNamespace(wait=lambda: next(ends, lambda: time.sleep(0.05))())
        ros2.check_alone(own, "planar16", SETTINGS, cast("Any", process))
        assert own.tokens() == []


def test_a_namesake_of_another_namespace_or_domain_is_no_second_bridge(router: Router) -> None:
    def never() -> None:
        raise AssertionError("the bridge waits")

    with Session(router.endpoint, PATIENCE) as session, Session(router.endpoint, PATIENCE) as own:
        nodes = [Node(session, "hyperbit", "/other"), Node(session, "hyperbit", "/planar16", domain=7)]
        eventually(lambda: own.tokens(0) and own.tokens(7))
        process: Any = SimpleNamespace(wait=never)
        ros2.check_alone(own, "planar16", SETTINGS, process)
        assert len(nodes) == 2

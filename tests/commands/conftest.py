from __future__ import annotations

import math
import signal
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from hyperbit.controller import cli
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.commands.operate import demo
from hyperbit.controller.host.signals import ENDING
from hyperbit.drivers.canopen.tools import session
from tests.endpoints import free_endpoint
from tests.gateway.conftest import Gateway

Told = Callable[..., str]
ARM = Path(__file__).parents[2] / "deploy" / "planar16.yaml"


@pytest.fixture
def hyperbit(monkeypatch, capsys):
    """Runs the command in this process; returns exit code, stdout and stderr. This process keeps its signals."""

    def run(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["hyperbit", *words])
        handlers = {number: signal.getsignal(number) for number in ENDING}
        try:
            with pytest.raises(SystemExit) as ended:
                cli.main()
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        out, err = capsys.readouterr()
        return int(ended.value.code or 0), out, err

    return run


@pytest.fixture
def told(hyperbit) -> Told:
    """Runs the command in this process; it must end with an exit code. Returns its output on stderr."""

    def run(*words: str, code: int) -> str:
        ended, _, err = hyperbit(*words)
        assert ended == code, err
        return err

    return run


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    """The folder in which all commands keep densities."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def own_folders(monkeypatch, tmp_path, cache):
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def brief_listening(monkeypatch):
    """Commands listen for heartbeats for 50 ms only: for tests in which no heartbeat needs to be heard."""
    monkeypatch.setattr(session, "LISTEN", 0.05)
    monkeypatch.setattr(session, "PERIODS", 0.0)


@pytest.fixture
def spatial(tmp_path):
    turned = [0.0, math.sin(0.25), 0.0, math.cos(0.25)]
    states = [{"position": [0, 0, 0.1]}, {"position": [0.02, 0.0, 0.12], "orientation": turned}]
    states += [{"position": [0.0, 0.03, 0.11]}]
    file = tmp_path / "spatial.yaml"
    modules = [{"type": "transforms", "count": 6, "states": states}]
    file.write_text(yaml.safe_dump({"name": "s", "modules": modules, "tolerance": {"position": 0.01}}))
    return str(file)


@pytest.fixture(scope="session")
def endpoint(tmp_path_factory, cache):
    """Endpoint of a ready daemon with simulated boards, in its own process; each test leaves it ready."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(cache))
        started = demo.started(ARM, tmp_path_factory.mktemp("daemon"))
        with started as (_, endpoint):
            with connected("planar16", endpoint, None) as client:
                demo.wait_until_ready(client)
            yield endpoint


@pytest.fixture
def gateway():
    with ExitStack() as stack:
        yield Gateway(stack, free_endpoint())

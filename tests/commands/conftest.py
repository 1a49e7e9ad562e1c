from __future__ import annotations

import math
import signal
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from hyperbit.controller import cli
from hyperbit.controller.host.signals import ENDING
from hyperbit.drivers.canopen.tools import session
from hyperbit.drivers.simulation.dictionary import EDS
from tests.endpoints import free_endpoint
from tests.gateway.conftest import Gateway
from tests.keys import DEPLOY
from tests.recorder.samples import written
from tests.shared import shared_folder
from tests.system.stack import daemon

Told = Callable[..., str]
SHORT = "name: short\nmodules: [{type: vgt, count: 5, width: 0.2, lengths: [0.2, 0.25]}]\ntolerance: {position: 0.01}\n"
ARM = DEPLOY / "planar16.yaml"


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


@pytest.fixture
def own_folders(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared_folder() / "cache"))
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


@pytest.fixture
def folder(tmp_path: Path, own_folders: None, spatial: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory: arms, an EDS, and a recording without a description of its arm."""
    monkeypatch.chdir(tmp_path)
    for name, target in (("planar16.yaml", DEPLOY / "planar16.yaml"), ("deploy", DEPLOY), ("board.eds", EDS)):
        (tmp_path / name).symlink_to(target)
    (tmp_path / "short.yaml").write_text(SHORT)
    written(tmp_path / "a.mcap").close()
    return tmp_path


@pytest.fixture
def completed(hyperbit, monkeypatch):
    """Returns what bash is offered for the last of these words."""

    def complete(words: str) -> list[str]:
        monkeypatch.chdir(DEPLOY.parent)
        monkeypatch.setattr(cli.app, "_add_completion", True)
        monkeypatch.setenv("_HYPERBIT_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", f"hyperbit {words}")
        monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
        code, out, err = hyperbit()
        assert (code, err) == (0, "")
        return out.split()

    return complete


@pytest.fixture(scope="session")
def endpoint(tmp_path_factory):
    """Endpoint of a daemon; each test leaves it ready."""
    with daemon.running(ARM, tmp_path_factory.mktemp("daemon")) as endpoint:
        yield endpoint


@pytest.fixture
def gateway():
    with ExitStack() as stack:
        yield Gateway(stack, free_endpoint())

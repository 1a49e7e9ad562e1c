from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml

from controller import cli
from controller.commands.connection import connected
from controller.commands.operate import demo

ARM = Path(__file__).parents[2] / "deploy" / "planar16.yaml"


@pytest.fixture
def hyperbit(monkeypatch, capsys):
    """Runs the command in this process; returns exit code, stdout and stderr."""

    def run(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["hyperbit", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capsys.readouterr()
        return int(ended.value.code or 0), out, err

    return run


@pytest.fixture
def own_folders(monkeypatch, tmp_path):
    """Gives a test its own cache folder and ledger."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def spatial(tmp_path):
    """An arm of six spatial modules without boards."""
    turned = [0.0, math.sin(0.25), 0.0, math.cos(0.25)]
    states = [{"position": [0, 0, 0.1]}, {"position": [0.02, 0.0, 0.12], "orientation": turned}]
    states += [{"position": [0.0, 0.03, 0.11]}]
    file = tmp_path / "spatial.yaml"
    modules = [{"type": "transforms", "count": 6, "states": states}]
    file.write_text(yaml.safe_dump({"name": "s", "modules": modules, "tolerance": {"position": 0.01}}))
    return str(file)


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory):
    """Endpoint of a ready daemon with simulated boards, in its own process."""
    folder = tmp_path_factory.mktemp("daemon")
    with demo.started(ARM, folder) as (_, endpoint):
        with connected("planar16", endpoint, None) as client:
            demo.wait_until_ready(client)
        yield endpoint

"""Where `run` listens, and the router that it joins."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from hyperbit.controller.armfile.patience import patient_copy
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.commands.operate import demo
from hyperbit.controller.network.session import configuration
from tests.endpoints import free_endpoint
from tests.waiting import eventually

ARM = Path(__file__).parents[3] / "deploy" / "planar16.yaml"


@pytest.mark.parametrize(
    "words",
    [
        ("run", str(ARM), "--listen"),
        ("run", str(ARM), "--connect"),
        ("router", "--listen"),
        ("router", "--connect"),
        ("panel", "--connect"),
        ("ros2", "planar16", "--ros"),
        ("ros2", "planar16", "--connect"),
        ("record", "planar16", "--connect"),
        ("send", "planar16", "--to", "1,2", "--connect"),
        ("watch", "planar16", "--connect"),
        ("fleet", "--connect"),
        ("stop", "--all", "--connect"),
    ],
)
def test_each_command_refuses_what_is_no_endpoint(hyperbit, tmp_path, monkeypatch, words) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.chdir(tmp_path)
    code, out, err = hyperbit(*words, "127.0.0.1:7447")
    assert (code, out) == (2, "")
    assert "'127.0.0.1:7447' is no endpoint" in err


def test_a_daemon_joins_a_router_that_comes_later_and_again_after_its_loss(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "hyperbit", "run", str(patient_copy(ARM, tmp_path)), "--simulate"]
    command += ["--connect", endpoint, "--ledger", str(tmp_path / "ledger.sqlite")]
    environment = {**os.environ, "RUNTIME_DIRECTORY": str(tmp_path)}
    with ExitStack() as closing, (tmp_path / "log").open("w+") as log:
        daemon = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)
        closing.callback(daemon.wait, 60)
        closing.callback(daemon.terminate)
        eventually(lambda: "waiting for the Zenoh router" in (tmp_path / "log").read_text())
        for _ in range(2):
            with zenoh.open(configuration("router", listen=endpoint)), connected("planar16", endpoint, None) as client:
                eventually(client.alive)
                demo.wait_until_ready(client)
                result = client.run({"waypoints": [{"position": [0.5, 2.8]}]})
                assert result["status"] == "succeeded"
                client.request("goal", {"waypoints": [{"configuration": "0" * 15 + "2", "t": 1.0}]})
        with zenoh.open(configuration("router", listen=endpoint)), connected("planar16", endpoint, None) as client:
            eventually(client.alive)  # it has finished the goal without the router, or does so now
            eventually(lambda: client.next_message("state")["configuration"] == "0" * 15 + "2")


def test_a_router_and_a_configuration_exclude_each_other(hyperbit) -> None:  # type: ignore[no-untyped-def]
    code, _, err = hyperbit("run", str(ARM), "--connect", "tcp/127.0.0.1:1", "--zenoh", "zenoh.json5")
    assert (code, "give either --connect or --zenoh" in err) == (2, True)

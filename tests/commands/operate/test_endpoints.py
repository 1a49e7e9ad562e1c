"""Where `run` listens, and the router that it joins."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from hyperbit.controller.armfile.patience import patient_copy
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.commands.operate import demo
from hyperbit.controller.commands.operate.endpoints import address_of, owner_of, port_taken
from hyperbit.controller.network.session import configuration
from tests.waiting import eventually

ARM = Path(__file__).parents[3] / "deploy" / "planar16.yaml"


@pytest.mark.parametrize(
    ("endpoint", "address"),
    [
        ("tcp/127.0.0.1:7447", ("127.0.0.1", 7447)),
        ("tls/robot.local:7447#root_ca_certificate=ca.pem", ("robot.local", 7447)),
        ("tcp/[::1]:1?rel=1", ("::1", 1)),
        ("unixsock-stream/a.sock", None),
        ("tcp/127.0.0.1", None),
        ("tcp/127.0.0.1:seven", None),
    ],
)
def test_the_address_of_an_endpoint(endpoint: str, address: tuple[str, int] | None) -> None:
    assert address_of(endpoint) == address


def test_a_port_that_is_taken_is_told_with_its_process_and_both_ways_out() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        told = port_taken(f"tcp/127.0.0.1:{port}")
        assert (owner_of(port) or "").endswith(f"(process {os.getpid()})")
    assert told is not None
    assert told.startswith(f"port {port} of 127.0.0.1 is taken by ")
    assert f"--connect tcp/127.0.0.1:{port}" in told
    assert told.endswith(f"--listen tcp/127.0.0.1:{port + 1}")
    assert port_taken("unixsock-stream/a.sock") is None


def test_a_daemon_joins_a_router_that_comes_later_and_again_after_its_loss(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
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

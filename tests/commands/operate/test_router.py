"""The command `router`."""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack

import zenoh

from hyperbit.controller.commands.operate.router import router_config
from hyperbit.controller.network import session
from tests.endpoints import free_endpoint
from tests.keys import DEPLOY
from tests.network.played import Router
from tests.waiting import PATIENCE, eventually


def test_two_clients_meet_at_a_router_that_ends_by_sigterm():
    endpoint = free_endpoint()
    command = [sys.executable, "-m", "hyperbit", "router", "--listen", endpoint]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as routing:
        assert f"routing at {endpoint}" in routing.stderr.readline()
        one, other = (zenoh.open(session.configuration("client", connect=endpoint)) for _ in range(2))
        with one, other, one.liveliness().declare_token("hyperbit/a/alive"):
            eventually(lambda: [it for it in other.liveliness().get("hyperbit/*/alive") if it.ok])
        routing.terminate()
        assert routing.wait(PATIENCE) == 0


def test_a_port_that_is_taken_is_told(told):
    with ExitStack() as stack:
        endpoint = Router(stack).endpoint
        port = endpoint.rpartition(":")[2]
        assert f"port {port} of 127.0.0.1 is taken by " in told("router", "--listen", endpoint, code=1)


def test_a_file_of_another_mode_is_refused(told):
    assert 'mode: "router" is needed' in told("router", "--zenoh", str(DEPLOY / "zenoh.json5"), code=2)


def test_a_missing_certificate_is_named(told):
    refused = told("router", "--zenoh", str(DEPLOY / "zenoh-router.json5"), code=2)
    assert "root_ca_certificate: /run/credentials/hyperbit-router.service/hyperbit.ca.pem: No such file" in refused


def test_a_file_names_the_other_router_itself(told):
    words = ("--connect", "tcp/127.0.0.1:1", "--zenoh", str(DEPLOY / "zenoh.json5"))
    assert "give either --connect or --zenoh" in told("router", *words, code=2)


def test_a_router_joins_another():
    config = router_config("tcp/127.0.0.1:1", "tcp/127.0.0.1:2", None)
    assert config.get_json("mode") == '"router"'
    assert config.get_json("connect/endpoints") == '["tcp/127.0.0.1:2"]'

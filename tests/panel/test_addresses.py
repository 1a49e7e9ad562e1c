"""Addresses of the page, and the endpoint that `run` gives it."""

from pathlib import Path

import pytest

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.operate.run import reachable, run
from hyperbit.controller.panel.serve import parse_address, serve, zenoh_configuration


@pytest.mark.parametrize("text", ["", "7480", ":7480", "localhost", "localhost:x", "localhost:70000", "a:²"])
def test_addresses_are_read_strictly(text: str) -> None:
    with pytest.raises(InputFaults, match="HOST:PORT"):
        parse_address(text)


@pytest.mark.parametrize("host", ["0.0.0.0", "[::]", "192.168.1.2", "robot.local"])
def test_other_computers_need_tls(host: str) -> None:
    address = parse_address(f"{host}:7480")
    assert not address.local
    with pytest.raises(InputFaults, match="TLS is needed"):
        serve(address, None, None, zenoh_configuration(["tcp/127.0.0.1:1"], None), "hyperbit")


def test_addresses_of_this_computer() -> None:
    for text in ("127.0.0.1:1", "localhost:2", "[::1]:3", "127.1.2.3:4"):
        assert parse_address(text).local
    assert parse_address("[::1]:3").written(3, secure=True) == "https://[::1]:3/"


def test_run_gives_the_page_its_endpoint(tmp_path: Path) -> None:
    assert reachable("tcp/0.0.0.0:7447") == reachable("tcp/[::]:7447") == "tcp/127.0.0.1:7447"
    assert reachable("tcp/192.168.1.2:7448") == "tcp/192.168.1.2:7448"
    with pytest.raises(InputFaults, match="start the page separately"):
        run(tmp_path / "arm.yaml", zenoh_file=tmp_path / "zenoh.json5", panel=7480)

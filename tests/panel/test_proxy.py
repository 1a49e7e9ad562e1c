"""Addresses of the page, also behind a proxy, and the endpoint that `run` gives it."""

from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.operate.run import reachable, run
from hyperbit.controller.panel.access.access import Access
from hyperbit.controller.panel.app import PanelServer
from hyperbit.controller.panel.serve import parse_address, parse_public_address, serve, zenoh_configuration
from tests.panel.conftest import ORIGIN, PEOPLE, VIEWER

AT_ROOT, BELOW = "https://robot.local", "https://robot.local/hyperbit/"


def no_session() -> Any:
    """The server does not start here."""
    raise NotImplementedError


def browser(public: str | None) -> TestClient:
    """A browser of a page with this public address; the page serves HTTP, the proxy TLS."""
    address = None if public is None else parse_public_address(public)
    return TestClient(PanelServer(no_session, Access(PEOPLE), public=address).app, base_url=ORIGIN)


@pytest.mark.parametrize("host", ["robot.local", "127.0.0.1:7480"])  # a proxy keeps Host, or sends its own
@pytest.mark.parametrize("kept", ["", "/hyperbit"])  # a proxy takes the sub-path away, or not
def test_a_person_logs_in_through_a_proxy(host: str, kept: str) -> None:
    client, headers = browser(BELOW), {"host": host, "origin": "https://robot.local"}
    page = client.get(f"{kept}/", headers={"host": host})
    assert page.status_code == 200
    assert '<base href="/hyperbit/" />' in page.text
    assert client.get(f"{kept}/static/style.css", headers={"host": host}).status_code == 200
    answer = client.post(f"{kept}/session", json={"token": VIEWER}, headers=headers)
    assert answer.status_code == 200, answer.text
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith("__Secure-hyperbit=")
    assert {"Path=/hyperbit/", "Secure", "HttpOnly"} <= {part.strip() for part in cookie.split(";")}
    assert "strict-transport-security" not in answer.headers, "it would also bind other ports of this host"


def test_a_page_at_the_root_of_a_proxy_has_the_strictest_cookie() -> None:
    answer = browser(AT_ROOT).post("/session", json={"token": VIEWER}, headers={"origin": AT_ROOT})
    assert answer.headers["set-cookie"].startswith("__Host-hyperbit=")


@pytest.mark.parametrize("origin", ["https://evil.example", "http://robot.local", "https://robot.local:8443", "null"])
def test_other_origins_stay_refused(origin: str) -> None:
    headers = {"host": "robot.local", "origin": origin}
    assert browser(BELOW).post("/session", json={"token": VIEWER}, headers=headers).status_code == 403
    assert browser(BELOW).get("/", headers={"host": "evil.example"}).status_code == 400


def test_without_a_public_address_the_refusals_say_what_to_give() -> None:
    assert "--public" in browser(None).get("/", headers={"host": "robot.local"}).text
    assert "--public" in browser(None).post("/session", json={}, headers={"origin": AT_ROOT}).text


def test_public_addresses_are_read_strictly() -> None:
    for text in ("robot.local", "ftp://robot.local", "https://robot.local/?a", "https://", 'https://a/"', "https://A/"):
        with pytest.raises(InputFaults, match="--public"):
            parse_public_address(text)
    assert parse_public_address("https://robot.local:443/a/b") == ("https://robot.local", "/a/b/")
    assert parse_public_address("http://[::1]:81") == ("http://[::1]:81", "/")


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

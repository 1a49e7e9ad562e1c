"""The page behind a reverse proxy on the same computer, at the root and under a sub-path."""

from typing import Any

import pytest
from starlette.testclient import TestClient

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.panel.access.access import Access
from hyperbit.controller.panel.app import PanelServer
from hyperbit.controller.panel.serve import parse_public_address
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

"""Refused connections: no cookie, foreign origins and hosts, wrong methods and paths, large bodies."""

import pytest
from starlette.testclient import WebSocketDenialResponse
from starlette.websockets import WebSocketDisconnect

from hyperbit.controller.panel.app import STATIC
from tests.panel.conftest import ARM, OPERATOR, ORIGIN, SOCKETS, VIEWER, Opened, Site

FOREIGN = [
    "http://evil.example",
    "null",
    "https://127.0.0.1:7480",
    "http://127.0.0.1:7481",
    "http://localhost:7480",
    "",
]


def test_pages_without_a_cookie_get_no_data(site: Site) -> None:
    for cookie in (
        "",
        "hyperbit=anna.9999999999.0",
        "hyperbit=" + "x" * 3000,
        "hyperbit=..",
        "hyperbit=anna.9." + "0" * 64,
    ):
        with (
            site.browser.websocket_connect(
                f"{SOCKETS}/arms/{ARM}/live", headers={"origin": ORIGIN, "cookie": cookie}
            ) as socket,
            pytest.raises(WebSocketDisconnect) as closed,
        ):
            socket.receive_text()
        assert closed.value.code == 4401
    assert site.browser.get(f"/arms/{ARM}/density").status_code == 401
    assert site.browser.post(f"/arms/{ARM}/stop", headers={"origin": ORIGIN}).status_code == 403
    assert site.daemon.asked == []


@pytest.mark.parametrize("origin", FOREIGN)
def test_no_request_of_another_site_reaches_the_arm(site: Site, origin: str) -> None:
    headers = {**site.cookie(OPERATOR), "origin": origin}
    with (
        pytest.raises(WebSocketDenialResponse) as denied,
        site.browser.websocket_connect(f"{SOCKETS}/live", headers=headers),
    ):
        pass
    assert denied.value.status_code == 403
    answer = site.browser.post(f"/arms/{ARM}/stop", headers=headers)
    assert answer.status_code == 403
    assert answer.text.startswith("This request does not come from this page. ")
    assert site.browser.post("/session", json={"token": OPERATOR}, headers=headers).status_code == 403
    assert site.daemon.asked == []


def test_a_request_without_an_origin_changes_nothing(site: Site) -> None:
    headers = {"cookie": site.cookie(OPERATOR)["cookie"]}
    assert site.browser.post(f"/arms/{ARM}/stop", headers=headers).status_code == 403
    assert site.browser.get(f"/arms/{ARM}/stop", headers=headers).status_code == 405
    assert site.daemon.asked == []


def test_names_that_are_resolved_to_this_computer_are_refused(site: Site) -> None:
    for host in ("evil.example", "evil.example:7480", "127.0.0.1.evil.example", ""):
        answer = site.browser.get("/", headers={"host": host})
        assert answer.status_code == 400, host
    for host in ("localhost:9000", "127.0.0.1", "[::1]:7480"):
        assert site.browser.get("/", headers={"host": host}).status_code == 200


def test_a_stop_over_http_is_the_operators(site: Site) -> None:
    assert site.browser.post(f"/arms/{ARM}/stop", headers=site.cookie(VIEWER)).status_code == 403
    assert site.browser.post("/arms/nowhere/stop", headers=site.cookie(OPERATOR)).status_code == 503
    assert site.daemon.asked == []
    assert site.browser.post(f"/arms/{ARM}/stop", headers=site.cookie(OPERATOR)).json()["accepted"]
    assert site.daemon.commands() == ["stop"]


def test_a_stop_for_all_is_the_operators_and_names_the_arms(site: Site) -> None:
    assert site.browser.post("/stop", headers={"origin": ORIGIN}).status_code == 403
    assert site.browser.post("/stop", headers=site.cookie(VIEWER)).status_code == 403
    assert site.browser.get("/stop", headers=site.cookie(OPERATOR)).status_code == 405
    foreign = {**site.cookie(OPERATOR), "origin": "http://evil.example"}
    assert site.browser.post("/stop", headers=foreign).status_code == 403
    assert site.daemon.asked == []
    answer = site.browser.post("/stop", headers=site.cookie(OPERATOR)).json()
    assert answer == {"accepted": True, "message": f"stopped: {ARM}"}
    assert site.daemon.commands() == ["stop"]
    site.daemon.answer = {"accepted": False, "code": -1, "message": "the executor is away"}
    refused = {"accepted": False, "message": f"{ARM}: the executor is away; no arm has stopped"}
    assert site.browser.post("/stop", headers=site.cookie(OPERATOR)).json() == refused


def test_cookies_are_for_this_page_alone(site: Site) -> None:
    answer = site.browser.post("/session", json={"token": OPERATOR}, headers={"origin": ORIGIN})
    parts = {part.strip().lower() for part in answer.headers["set-cookie"].split(";")[1:]}
    assert {"httponly", "samesite=strict", "path=/"} <= parts
    assert answer.json() == {"name": "anna", "role": "operator"}
    gone = site.browser.delete("/session", headers={"origin": ORIGIN})
    assert 'hyperbit=""' in gone.headers["set-cookie"]


def test_wrong_tokens_lock_nobody_out(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    delays, wrong = list[float](), site.panel._wrong
    delay = wrong.delay

    def noted(address: str) -> float:
        delays.append(delay(address))
        return 0.0

    monkeypatch.setattr(wrong, "delay", noted)
    for k in range(12):
        answer = site.browser.post("/session", json={"token": f"guess {k}"}, headers={"origin": ORIGIN})
        assert (answer.status_code, answer.text) == (403, "This token is nobody's.\n")
    assert max(delays) > 1.0
    monkeypatch.undo()
    assert site.browser.post("/session", json={"token": OPERATOR}, headers={"origin": ORIGIN}).status_code == 200


def test_a_session_ends_at_log_out(site: Site) -> None:
    headers, other = site.cookie(OPERATOR), site.cookie(OPERATOR)
    page = Opened(site.enter(site.browser.websocket_connect(f"{SOCKETS}/arms/{ARM}/live", headers=headers)))
    page.until("you")
    assert site.browser.delete("/session", headers=headers).status_code == 204
    page.send("reset")
    assert page.closed() == 4401
    assert site.daemon.asked == []
    assert site.browser.get("/metrics", headers=headers).status_code == 401
    assert site.browser.get("/metrics", headers=other).status_code == 200, "another session of the same person"
    again = Opened(site.enter(site.browser.websocket_connect(f"{SOCKETS}/live", headers=headers)))
    assert again.closed() == 4401


def test_a_silent_page_closes_at_log_out(site: Site) -> None:
    headers = site.cookie(VIEWER)
    page = Opened(site.enter(site.browser.websocket_connect(f"{SOCKETS}/live", headers=headers)))
    site.browser.delete("/session", headers=headers)
    assert page.closed() == 4401


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b'"token"', b'{"token": 5}', b'{"token": "\xff"}', b"[" * 4000])
def test_malformed_tokens_are_nobodys(site: Site, body: bytes) -> None:
    answer = site.browser.post("/session", content=body, headers={"origin": ORIGIN})
    assert answer.status_code in (400, 403)
    assert "Traceback" not in answer.text


def test_large_bodies_are_refused(site: Site) -> None:
    answer = site.browser.post("/session", content=b" " * 5000, headers={"origin": ORIGIN})
    assert answer.status_code == 413
    chunks = (b" " * 1000 for _ in range(10))  # without a length
    assert site.browser.post("/session", content=chunks, headers={"origin": ORIGIN}).status_code == 413


@pytest.mark.parametrize(
    "path",
    [
        "/static/../app.py",
        "/static/%2e%2e/app.py",
        "/static/..%2fapp.py",
        "/static//etc/passwd",
        "/static/%2fetc/passwd",
        "/static/js/",
        "/static/js/main.js%00",
        "/arms/a%0d%0aset-cookie:x=1",
        "/arms/..%2f..",
        "/arms/<script>",
        "/etc/passwd",
        "/docs",
    ],
)
def test_other_addresses_do_not_exist(site: Site, path: str) -> None:
    answer = site.browser.get(path)
    assert answer.status_code == 404, answer.text
    assert "set-cookie" not in answer.headers
    assert "root:" not in answer.text


@pytest.mark.parametrize("method", ["PUT", "PATCH", "OPTIONS", "TRACE", "DELETE"])
def test_wrong_methods_are_refused(site: Site, method: str) -> None:
    for path in ("/", "/static/js/main.js", f"/arms/{ARM}"):
        answer = site.browser.request(method, path, headers={"origin": ORIGIN})
        assert answer.status_code == 405


def test_every_answer_is_shielded(site: Site) -> None:
    for path in ("/", f"/arms/{ARM}", "/static/js/main.js", "/nothing"):
        headers = site.browser.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "'unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "server" not in headers


def test_the_page_asks_no_other_server() -> None:
    for path in STATIC.rglob("*"):
        if path.is_file() and "vendor" not in path.parts and path.suffix != ".svg":
            text = path.read_text()
            assert "http://" not in text, path
            assert "https://" not in text, path
            assert "innerHTML" not in text, path


def test_metrics_need_a_token(site: Site) -> None:
    site.daemon.state()
    assert site.browser.get("/metrics").status_code == 401
    for word in ("Bearer wrong", f"Basic {VIEWER}", "Bearer"):
        assert site.browser.get("/metrics", headers={"authorization": word}).status_code == 401
    answer = site.browser.get("/metrics", headers={"authorization": f"Bearer {VIEWER}"})
    assert answer.status_code == 200
    assert f'arm="{ARM}"' in answer.text
    assert site.browser.get("/metrics", headers=site.cookie(VIEWER)).status_code == 200

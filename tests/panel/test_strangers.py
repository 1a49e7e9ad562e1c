"""What a stranger sends on an arm's keys takes nothing from a page; malformed messages harm their own section only."""

import json
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from hyperbit.controller.network import session
from tests.panel.conftest import ARM, OPERATOR, VIEWER, Site
from tests.strangers import KEYS, intrude
from tests.waiting import eventually


@pytest.fixture
def stranger(site: Site) -> Iterator[zenoh.Session]:
    with zenoh.open(session.configuration("client", connect=site.endpoint)) as opened:
        yield opened


@pytest.mark.parametrize("key", KEYS)
def test_no_message_takes_stop_from_a_page(site: Site, stranger: zenoh.Session, key: str) -> None:
    page, headers = site.open(), site.cookie(OPERATOR)
    you = page.until("you")
    intrude(stranger, f"hyperbit/{ARM}", [key])
    last = {"id": "last", "waypoint": 0, "waypoints": 1}
    stranger.put(f"hyperbit/{ARM}/feedback", json.dumps(last))
    page.until("goals", lambda told: any(goal["id"] == "last" for goal in told["goals"]))
    site.daemon.state(reason="still heard")
    page.until("state", lambda told: told["reason"] == "still heard")
    assert page.latest["you"] == you
    assert (you["stop"], you["replay"]) == (True, False)
    assert "timeline" not in page.latest
    assert page.ask("stop")["accepted"]
    assert site.browser.post(f"/arms/{ARM}/stop", headers=headers).json()["accepted"]
    assert site.daemon.commands() == ["stop", "stop"]
    assert site.open(VIEWER).until("presence")["alive"]


@pytest.mark.parametrize("answer", [b"", b"null", b"[]", b"{}", b"\xff", b'{"accepted": true, "name": 5}'])
def test_a_stranger_who_answers_takes_no_stop(site: Site, stranger: zenoh.Session, answer: bytes) -> None:
    """Its answer to a stop may come first. The stop reaches the daemon all the same."""

    def answered(query: zenoh.Query) -> None:
        with query:
            query.reply(str(query.key_expr), answer)

    queryable = stranger.declare_queryable(f"hyperbit/{ARM}/**", answered, complete=True)
    token = stranger.liveliness().declare_token(f"hyperbit/{ARM}/alive")
    page, headers = site.open(), site.cookie(OPERATOR)
    page.send("stop")
    eventually(lambda: "stop" in site.daemon.commands())
    site.daemon.asked.clear()
    site.browser.post(f"/arms/{ARM}/stop", headers=headers)
    eventually(lambda: "stop" in site.daemon.commands())
    token.undeclare()
    queryable.undeclare()  # type: ignore[no-untyped-call]
    site.daemon.state(reason="still heard")
    page.until("state", lambda told: told["reason"] == "still heard")
    assert page.ask("stop")["accepted"]
    assert page.until("presence")["alive"]


MALFORMED: list[dict[str, Any]] = [
    {"loop": [1], "buses": 3, "counts": {"a": 1}},
    {"boards": [[]], "loop": {"late_worst": "x"}},
]


@pytest.mark.parametrize("message", MALFORMED)
def test_malformed_diagnostics_are_not_shown(site: Site, message: dict[str, Any]) -> None:
    page = site.open()
    site.daemon.put("diagnostics", message)
    site.daemon.put("diagnostics", {"switches": 7})
    assert page.until("diagnostics")["switches"] == 7
    site.daemon.state()
    assert page.until("state")["mode"] == "ready"


def test_a_message_spoofs_no_other_section(site: Site) -> None:
    page = site.open()
    site.daemon.put("diagnostics", {"section": "state", "mode": "ready SPOOFED", "switches": 9})
    page.until("diagnostics", lambda told: told["switches"] == 9)
    site.daemon.state()
    assert page.until("state")["mode"] == "ready"


@pytest.mark.parametrize("faults", [3, [1], [{"code": "stuck"}], {"a": 1}])
def test_a_malformed_state_counts_as_not_heard(site: Site, faults: Any) -> None:
    page = site.open()
    site.daemon.state()
    page.until("state")
    view = site.panel.arms.views["planar16"]
    site.daemon.state(mode="stopped", faults=faults)
    page.until("presence", lambda told: told["age"] is not None and told["age"] > 1.0)
    assert view.state is not None
    assert view.state.mode == "ready"
    site.daemon.state(mode="executing")
    page.until("state", lambda told: told["mode"] == "executing")

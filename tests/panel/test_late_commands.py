"""Commands that come late: what can lead to motion is refused, a stop is carried out."""

import threading
from typing import Any

import pytest

from hyperbit.controller.panel.arms.heartbeats import LONGEST
from tests.panel.conftest import ARM, COMMANDS, GOAL, OTHER, Opened, Site
from tests.waiting import eventually

FREE = ("stop", "cancel", "take", "release", "plan", "file", "again")
MOVING = [(do, fields) for do, fields in COMMANDS if do not in FREE] + [("fault", {"fault": "silence can0/1"})]
EXEMPT = [(do, fields) for do, fields in COMMANDS if do in ("stop", "cancel")]


def heard(page: Opened) -> int:
    return int(page.until("heartbeat")["number"])


def accepted(page: Opened, do: str, fields: dict[str, Any]) -> bool:
    """Sends a command with the heartbeat of the next message; returns whether it was accepted."""
    page.heard()
    return bool(page.ask(do, **fields)["accepted"])


@pytest.mark.parametrize(("do", "fields"), MOVING)
def test_a_command_that_waited_in_the_network_is_refused(site: Site, do: str, fields: dict[str, Any]) -> None:
    page = site.open()
    pressed = heard(page)
    site.clock.now += LONGEST + 0.1
    answer = page.ask(do, **fields, heartbeat=pressed)
    assert (answer["accepted"], "too late" in answer["message"]) == (False, True)
    assert "look at the arm, then press again" in answer["message"]
    assert site.daemon.asked == []
    page.until("log", lambda told: any("anna sent a command, refused" in line["text"] for line in told["lines"]))
    assert site.panel.arms.views[ARM].control.described()["name"] is None, "it takes no control"
    if do != "pose":  # the fake daemon has no poses
        eventually(lambda: accepted(page, do, fields))
        assert len(site.daemon.asked) == 1


@pytest.mark.parametrize(("do", "fields"), MOVING)
def test_a_command_without_a_heartbeat_is_refused(site: Site, do: str, fields: dict[str, Any]) -> None:
    page = site.open()
    answer = page.ask(do, **fields, heartbeat=None)
    assert (answer["accepted"], "reload the page" in answer["message"]) == (False, True)
    assert site.daemon.asked == []


def test_a_heartbeat_of_another_page_is_none(site: Site) -> None:
    page, other = site.open(), site.open(OTHER)
    assert not page.ask("go", goal=GOAL, heartbeat=heard(other))["accepted"]
    assert site.daemon.asked == []


@pytest.mark.parametrize("heartbeat", ["old", None, 10**9])
@pytest.mark.parametrize(("do", "fields"), EXEMPT)
def test_a_stop_is_carried_out_however_late(
    site: Site, do: str, fields: dict[str, Any], heartbeat: int | str | None
) -> None:
    page = site.open()
    named = heard(page) if heartbeat == "old" else heartbeat
    site.clock.now += 3600.0
    assert page.ask(do, **fields, heartbeat=named)["accepted"]
    assert site.daemon.commands() == [do]


def test_a_command_that_waits_for_other_requests_is_refused(site: Site) -> None:
    page, answered = site.open(), threading.Event()
    others = site.panel._threads.others
    try:
        for _ in range(others._max_workers):
            others.submit(answered.wait)
        number = page.send("go", goal=GOAL)
        eventually(lambda: others._work_queue.qsize() == 1)  # it was received in time, and waits for a thread
        assert page.ask("stop")["accepted"]
        site.clock.now += LONGEST + 0.1
    finally:
        answered.set()
    answer = page.until("reply", lambda reply: reply["n"] == number)
    assert (answer["accepted"], "too late" in answer["message"]) == (False, True)
    assert site.daemon.commands() == ["stop"]


def test_heartbeats_come_while_nothing_happens(site: Site) -> None:
    page = site.open("viewer's token", "/live")
    first = heard(page)
    page.until("heartbeat", lambda told: told["number"] > first + 3)

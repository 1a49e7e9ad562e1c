"""Arms that come and go, and what pages show of an arm whose state is partly unknown."""

from typing import Any

import pytest
import zenoh

from hyperbit.controller.panel.arms import arm_view, arms
from tests.panel.conftest import ARM, VIEWER, Site
from tests.waiting import eventually


def come(site: Site, *names: str) -> list[Any]:
    liveliness = site.daemon.session.liveliness()
    tokens = [liveliness.declare_token(f"hyperbit/{name}/alive") for name in names]
    views = site.panel.arms.views
    eventually(lambda: all(name in views and views[name].alive for name in names))
    return tokens


def go(site: Site, tokens: list[zenoh.LivelinessToken]) -> None:
    for token in tokens:
        token.undeclare()
    eventually(lambda: sum(view.alive for view in site.panel.arms.views.values()) == 1)


def test_an_arm_takes_the_place_of_one_that_is_gone(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arms, "MOST_ARMS", 4)
    monkeypatch.setattr(arm_view, "SILENT", 0.0)
    go(site, come(site, "a1", "a2", "a3"))
    page = site.open(VIEWER, "/arms/a1/live")  # an arm that a page shows keeps its place
    page.until("presence")
    go(site, come(site, "b1", "b2"))
    late = come(site, "late")
    assert {ARM, "a1", "late"} <= set(site.panel.arms.views)
    go(site, late)
    assert len(site.panel.arms.views) == 4


def test_arms_that_are_there_keep_their_places(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arms, "MOST_ARMS", 3)
    monkeypatch.setattr(arm_view, "SILENT", 0.0)
    tokens = come(site, "a1", "a2")
    site.daemon.session.put("hyperbit/made-up/state", b"{}")
    site.daemon.state()
    eventually(lambda: site.panel.arms.views[ARM].state)
    assert set(site.panel.arms.views) == {ARM, "a1", "a2"}
    go(site, tokens)


def test_an_arm_that_is_opened_takes_the_place_of_one_that_no_page_shows(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arms, "MOST_ARMS", 3)
    tokens = come(site, "a1", "a2")
    shown = site.open(path=f"/arms/{ARM}/live")
    late = site.open(path="/arms/late/live")
    assert late.until("presence")["you"] != shown.until("presence")["you"]
    assert len(site.panel.arms.views) == 3
    assert {ARM, "late"} <= set(site.panel.arms.views)
    go(site, tokens)


def test_an_arm_that_found_no_place_gets_the_next_free_one(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arms, "MOST_ARMS", 2)
    monkeypatch.setattr(arm_view, "SILENT", 0.0)
    first = come(site, "a1")
    late = site.daemon.session.liveliness().declare_token("hyperbit/late/alive")
    eventually(lambda: "late" in site.panel.arms.alive)
    go(site, first)

    def seen() -> bool:
        site.daemon.session.put("hyperbit/late/state", b"{}")
        return "late" in site.panel.arms.views and site.panel.arms.views["late"].alive

    eventually(seen)
    go(site, [late])


def test_an_arm_that_is_gone_leaves_the_list_after_a_while(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arm_view, "SILENT", 0.0)
    go(site, come(site, "a1"))
    assert "a1" in [view.name for view in site.panel.arms.known()]
    monkeypatch.setattr(arms, "GONE_SHOWN", 0.0)
    eventually(lambda: set(site.panel.arms.views) == {ARM})


def test_the_last_known_pose_is_drawn_in_a_fault(site: Site) -> None:
    page = site.open()
    site.daemon.state(commanded=[1] * 48, measured=[1] * 48)
    known = page.until("bodies")
    assert known["unknown"] == []
    partly = [None] * 3 + [1] * 42 + [None] * 3
    site.daemon.state(mode="fault", commanded=None, measured=partly, configuration=None, tip=None)
    fault = page.until("bodies", lambda told: told["unknown"])
    assert fault["unknown"] == [0, 15]
    assert fault["measured"] == known["measured"]
    assert fault["commanded"] is None
    assert fault["last"] == [1] * 48
    site.daemon.state(mode="unknown", commanded=None, measured=[None] * 48, configuration=None, tip=None)
    lost = page.until("bodies", lambda told: len(told["unknown"]) == 16)
    assert lost["measured"] == known["measured"]


def test_unknown_actuators_are_guessed_from_what_is_known_of_their_module(site: Site) -> None:
    page = site.open()
    site.daemon.state(mode="fault", commanded=None, measured=[None, *[0] * 47], configuration=None, tip=None)
    partly = page.until("bodies", lambda told: told["unknown"] == [0])
    assert partly["last"][0] is None
    site.daemon.state()
    assert page.until("bodies", lambda told: told["unknown"] == [])["measured"] == partly["measured"]


def test_poses_that_another_client_saves_are_shown_at_once(site: Site) -> None:
    site.daemon.told["poses"] = [{"name": "home", "goal": {}}]
    page = site.open()
    site.daemon.state(poses=0)
    page.until("arm", lambda told: told["poses"])
    site.daemon.told["poses"] = [{"name": "home", "goal": {}}, {"name": "pick", "goal": {}}]
    site.daemon.state(poses=1)
    page.until("arm", lambda told: [pose["name"] for pose in told["poses"]] == ["home", "pick"])

"""Malformed messages of an arm harm the section they belong to, and no other."""

from typing import Any

import pytest

from tests.panel.conftest import Site

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
    site.daemon.put("diagnostics", {"section": "state", "mode": "ready SPOOFED"})
    page.until("diagnostics", lambda told: "mode" in told)
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
    assert view.state["mode"] == "ready"
    site.daemon.state(mode="executing")
    page.until("state", lambda told: told["mode"] == "executing")

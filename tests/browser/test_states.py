"""The page in a browser, with a fake daemon: unknown positions, and plans that are out of date."""

from typing import Any

import pytest

from tests.browser.conftest import OPERATOR, Shown, Trouble, eventually
from tests.browser.test_page import DRAWN, MEASURED

pytestmark = pytest.mark.timeout(600)

UNKNOWN = [163, 25, 91]  # light colour of style.css
COUNT = 48  # actuators
FAULT: dict[str, Any] = {
    "mode": "fault",
    "reason": "can0/1 is silent",
    "configuration": None,
    "tip": None,
    "commanded": None,
}


def opened(trouble: Trouble, driver: object, **fields: Any) -> Shown:
    """Opens the arm's page as an operator, and waits until it shows a state."""
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", OPERATOR)
    shown.one(".stage canvas")
    told(trouble, shown, **fields)
    return shown


def told(trouble: Trouble, shown: Shown, **fields: Any) -> None:
    """Publishes a state until the page shows it."""
    reason = fields.get("reason", "holding")

    def heard() -> bool:
        trouble.daemon.state(**fields)
        return shown.text("#reason") == reason

    eventually(heard, lambda: shown.text("header"))


def test_in_a_fault_the_last_known_pose_is_drawn_and_the_unknown_is_marked(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, commanded=[1] * COUNT, measured=[1] * COUNT, reason="all extended")
    eventually(lambda: shown.run(DRAWN, MEASURED) > 300)
    assert shown.run(DRAWN, UNKNOWN) == 0
    measured = [None if 6 <= k < 12 else 1 for k in range(COUNT)]
    told(trouble, shown, **FAULT, measured=measured)
    eventually(lambda: shown.run(DRAWN, UNKNOWN) > 50)
    assert shown.run(DRAWN, MEASURED) > 300
    assert len(shown.all(".cell.unknown")) == 6
    assert len(shown.all(".cell.extended:not(.unknown)")) == COUNT - 6, "what is known does not look contracted"
    shown.press(".cell.unknown")
    shown.says("#actuators .detail", "measured unknown, last known extended")
    told(trouble, shown, **FAULT, measured=measured)
    shown.picture("panel-fault.png")
    told(trouble, shown, **{**FAULT, "mode": "unknown", "reason": "no executor"}, measured=[None] * COUNT)
    eventually(lambda: shown.run(DRAWN, UNKNOWN) > 200)
    assert len(shown.all(".cell.unknown")) == COUNT

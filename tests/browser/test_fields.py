"""The page in a browser: what is typed into the goal's fields is what Go sends."""

from collections.abc import Callable
from typing import Any

import pytest
from selenium.webdriver import ActionChains
from selenium.webdriver.common.keys import Keys

from tests.browser.conftest import Trouble, World
from tests.browser.rig import Shown, enabled, eventually, opened, told

pytestmark = [pytest.mark.timeout(600), pytest.mark.usefixtures("heard")]
Page = Callable[..., Shown]

VALUES = "return [...document.querySelectorAll('#goal .fields input')].slice(0, 2).map((it) => it.value)"
FIELD = "#goal .fields label:nth-child({}) input"


def keys(shown: Shown, *words: str) -> None:
    """Types as an operator does, without a look at the fields."""
    ActionChains(shown.driver).send_keys(*words).perform()


def enter(shown: Shown, field: int) -> None:
    """Goes to a field by the mouse, and selects what it has."""
    shown.one(FIELD.format(field)).click()
    shown.run("document.activeElement.select()")


def last_goal(trouble: Trouble, kind: str) -> Any:
    return [payload for key, payload in trouble.daemon.asked if key == kind][-1]["waypoints"][0]


def test_the_next_field_keeps_what_is_typed(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, reason="fields")
    shown.one(FIELD.format(1)).click()
    keys(shown, "0.5", Keys.TAB, "2.8")
    eventually(lambda: enabled(shown))
    for field, text in ((1, "0.9"), (2, "2.6")):
        enter(shown, field)
        keys(shown, text)
        told(trouble, shown, reason=f"a state while a field is edited: {text}")
    eventually(lambda: enabled(shown))
    assert shown.run(VALUES) == ["0.9", "2.6"]
    assert last_goal(trouble, "plan")["position"] == [0.9, 2.6]
    enter(shown, 1)
    keys(shown, "0.7", Keys.TAB)
    assert shown.run("return document.activeElement === document.querySelector(arguments[0])", FIELD.format(2))


def test_go_sends_no_goal_while_a_field_is_empty(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, reason="an empty field")
    shown.one(FIELD.format(1)).click()
    keys(shown, "0.5", Keys.TAB, "2.8")
    eventually(lambda: enabled(shown))
    enter(shown, 1)
    keys(shown, Keys.BACKSPACE)
    shown.says("#goal .why", "no number")
    assert not enabled(shown)
    keys(shown, "0.6")
    eventually(lambda: enabled(shown))
    trouble.daemon.asked.clear()
    shown.press("#go")
    eventually(lambda: "goal" in trouble.daemon.commands() and last_goal(trouble, "goal")["position"] == [0.6, 2.8])


def test_the_stages_stay_open(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, reason="stages")
    shown.one(FIELD.format(1)).click()
    keys(shown, "0.5", Keys.TAB, "2.8")
    shown.press("#goal .plan summary")
    told(trouble, shown, reason="another state", obstacles=3)
    eventually(lambda: enabled(shown))
    assert shown.run("return document.querySelector('#goal .plan details').open")


def test_an_orientation_in_space_is_typed(page: Page, world: World) -> None:
    shown = page("mixed")
    shown.one("#goal .fields input").click()
    keys(shown, "0.1", Keys.TAB, "0.1", Keys.TAB, "2.5", Keys.TAB)
    shown.says("#goal .fields", "roll")
    keys(shown, "10")
    shown.says("#goal .why", "no number")
    keys(shown, Keys.TAB, "20", Keys.TAB, "-30")
    eventually(lambda: "no number" not in shown.text("#goal .why"))
    read = "return [...document.querySelectorAll('#goal .fields input')].slice(4, 7).map((it) => it.value)"
    assert shown.run(read) == ["10", "20", "-30"]


def test_the_refusal_of_a_goal_is_gone_while_the_next_one_is_planned(trouble: Trouble, driver: object) -> None:
    daemon = trouble.daemon
    shown, answer = opened(trouble, driver, reason="refused"), daemon.answer
    daemon.answer = {"accepted": False, "code": -2, "message": "(0.5, 9) is out of reach"}
    shown.one(FIELD.format(1)).click()
    keys(shown, "0.5", Keys.TAB, "9")
    shown.says("#goal .plan", "(0.5, 9) is out of reach")
    daemon.gate.clear()
    daemon.answer = answer
    enter(shown, 2)
    keys(shown, "2")
    shown.says("#goal .why", "Planning from the present state")
    assert shown.text("#goal .plan") == ""
    daemon.gate.set()
    eventually(lambda: enabled(shown))

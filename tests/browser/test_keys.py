"""The page by keys, by a screen reader and by touch. axe looks at each state."""

import json
from typing import Any

import pytest
from selenium.webdriver import ActionChains
from selenium.webdriver.common.keys import Keys

from tests.browser.conftest import Trouble
from tests.browser.rig import (
    COUNT,
    FAULT,
    OPERATOR,
    VIEWER,
    Shown,
    eventually,
    found,
    opened,
    planned,
    told,
    type_goal,
)

pytestmark = [pytest.mark.timeout(600), pytest.mark.usefixtures("heard")]

LOCKED = [{"actuator": "1.left", "state": 1}]


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (360, True)])
def test_axe_finds_nothing_in_any_state(trouble: Trouble, driver: object, width: int, dark: bool) -> None:
    shown = Shown(driver, trouble.url)
    wrong: dict[str, list[str]] = {}

    def look(state: str) -> None:
        if complaints := found(shown):
            wrong[state] = complaints

    def visit(path: str, token: str) -> None:
        shown.visit(path, token, width, 860, dark=dark)

    visit("/", "")
    shown.one("form input")
    look("login")
    visit("/", OPERATOR)
    shown.says(".arms", "planar16")
    look("list")
    visit("/arms/planar16", VIEWER)
    told(trouble, shown, reason="of a viewer")
    look("viewer")
    visit("/arms/planar16", OPERATOR)
    told(trouble, shown, reason="of an operator")
    shown.run("for (const it of document.querySelectorAll('details')) it.open = true")
    type_goal(shown, 0.4, 2.9)
    shown.says("#goal .plan", "switches")
    look("planned")
    shown.press("[data-mode=curve]")
    shown.press("#actuators .cell")
    told(trouble, shown, reason="locked", degraded=LOCKED)
    look("locked")
    told(trouble, shown, mode="executing", reason="to the goal", goal="g", target={"position": [0.4, 2.9]})
    look("executing")
    told(trouble, shown, mode="stopped", reason="by anna")
    look("stopped")
    lost = {"code": "board-lost", "source": "can0/1", "message": "silent"}
    told(trouble, shown, **{**FAULT, "measured": [None] * COUNT, "faults": [lost]})
    look("fault")
    told(trouble, shown, reason="for a stop")
    shown.run("window.fetch = () => new Promise(() => {}); WebSocket.prototype.send = () => {}")
    shown.one("#stop").click()
    shown.says(".unconfirmed", "STOP NOT CONFIRMED")
    look("unconfirmed")
    assert wrong == {}, json.dumps(wrong, indent=1)


def test_reset_and_jog_by_a_screen_reader(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, reason="by a screen reader")
    trouble.daemon.asked.clear()
    click = "document.querySelector(arguments[0]).click()"  # as assistive technology does: no pointer, no key

    def twice(css: str, command: str) -> None:
        shown.run(click, css)
        shown.says(".notice", "press and hold, or press again")
        shown.run(f"{click}; {click}", css)
        eventually(lambda: shown.run(click, css) or command in trouble.daemon.commands())

    twice("#reset", "reset")
    shown.run("document.querySelector('#actuators .grid').focus()")
    ActionChains(shown.driver).send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT).perform()
    active = shown.run("return document.querySelector('#actuators .grid').getAttribute('aria-activedescendant')")
    assert shown.run("return document.getElementById(arguments[0]).getAttribute('aria-selected')", active) == "true"
    twice("#jog", "jog")


def test_a_short_press_acts_only_with_a_second(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, reason="a short press")
    trouble.daemon.asked.clear()
    shown.run("document.querySelector('#reset').focus()")
    ActionChains(shown.driver).send_keys(Keys.SPACE, Keys.SPACE, Keys.ENTER).perform()
    shown.says(".notice", "press and hold, or press again")
    ActionChains(shown.driver).double_click(shown.one("#reset")).perform()
    told(trouble, shown, reason="after a double click")
    assert "reset" not in trouble.daemon.commands()


def test_the_focus_stays_where_a_lock_was_pressed(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, reason="a lock")
    shown.press("#actuators .cell")
    ActionChains(shown.driver).send_keys(Keys.TAB).perform()
    shown.run("document.querySelector('#jog + button').focus()")
    told(trouble, shown, reason="now locked", degraded=LOCKED)
    assert shown.run("return document.activeElement.textContent") == "Unlock"


def touch(shown: Shown, *points: tuple[float, float]) -> None:
    """Touches the page at the first point, moves to the others, and lets go."""
    send = shown.driver.execute_cdp_cmd
    for k, (x, y) in enumerate(points):
        send(
            "Input.dispatchTouchEvent", {"type": "touchMove" if k else "touchStart", "touchPoints": [{"x": x, "y": y}]}
        )
    send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def test_a_swipe_places_no_goal_and_a_tap_does(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", OPERATOR, 360, 740)
    shown.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    try:
        told(trouble, shown, reason="touched")
        box: Any = shown.run("return document.querySelector('.stage').getBoundingClientRect().toJSON()")
        x, y = box["left"] + box["width"] / 2, box["top"] + box["height"] / 2
        value = "return document.querySelector('#goal .fields input').value"
        touch(shown, *((x, y - k * 12) for k in range(12)))
        eventually(lambda: shown.run("return window.scrollY") > 40)
        assert shown.run(value) == ""
        shown.run("window.scrollTo(0, 0)")
        touch(shown, (x, y))
        eventually(lambda: shown.run(value) != "")
        before = shown.run(value)
        touch(shown, *((x + k * 8, y) for k in range(8)))
        eventually(lambda: shown.run(value) != before)
    finally:
        shown.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})


def test_a_goal_is_planned_by_keys(trouble: Trouble, driver: object) -> None:
    shown = planned(trouble, driver)
    before = shown.run("return document.querySelector('#goal .fields input').value")
    shown.run("document.querySelector('.stage canvas').focus()")
    ActionChains(shown.driver).send_keys(Keys.ARROW_RIGHT).perform()
    eventually(lambda: shown.run("return document.querySelector('#goal .fields input').value") != before)

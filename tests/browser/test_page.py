"""The page in a browser, on real arms with simulated boards: what an operator does with it."""

import json
import signal
from collections.abc import Callable

import pytest
from selenium.webdriver import ActionChains
from selenium.webdriver.common.keys import Keys

from tests.browser.conftest import World
from tests.browser.rig import DRAWN, MEASURED, OBSTACLE, OTHER, PLANNED, VIEWER, Shown, eventually, type_goal

pytestmark = pytest.mark.timeout(600)

Page = Callable[..., Shown]


def finished(shown: Shown) -> str:
    """The last goal once it has ended."""
    eventually(lambda: shown.text("#goals li") and "running" not in shown.text("#goals li"))
    return shown.text("#goals li")


def test_the_arm_is_shown(page: Page) -> None:
    shown = page()
    assert shown.text("#name") == "flat"
    eventually(lambda: shown.run(DRAWN, MEASURED) > 300)
    assert len(shown.all("#actuators .cell")) == 48
    shown.says("#boards", "can0", "connected", "operational" if shown.all("#boards .bad") else "●")
    shown.says("#control", "You are anna, operator")
    origins = shown.run("return performance.getEntriesByType('resource').map((entry) => new URL(entry.name).origin)")
    assert set(origins) == {shown.url}, "a page asks its own server only"
    assert shown.run("return location.hash + document.cookie") == "", "the token is neither seen nor read by scripts"


def test_a_goal_is_planned_by_a_click_and_reached_by_go(page: Page) -> None:
    shown = page()
    before = shown.text("#goals li")
    canvas = shown.one(".stage canvas")
    ActionChains(shown.driver).move_to_element_with_offset(canvas, 60, -150).click().perform()
    shown.says("#goal .plan", "switches", "stage")
    type_goal(shown, 0.55, 2.9)
    shown.says("#goal .plan", "switches", "stage")
    eventually(lambda: shown.run(DRAWN, PLANNED) > 100 and shown.one("#go").is_enabled())
    shown.picture("panel.png")
    shown.press("#go")
    eventually(lambda: shown.text("#goals li") != before)
    assert "succeeded" in finished(shown)
    shown.says("#goal .message", "succeeded")
    shown.says("#log", "anna asked for goal", "reached")
    shown.says("#wear", "switches in all")


def test_a_named_pose_is_saved_planned_and_removed(page: Page) -> None:
    shown = page()
    type_goal(shown, 0.55, 2.9)
    shown.says("#goal .plan", "switches", "stage")
    shown.press("#goal .poses summary")
    shown.says("#pose", "home")
    shown.says("#goal .poses .hint", "the goal above")
    shown.type("#pose-name", "pick")
    shown.press("#save-pose")
    shown.says("#pose", "home", "pick")
    shown.run("document.querySelector('#pose').value = 'home'")
    shown.press("#use-pose")
    shown.says("#goal .plan", "configuration 0000000000000000")
    shown.run("document.querySelector('#pose').value = 'pick'")
    shown.press("#use-pose")
    eventually(lambda: "configuration 0000000000000000" not in shown.text("#goal .plan"))
    shown.says("#goal .plan", "switches", "stage")
    shown.press("#remove-pose")
    eventually(lambda: "pick" not in shown.text("#pose"))
    shown.says("#log", "anna asked for poses", "saved pose 'pick'", "removed pose 'pick'")


def test_a_pose_takes_a_second_drag_and_a_curve_a_click_for_each_point(page: Page) -> None:
    shown = page()
    canvas = shown.one(".stage canvas")
    type_goal(shown, 0.4, 2.9)
    where = shown.run("""
        const box = document.querySelector('.stage canvas').getBoundingClientRect();
        return [box.width, box.height]""")
    assert min(where) > 100
    shown.says("#goal .fields", "orientation")
    shown.type("#goal .fields label:nth-child(3) input", "10")
    shown.says("#goal .plan", "switches", "certificate")
    shown.press("[data-mode=curve]")
    for right, down in ((-60, -150), (-110, -140), (-150, -100)):
        ActionChains(shown.driver).move_to_element_with_offset(canvas, right, down).click().perform()
    shown.says("#goal .fields", "Remove point 4")
    shown.press("#goal .buttons button:nth-child(3)")
    shown.says("#answer", "Click")


def test_stop_is_one_press_and_reset_is_held(page: Page) -> None:
    shown = page()
    shown.one("#stop").click()
    shown.says("#mode", "stopped")
    shown.one("#reset").click()
    shown.says("#mode", "stopped")
    shown.hold("#reset")
    shown.says("#mode", "ready")


def test_stop_and_reset_by_keys(page: Page) -> None:
    shown = page()
    ActionChains(shown.driver).send_keys(Keys.TAB, Keys.ENTER).perform()  # Stop comes first
    shown.says("#mode", "stopped")
    shown.run("document.querySelector('#reset').focus()")
    ActionChains(shown.driver).key_down(Keys.SPACE).pause(1.5).key_up(Keys.SPACE).perform()
    shown.says("#mode", "ready")


def test_an_actuator_is_jogged_while_a_button_is_held_and_locked(page: Page) -> None:
    shown = page()
    shown.press("#actuators .module:nth-child(16) .cell:nth-child(2)")
    before = shown.says("#actuators .detail", "16.left", "measured")
    to = "extended" if "measured contracted" in before else "contracted"
    shown.hold("#jog")
    shown.says("#actuators .detail", f"commanded {to}, measured {to}")
    assert "succeeded" in finished(shown)
    shown.press_named("#actuators .buttons button", f"Lock {to}")
    shown.says("#actuators .detail", f"locked {to}")
    eventually(lambda: "ready" in shown.text("#mode"))
    shown.press_named("#actuators .buttons button", "Unlock")
    eventually(lambda: "locked" not in shown.text("#actuators .detail"))
    shown.says("#mode", "ready")


def test_an_obstacle_is_drawn_and_taken_away(page: Page) -> None:
    shown = page()
    shown.press("[data-mode=obstacle]")
    canvas = shown.one(".stage canvas")
    chain = ActionChains(shown.driver).move_to_element_with_offset(canvas, 200, -60).click_and_hold()
    chain.move_by_offset(30, 15).move_by_offset(30, 15).release().perform()
    shown.says("#obstacles", "drawn-1", "box")
    eventually(lambda: shown.run(DRAWN, OBSTACLE) > 50)
    shown.press("#obstacles .remove")
    shown.says("#obstacles", "There are none")


def test_a_viewer_sees_all_and_moves_nothing(page: Page) -> None:
    shown = page(token=VIEWER)
    shown.says("#mode", "ready")
    shown.says("#control", "You are hall, viewer")
    assert not shown.one("#stop").is_enabled()
    assert not shown.one("#reset").is_enabled()
    assert not shown.one("#go").is_displayed()
    answer = shown.driver.execute_async_script("""
        const done = arguments[0];
        const socket = new WebSocket(location.href.replace('http', 'ws').replace(/#.*/, '') + '/live');
        socket.onopen = () => socket.send(JSON.stringify({do: 'stop', n: 1}));
        socket.onmessage = (event) => {
          const reply = JSON.parse(event.data).find((part) => part.section === 'reply');
          if (reply) { socket.close(); done(JSON.stringify(reply)); }
        };""")
    assert json.loads(answer)["message"] == "hall may look, not command"
    shown.says("#mode", "ready")


def test_a_simulated_arm_says_so_and_plays_faults(page: Page) -> None:
    choose = """
        const field = document.querySelector(`#play select[name=${arguments[0]}]`);
        if (![...field.options].some((option) => option.value === arguments[1])) return false;
        field.value = arguments[1];
        field.dispatchEvent(new Event('change'));
        return true;"""
    shown = page()
    eventually(lambda: shown.run("return document.querySelector('#simulated').checkVisibility()"))
    for verb, mode in (("silence", "fault"), ("unsilence", "ready")):
        eventually(lambda verb=verb: shown.run(choose, "verb", verb))
        eventually(lambda: shown.run(choose, "target", "can0/5"))
        shown.press_named("#play button", "Play")
        shown.says(".notice", f"done: {verb} can0/5")
        shown.says("#mode", mode)


def test_control_is_shown_and_taken(page: Page) -> None:
    shown = page(token=OTHER)
    shown.press("#take")
    shown.says("#control", "You have control")
    shown.says("#log", "bert took control")


def test_silence_is_shown_and_values_turn_grey(page: Page, world: World) -> None:
    shown = page()
    planner = world.planners["flat"]
    planner.send_signal(signal.SIGSTOP)
    try:
        shown.says("#silence", "nothing heard for 3 s")
        assert shown.run("return document.body.classList.contains('old')")
        assert "grayscale" in shown.run("return getComputedStyle(document.querySelector('.stage')).filter")
        assert shown.one("#stop").is_enabled()
    finally:
        planner.send_signal(signal.SIGCONT)
    eventually(lambda: not shown.run("return document.body.classList.contains('old')"))


def test_a_phone_has_all_of_it(page: Page) -> None:
    shown = page(width=360, height=740, dark=True)
    assert shown.run("return document.documentElement.scrollWidth") <= 360
    box = shown.run("return document.querySelector('#stop').getBoundingClientRect().toJSON()")
    assert box["height"] >= 44
    assert box["left"] >= 0
    assert box["right"] <= 360
    assert box["bottom"] <= 740
    shown.picture("panel-phone.png")
    shown.run("window.scrollTo(0, document.body.scrollHeight)")
    assert shown.run("return document.elementFromPoint(180, 715).id") == "stop"
    assert shown.text("#name") == "flat"
    shown.one("#stop").click()
    shown.says("#mode", "stopped")
    shown.hold("#reset")
    shown.says("#mode", "ready")


def test_a_spatial_arm_is_drawn_and_commanded(page: Page) -> None:
    shown = page("mixed", dark=True)
    canvas = shown.one(".stage canvas")
    assert shown.run("return document.querySelector('.stage canvas').getContext('webgl2') !== null")
    blank = len(canvas.screenshot_as_png)
    assert blank > 5000, "lines and points are drawn"
    home = shown.run("return document.querySelector('#reason').textContent")
    type_goal(shown, 0.0, 0.0, 0.0)
    shown.says("#goal .plan", "out of reach")
    assert home
    densest = shown.driver.execute_async_script("""
        const most = (points) => points.reduce((best, point) => (point[3] > best[3] ? point : best));
        fetch('/arms/mixed/density').then((answer) => answer.json()).then((points) => arguments[0](most(points)));""")
    type_goal(shown, *(round(x, 4) for x in densest[:3]))
    shown.says("#goal .plan", "switches", "certificate")
    shown.press("[data-mode=turn]")
    shown.says(".legend", "unit of the arm's file")
    shown.picture("panel-space.png")
    shown.press("#actuators .cell")
    shown.hold("#jog")
    eventually(lambda: "succeeded" in shown.text("#goals li"))


def test_the_list_leads_to_each_arm(page: Page, driver: object, world: World) -> None:
    shown = Shown(driver, world.url)
    shown.visit("/", VIEWER)
    eventually(lambda: len(shown.all(".arms li:not(.old)")) == 2)
    assert [entry.text.split()[:2] for entry in shown.all(".arms li")] == [
        ["flat", "simulated"],
        ["mixed", "simulated"],
    ]
    shown.press(".arms a")
    shown.says("#name", "flat")


def test_who_has_no_token_is_asked_for_one(page: Page, driver: object, world: World) -> None:
    shown = Shown(driver, world.url)
    shown.visit("/arms/flat", "")
    field = shown.one("form input")
    field.send_keys("wrong", Keys.ENTER)
    shown.says(".message", "nobody's")
    field.clear()
    field.send_keys(VIEWER, Keys.ENTER)
    shown.says("#control", "You are hall, viewer")
    shown.driver.get_log("browser")  # the browser notes the refusal itself

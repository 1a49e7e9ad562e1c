"""The page on screens of several sizes: what is visible together, and what a finger can touch."""

import pytest

from tests.browser.conftest import Trouble
from tests.browser.rig import OPERATOR, VIEWER, Shown, eventually, told, type_goal

pytestmark = [pytest.mark.timeout(600), pytest.mark.usefixtures("heard")]

BOX = "return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()"
LEAST_TOUCHED = 32.0  # pixels


def opened(trouble: Trouble, driver: object, width: int, height: int, token: str = OPERATOR) -> Shown:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", token, width, height)
    shown.one(".stage canvas")
    told(trouble, shown, reason=f"on {width} x {height}")
    return shown


@pytest.mark.parametrize(("width", "height"), [(360, 640), (360, 740), (800, 1000)])
def test_picture_go_and_stop_are_visible_together(trouble: Trouble, driver: object, width: int, height: int) -> None:
    shown = opened(trouble, driver, width, height)
    if width < 600:
        shown.run("document.querySelector('#goal').scrollIntoView()")
        type_goal(shown, 0.4, 2.9)
        shown.says(".go-bar", "3 switches")
        shown.run("window.scrollTo(0, 0)")
        told(trouble, shown, reason="a goal is planned")
    shown.picture(f"more/panel-{width}x{height}.png")
    stage, go, stop = (shown.run(BOX, css) for css in (".stage", "#go", "#stop"))
    assert stage["height"] >= 0.25 * height
    assert stage["width"] >= 0.9 * width, "no empty column"
    assert stage["bottom"] <= go["top"]
    assert go["bottom"] <= height
    assert go["bottom"] <= stop["top"] or stop["bottom"] <= stage["top"], "Stop is apart from Go"
    assert 0 <= stop["top"] < stop["bottom"] <= height
    assert shown.run("return document.documentElement.scrollWidth") <= width
    for box, name in ((go, "go"), (stop, "stop")):
        middle = (box["left"] + box["right"]) / 2, (box["top"] + box["bottom"]) / 2
        assert shown.run("return document.elementFromPoint(...arguments[0]).id", middle) == name


def test_a_finger_hits_one_actuator(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, 360, 740)
    shown.one("#actuators .cell")
    cell = shown.run(BOX, "#actuators .cell")
    assert min(cell["width"], cell["height"]) >= LEAST_TOUCHED
    shown.run("document.querySelector('#actuators').scrollIntoView()")
    told(trouble, shown, reason="at the actuators")
    shown.picture("more/panel-cells.png")


def test_a_viewer_has_no_bar_of_go(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, 360, 740, VIEWER)
    eventually(lambda: not shown.one(".go-bar").is_displayed())

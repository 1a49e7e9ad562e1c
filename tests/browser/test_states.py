"""The page in a browser, with a fake daemon: unknown positions, and plans that are out of date."""

import pytest

from tests.browser.conftest import Trouble
from tests.browser.rig import (
    BAD,
    COUNT,
    DRAWN,
    FAULT,
    MEASURED,
    PLANNED,
    UNKNOWN,
    enabled,
    eventually,
    opened,
    planned,
    told,
    type_goal,
)

pytestmark = [pytest.mark.timeout(600), pytest.mark.usefixtures("heard")]


def test_in_a_fault_the_last_known_pose_is_drawn_and_the_unknown_is_marked(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, commanded=[1] * COUNT, measured=[1] * COUNT, reason="all extended")
    eventually(lambda: shown.run(DRAWN, MEASURED) > 300)
    assert shown.run(DRAWN, UNKNOWN) == 0
    measured = [None if 6 <= k < 12 else 1 for k in range(COUNT)]
    lost = {"code": "board-lost", "source": "can0/1", "message": "silent"}
    told(
        trouble, shown, **{**FAULT, "reason": "stuck, too"}, measured=measured, faults=[lost, {**lost, "code": "stuck"}]
    )
    assert shown.one("#reset.wanted")
    told(trouble, shown, **FAULT, measured=measured, faults=[lost])
    assert not shown.all("#reset.wanted"), "a reset does not end this fault"
    eventually(lambda: shown.run(DRAWN, UNKNOWN) > 50)
    assert shown.run(DRAWN, MEASURED) > 300
    assert len(shown.all(".cell.unknown")) == 6
    assert len(shown.all(".cell.extended:not(.unknown)")) == COUNT - 6, "what is known does not look contracted"
    shown.press(".cell.unknown")
    shown.says("#actuators .detail", "measured unknown, last known extended")
    told(trouble, shown, **FAULT, measured=measured)
    shown.picture("more/panel-fault.png")
    told(trouble, shown, **{**FAULT, "mode": "unknown", "reason": "no executor"}, measured=[None] * COUNT)
    eventually(lambda: shown.run(DRAWN, UNKNOWN) > 200)
    assert len(shown.all(".cell.unknown")) == COUNT


def test_a_goal_is_planned_anew_when_another_client_has_moved_the_arm(trouble: Trouble, driver: object) -> None:
    shown = planned(trouble, driver)
    eventually(lambda: shown.run(DRAWN, PLANNED) > 600)
    plans = trouble.daemon.commands().count("plan")
    trouble.daemon.gate.clear()
    told(trouble, shown, configuration="0" * 15 + "7", reason="moved by somebody")
    shown.says("#goal .why", "Planning from the present state")
    assert not enabled(shown)
    eventually(lambda: shown.run(DRAWN, PLANNED) < 400)
    trouble.daemon.gate.set()
    eventually(lambda: enabled(shown) and shown.run(DRAWN, PLANNED) > 600)
    assert trouble.daemon.commands().count("plan") > plans
    plans = trouble.daemon.commands().count("plan")
    told(trouble, shown, configuration="0" * 15 + "7", reason="an obstacle came", obstacles=1)
    eventually(lambda: trouble.daemon.commands().count("plan") > plans and enabled(shown))


def test_go_waits_while_another_goal_runs_or_the_arm_is_not_ready(trouble: Trouble, driver: object) -> None:
    shown = planned(trouble, driver)
    told(trouble, shown, mode="executing", goal="of-another", reason="to the goal")
    shown.says("#goal .why", "of-another", "Hold now")
    assert not enabled(shown)
    assert shown.text("#goal .plan") == "", "the plan began in another state"
    eventually(lambda: shown.run(DRAWN, PLANNED) < 400)
    told(trouble, shown, mode="executing", goal="of-another", reason="to the goal")
    shown.picture("more/panel-other.png")
    told(trouble, shown, mode="stopped", reason="stopped by hall")
    shown.says("#goal .why", "stopped")
    assert not enabled(shown)
    told(trouble, shown, reason="ready again")
    eventually(lambda: enabled(shown))
    assert shown.text("#goal .why") == ""


def test_a_plan_tells_what_is_homed_first(trouble: Trouble, driver: object) -> None:
    trouble.daemon.homing = ["1.left", "1.right"]
    try:
        shown = planned(trouble, driver)
        shown.says("#goal .plan", "homing first", "2 more switches: 1.left, 1.right")
    finally:
        trouble.daemon.homing = []


def test_a_goal_that_cannot_be_planned_does_not_go(trouble: Trouble, driver: object) -> None:
    accepted = trouble.daemon.answer
    trouble.daemon.answer = {"accepted": False, "code": -2, "message": "waypoint 1, position: out of reach"}
    try:
        shown = opened(trouble, driver, reason="a goal far away")
        type_goal(shown, 9.0, 9.0)
        shown.says("#goal .plan", "✗ out of reach")
        shown.says("#goal .why", "cannot be planned")
        assert not enabled(shown)
        type_goal(shown, 0.4, 2.9)
        eventually(lambda: shown.run(DRAWN, BAD) > 30)  # the mark in the picture
        shown.says("#answer", "✗ out of reach")
        shown.picture("more/panel-refused.png")
        trouble.daemon.answer = {**trouble.daemon.answer, "message": "waypoint 1 to 2: 0.6 s"}
        shown.press_named(".tools button", "Curve")
        shown.press_named("#goal .fields button", "Add a point")
        shown.says("#answer", "✗ point 1 to 2: 0.6 s")
        asked = trouble.daemon.asked[-1][1]["waypoints"]
        assert [set(waypoint) for waypoint in asked] == [{"position"}] * 2, "the planner chooses the times"
        type_goal(shown, 0.9, 2.4)
        both = eventually(lambda: shown.run(DRAWN, PLANNED) < 30 and shown.run(DRAWN, BAD))
        trouble.daemon.answer = {**trouble.daemon.answer, "message": "waypoint 2: out of reach"}
        type_goal(shown, 1.4, 2.4)
        shown.says("#answer", "✗ point 2: out of reach")
        eventually(lambda: shown.run(DRAWN, PLANNED) > 30)  # point 1 is not refused
        assert 30 < shown.run(DRAWN, BAD) < both
    finally:
        trouble.daemon.answer = accepted


DROP = """
const data = new DataTransfer();
data.items.add(new File(["x;y\\n0.5;2.8\\n"], "goal.csv"));
document.querySelector('.view').dispatchEvent(new DragEvent('drop', {cancelable: true, dataTransfer: data}));
"""


def test_why_a_dropped_file_is_no_goal_is_in_sight(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, reason="a file is dropped")
    shown.run(DROP)
    shown.says("#answer", "✗ semicolons separate the columns")
    assert not shown.one(".legend .refused").is_displayed(), "no goal is drawn"


def test_a_goal_of_this_page_may_be_replaced(trouble: Trouble, driver: object) -> None:
    shown = planned(trouble, driver)
    trouble.daemon.asked.clear()
    shown.press("#go")
    goals = eventually(lambda: [payload for key, payload in trouble.daemon.asked if key == "goal"])
    told(trouble, shown, mode="executing", goal=goals[-1]["id"], reason="to my goal")
    shown.says("#goal .why", "Go replaces the running goal")
    assert enabled(shown)


def test_the_deviation_is_an_outline(trouble: Trouble, driver: object) -> None:
    pixel = """return document.querySelector('.stage canvas').getContext('2d')
        .getImageData(arguments[0], arguments[1], 1, 1).data"""
    trouble.daemon.planned = {"position": [0.4, 2.9], "excursion": 1.5}
    try:
        shown = planned(trouble, driver)
        shown.picture("more/panel-deviation.png")
    finally:
        trouble.daemon.planned = {}
    eventually(lambda: shown.run(DRAWN, PLANNED) > 600)
    box = shown.run("return document.querySelector('.stage').getBoundingClientRect().toJSON()")
    inside = shown.run(pixel, round(0.62 * box["width"]), round(0.22 * box["height"]))
    assert inside[3] == 0, "the region within the outline is not covered"
    shown.says(".legend", "lengths in m")
    marks = [mark.text for mark in shown.all(".legend .mark") if mark.is_displayed()]
    assert marks == ["measured", "planned", "greatest deviation on the way"], "only what the picture has"


def test_locks_of_one_kind_stand_together_with_one_advice(trouble: Trouble, driver: object) -> None:
    locks = [{"code": "degraded", "source": name, "message": f"{name} is locked"} for name in ("1.left", "7.right")]
    shown = opened(trouble, driver, reason="a long reason " * 40, faults=locks)
    shown.says("#faults", "1.left, 7.right", "1.left is locked", "7.right is locked")
    assert len(shown.all("#faults .advice")) == 1
    assert shown.run("return document.querySelector('header').offsetHeight") < 100, "the reason takes two lines"


def test_progress_and_remaining_time_of_a_goal_are_shown(trouble: Trouble, driver: object) -> None:
    shown = opened(trouble, driver, reason="before a goal")
    assert not shown.one(".progress").is_displayed()
    progress = {"waypoints": 5, "reached": 2, "begins": 90.0, "ends": 130.0}
    told(trouble, shown, mode="executing", goal="g", reason="on the way", stamp=100.0, progress=progress)
    shown.says(".progress", "2 of 5 points, ", "s left")
    eventually(lambda: 0.2 < shown.run("return document.querySelector('.progress progress').value") < 1.0)
    told(trouble, shown, mode="executing", goal="g", reason="late", stamp=140.0, progress=progress)
    shown.says(".progress", "s late")
    told(trouble, shown, reason="of an older daemon")
    assert not shown.one(".progress").is_displayed()

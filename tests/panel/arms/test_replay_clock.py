"""The clocks of a replayed recording, in the history of the page."""

from msgspec.structs import replace

from hyperbit.controller.messages.goals import Result
from hyperbit.controller.messages.state import State, Timeline
from hyperbit.controller.panel.arms.arm_history import ArmHistory
from hyperbit.controller.panel.arms.replay_clock import ReplayClock
from tests.clock import Clock
from tests.panel.conftest import Site

LINE = {"begin": 1000.0, "end": 1100.0, "at": 1010.0, "speed": 2.0, "paused": False}
TIMELINE = Timeline(**LINE)


def test_the_time_of_a_replay_follows_its_timeline() -> None:
    clock = Clock(5.0)
    replay = ReplayClock(clock)
    replay.hear(TIMELINE)
    clock.now += 3.0
    assert replay() == 1016.0
    assert replay.hear(replace(TIMELINE, at=1015.8)) is None
    assert replay.hear(replace(TIMELINE, at=1016.2)) is None
    assert replay.hear(replace(TIMELINE, at=1020.0, paused=True)) == "forward"
    clock.now += 100.0
    assert replay() == 1020.0
    assert replay.hear(replace(TIMELINE, at=1005.0)) == "back"
    clock.now += 100.0
    assert replay() == LINE["end"]


def test_the_history_of_a_replay_that_is_moved_back_ends_there() -> None:
    clock = Clock(5.0)
    history = ArmHistory(clock)
    history.goal("a", 1)
    clock.now = 10.0
    history.result(Result(id="a", status="succeeded", error=0.1))
    history.goal("b", 1)
    clock.now = 7.0
    history.rewind()
    assert [(goal["id"], goal["status"]) for goal in history.goals] == [("a", "running")]
    assert list(history.lines) == list(history.errors) == []


def test_goals_that_end_in_a_skipped_part_of_a_replay_do_not_stay_running() -> None:
    history = ArmHistory(Clock())
    history.goal("ended", 1)
    history.result(Result(id="ended", status="succeeded"))
    for name in ("skipped", "running"):
        history.goal(name, 2)
    history.skip()
    history.state(State(mode="executing", reason="goal running", goal="running"))
    status = {goal["id"]: (goal["status"], goal.get("message")) for goal in history.goals}
    assert status == {
        "ended": ("succeeded", ""),
        "skipped": ("skipped", "its end is in a skipped part of the recording"),
        "running": ("running", None),
    }
    history.result(Result(id="skipped", status="succeeded", message="reached"))
    assert history.goals[1]["status"] == "succeeded"


def test_a_goal_that_was_skipped_runs_again_when_the_replay_is_moved_back() -> None:
    clock = Clock(5.0)
    history = ArmHistory(clock)
    history.goal("a", 1)
    clock.now = 50.0
    history.skip()
    clock.now = 6.0
    history.rewind()
    assert [(goal["id"], goal["status"], goal.get("message")) for goal in history.goals] == [("a", "running", None)]


def test_the_page_marks_goals_that_a_replay_has_skipped(past: Site) -> None:
    page = past.open()
    past.daemon.put("timeline", {**LINE, "paused": True})
    past.daemon.put("feedback", {"id": "a", "waypoint": 0, "waypoints": 2})
    page.until("goals", lambda told: told["goals"] and told["goals"][0]["status"] == "running")
    past.daemon.put("timeline", {**LINE, "at": 1090.0, "paused": True})
    page.until("goals", lambda told: told["goals"][0]["status"] == "skipped")


def test_goals_and_log_of_a_replay_have_the_times_of_the_recording(past: Site) -> None:
    page = past.open()
    past.daemon.put("feedback", {"id": "early", "waypoint": 0, "waypoints": 2})
    page.until("goals", lambda told: told["goals"])
    past.daemon.put("timeline", {**LINE, "paused": True})
    page.until("goals", lambda told: told["goals"] and told["goals"][0]["at"] == LINE["at"])
    past.daemon.put("result", {"id": "past", "status": "succeeded", "message": "reached"})
    goal = page.until("goals", lambda told: len(told["goals"]) == 2)["goals"][-1]
    assert goal["at"] == goal["ended"] == LINE["at"]
    assert {line["at"] for line in page.until("log")["lines"]} == {LINE["at"]}
    past.daemon.put("timeline", {**LINE, "at": 1000.0, "paused": True})
    page.until("goals", lambda told: not told["goals"])

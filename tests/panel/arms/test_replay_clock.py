"""The clocks of a replayed recording, in the history of the page."""

from controller.panel.arms.arm_history import ArmHistory
from controller.panel.arms.replay_clock import ReplayClock
from tests.panel.conftest import Site

LINE = {"begin": 1000.0, "end": 1100.0, "at": 1010.0, "speed": 2.0, "paused": False}


class Clock:
    def __init__(self) -> None:
        self.now = 5.0

    def __call__(self) -> float:
        return self.now


def test_the_time_of_a_replay_follows_its_timeline() -> None:
    clock = Clock()
    replay = ReplayClock(clock)
    assert not replay.hear(LINE)
    clock.now += 3.0
    assert replay() == 1016.0
    assert not replay.hear({**LINE, "at": 1015.8})
    assert not replay.hear({**LINE, "at": 1020.0, "paused": True})
    clock.now += 100.0
    assert replay() == 1020.0
    assert replay.hear({**LINE, "at": 1005.0})
    clock.now += 100.0
    assert replay() == LINE["end"]


def test_the_history_of_a_replay_that_is_moved_back_ends_there() -> None:
    clock = Clock()
    history = ArmHistory(clock)
    history.goal("a", 1)
    clock.now = 10.0
    history.result({"id": "a", "status": "succeeded", "error": 0.1})
    history.goal("b", 1)
    clock.now = 7.0
    history.rewind()
    assert [(goal["id"], goal["status"]) for goal in history.goals] == [("a", "running")]
    assert list(history.lines) == list(history.errors) == []


def test_goals_and_log_of_a_replay_have_the_times_of_the_recording(site: Site) -> None:
    page = site.open()
    site.daemon.put("feedback", {"id": "early", "waypoint": 0, "waypoints": 2})
    page.until("goals", lambda told: told["goals"])
    site.daemon.put("timeline", {**LINE, "paused": True})
    page.until("goals", lambda told: told["goals"] and told["goals"][0]["at"] == LINE["at"])
    site.daemon.put("result", {"id": "past", "status": "succeeded", "message": "reached"})
    goal = page.until("goals", lambda told: len(told["goals"]) == 2)["goals"][-1]
    assert goal["at"] == goal["ended"] == LINE["at"]
    assert {line["at"] for line in page.until("log")["lines"]} == {LINE["at"]}
    site.daemon.put("timeline", {**LINE, "at": 1000.0, "paused": True})
    page.until("goals", lambda told: not told["goals"])

"""Recorded goals on a simulated arm: the same configurations, or a sentence on the difference."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from hyperbit.controller.arm.arm import load
from hyperbit.controller.network.listener import Listener
from hyperbit.controller.recorder.folder import Folder
from hyperbit.controller.recorder.history import RecordedChange, RecordedGoal, history
from hyperbit.controller.recorder.reader import RecordingReader
from hyperbit.controller.recorder.recorder import Limits, Recorder
from hyperbit.controller.recorder.regression import Compared, arm_file, compare, compared, simulated
from hyperbit.controller.recorder.repair import BadRecording
from tests.keys import DEPLOY
from tests.recorder.samples import heard
from tests.told import arm as planar
from tests.told import described
from tests.waiting import eventually

GOAL = {"waypoints": [{"position": [0.5, 2.8]}]}


def recorded(folder: Path, fill: Callable[[Recorder], None], arm: dict[str, Any] | None = None) -> Path:
    began: list[Path] = []
    place = Folder(folder, "planar16")
    recorder = Recorder("planar16", place, Limits(10**9, 10**9), began=began.append)
    recorder.receive_message(heard(0.0, "arm", arm or described(planar())))
    fill(recorder)
    recorder.end_recording()
    place.close()
    return began[0]


def outcomes(path: Path) -> list[Compared]:
    past, found = RecordingReader(path), list[Compared]()
    compare(past, None, found.append)
    past.close()
    return found


@pytest.mark.timeout(900)
def test_goals_of_a_recording_lead_to_the_same_configurations_again(tmp_path: Path) -> None:
    document = yaml.safe_load((DEPLOY / "planar16.yaml").read_text())
    file = tmp_path / "planar16.yaml"
    file.write_text(yaml.safe_dump({**document, "method": "ipop-previous"}))  # no search that time ends
    empty = RecordingReader(recorded(tmp_path / "empty", lambda recorder: None, described(load(file))))
    place, began = Folder(tmp_path / "lived", "planar16"), list[Path]()
    recorder = Recorder("planar16", place, Limits(10**9, 10**9), began=began.append)
    ending = threading.Event()
    with simulated(empty, None) as arm:
        listener = Listener(arm._client._session, "planar16")
        thread = threading.Thread(target=recorder.run, args=(listener, ending.is_set, lambda: None))
        thread.start()
        try:
            arm.wait_ready()
            eventually(lambda: recorder.description)
            waypoints = [{"t": 0.5 * k, "position": [0.5 + 0.1 * k, 2.8]} for k in range(3)]
            ids = {"one", "many", "locked", "after locked", "around", "after around"}  # goals with a result
            assert arm.run({"id": "one", **GOAL})[0]["status"] == "succeeded"
            assert arm.run({"id": "far", "waypoints": [{"position": [9.0, 9.0]}]})[0]["code"] == -5
            assert arm.run({"id": "many", "waypoints": waypoints})[0]["status"] == "succeeded"
            for key, payload in (
                ("degrade", {"actuator": "3.left", "state": 0}),
                ("obstacles", {"regions": [{"disc": {"centre": [3.0, 3.0], "radius": 0.2}}]}),
            ):
                name = "locked" if key == "degrade" else "around"
                assert arm.ask(key, payload)["accepted"]
                arm.wait_ready(600.0)
                assert arm.run({"id": name, "waypoints": [{"position": [0.3, 2.9]}]})[0]["status"] == "succeeded"
                goal = {"id": f"after {name}", "waypoints": [{"position": [0.6, 2.8]}]}
                assert arm.run(goal)[0]["status"] == "succeeded"
            path = began[0]

            def noted() -> bool:
                recorder_has = RecordingReader(path)
                return {
                    goal.id for goal in history(recorder_has) if isinstance(goal, RecordedGoal) and goal.result
                } == ids

            eventually(noted, every=0.5)
        finally:
            ending.set()
            thread.join()
            listener.close()
            recorder.end_recording()
    found = outcomes(path)
    assert [it for it in found if it.outcome != "equal"] == []
    assert len(found) == 7


class Played:
    def __init__(self, result: dict[str, Any], reached: dict[int, str | None], *, there: bool = True) -> None:
        self.result, self.reached, self.there = result, reached, there
        self.sent: list[dict[str, Any]] = []

    def bring(self, configuration: str) -> bool:
        return self.there

    def run(self, goal: dict[str, Any]) -> tuple[dict[str, Any], dict[int, str | None]]:
        self.sent.append(goal)
        return self.result, self.reached


DONE = {"status": "succeeded", "configuration": "11", "certificate": "optimal"}
ONCE = RecordedGoal("a", 100.0, GOAL, True, "00", False, {0: "11"}, DONE)


@pytest.mark.parametrize(
    ("changes", "played", "outcome", "reason"),
    [
        ({}, Played(DONE, {0: "11"}), "equal", ""),
        ({}, Played(DONE, {0: "12"}), "differs", "waypoint 1: 11 then, 12 now"),
        ({}, Played({**DONE, "certificate": "bound"}, {0: "12"}), "unproven", "waypoint 1: 11 then, 12 now"),
        ({"result": {**DONE, "certificate": "bound"}}, Played(DONE, {0: "12"}), "unproven", "waypoint 1"),
        ({}, Played({**DONE, "configuration": "12"}, {0: "11"}), "differs", "at the end: 11 then, 12 now"),
        ({}, Played({"status": "aborted", "message": "stuck"}, {}), "differs", "it succeeded then, now: stuck"),
        ({}, Played({"accepted": False, "message": "out of reach"}, {}), "differs", "then, now: out of reach"),
        ({}, Played(DONE, {}, there=False), "skipped", "does not reach its start 00"),
        ({"accepted": False, "result": None}, Played({"accepted": False}, {}), "equal", ""),
        ({"accepted": False, "result": None}, Played(DONE, {}), "unproven", "it was refused then, and is accepted now"),
        ({"result": {**DONE, "status": "canceled"}}, Played(DONE, {}), "skipped", "it ended as canceled"),
        ({"result": None}, Played(DONE, {}), "skipped", "the recording ends before its result"),
        ({"start": None}, Played(DONE, {}), "skipped", "the configuration before it is unknown"),
        ({"moving": True}, Played(DONE, {}), "skipped", "while the arm moved"),
        ({"result": {**DONE, "bias": [0.0, 0.01]}}, Played(DONE, {}), "skipped", "measured tips corrected it"),
    ],
)
def test_a_goal_is_compared_with_its_recording(
    changes: dict[str, Any], played: Played, outcome: str, reason: str
) -> None:
    found = compared(played, ONCE._replace(**changes), anytime=True)  # type: ignore[arg-type]
    assert (found.id, found.outcome) == ("a", outcome)
    assert reason in found.reason


def test_a_search_without_end_has_no_excuse() -> None:
    played = Played({**DONE, "certificate": "bound"}, {0: "12"})
    refused = ONCE._replace(accepted=False, result=None)
    for goal in (ONCE, refused):
        assert compared(played, goal, anytime=False).outcome == "differs"  # type: ignore[arg-type]


def test_a_stamp_is_as_far_ahead_as_it_was() -> None:
    played, before = Played(DONE, {0: "11"}), time.time()
    compared(played, ONCE._replace(payload={**GOAL, "stamp": 103.0}), anytime=True)  # type: ignore[arg-type]
    assert before + 3.0 <= played.sent[0]["stamp"] <= time.time() + 3.0


def test_the_history_is_read_in_the_order_of_requests(tmp_path: Path) -> None:
    def fill(recorder: Recorder) -> None:
        locked = [{"actuator": "1.left", "state": 1}]
        recorder.receive_message(
            heard(1.0, "state", {"stamp": 1.0, "mode": "ready", "configuration": "A", "degraded": locked})
        )
        recorder.receive_message(heard(2.1, "state", {"stamp": 2.1, "mode": "executing", "configuration": "A"}))
        recorder.receive_message(heard(2.2, "result", {"id": "x", "status": "succeeded", "configuration": "B"}))
        recorder.receive_message(heard(2.25, "result", {"id": "x", "status": "succeeded", "repeated": True}))
        answer = {"accepted": True, "id": "x"}
        recorder.receive_message(
            heard(2.3, "request", {"stamp": 2.0, "key": "goal", "payload": GOAL, "answer": answer})
        )
        recorder.receive_message(
            heard(2.4, "request", {"stamp": 2.15, "key": "goal", "payload": GOAL, "answer": answer})
        )
        recorder.receive_message(
            heard(3.0, "request", {"stamp": 2.9, "key": "degrade", "payload": {"a": 1}, "answer": answer})
        )
        recorder.receive_message(
            heard(3.1, "request", {"stamp": 3.0, "key": "stop", "payload": None, "answer": answer})
        )
        refused = {"accepted": False, "id": "y", "code": -5}
        recorder.receive_message(
            heard(3.2, "request", {"stamp": 3.1, "key": "goal", "payload": GOAL, "answer": refused})
        )
        recorder.receive_message(
            heard(3.3, "request", {"stamp": 3.2, "key": "goal", "payload": None, "answer": refused})
        )

    lock, first, second, change, far = history(RecordingReader(recorded(tmp_path, fill)))
    assert lock == RecordedChange("degrade", {"actuator": "1.left", "state": 1})
    assert isinstance(first, RecordedGoal)
    assert isinstance(second, RecordedGoal)
    assert isinstance(far, RecordedGoal)
    assert (first.start, first.moving, first.incomparable) == ("A", False, None)
    assert second.incomparable == "it began while the arm moved"
    assert (first.result or {})["configuration"] == "B"
    assert second.result is None, "a repeated result belongs to no other goal"
    assert change == RecordedChange("degrade", {"a": 1})
    assert (far.accepted, far.incomparable) == (False, None)


def test_a_recorded_file_cannot_be_written_elsewhere(tmp_path: Path) -> None:
    arm = described(planar())
    arm["file"]["tables"] = {"../evil.csv": "x"}
    with pytest.raises(BadRecording, match=r"evil\.csv"):
        arm_file(RecordingReader(recorded(tmp_path / "a", lambda _: None, arm)), tmp_path)
    arm["file"]["tables"], arm["file"]["text"] = {}, "name: changed"
    with pytest.raises(BadRecording, match="was changed"):
        arm_file(RecordingReader(recorded(tmp_path / "b", lambda _: None, arm)), tmp_path)
    arm["file"] = None
    with pytest.raises(BadRecording, match="--arm"):
        arm_file(RecordingReader(recorded(tmp_path / "c", lambda _: None, arm)), tmp_path)

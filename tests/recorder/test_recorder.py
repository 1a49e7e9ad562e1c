"""The recorder without Zenoh: what it makes of messages, and of a disk that fails."""

import errno
import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.host.keeper import FileInUse
from hyperbit.controller.recorder import recorder as module
from hyperbit.controller.recorder.folder import Folder
from hyperbit.controller.recorder.recorder import MOST_TOPICS, Limits, Recorder
from hyperbit.controller.recorder.recording import Recording
from hyperbit.controller.recorder.schemas import FOXGLOVE, LOG, TOPICS, schema_of_type
from tests.recorder.samples import SECOND, Read, heard, names, read, read_by_another
from tests.recorder.shapes import misfits
from tests.told import arm as planar
from tests.told import described, state

PREFIX = "hyperbit/planar16"
LIMITS = Limits(10**9, 10**9)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return planar()


@pytest.fixture
def recorder(tmp_path: Path) -> Recorder:
    return Recorder("planar16", Folder(tmp_path, "planar16"), LIMITS)


def files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"), key=lambda path: path.stat().st_mtime_ns)


def on(messages: list[Read], topic: str) -> list[dict[str, Any]]:
    return [message.data for message in messages if message.topic == f"{PREFIX}/{topic}"]


def test_all_topics_are_recorded_with_scene_frames_and_log(tmp_path: Path, recorder: Recorder, arm: Arm) -> None:
    recorder.receive_message(heard(1.0, "alive", b""))
    recorder.receive_message(heard(1.0, "arm", described(arm)))
    for k in range(40):
        recorder.receive_message(heard(1.1 + 0.05 * k, "state", state(arm, [k // 20] * 16, stamp=100.0 + 0.05 * k)))
    goal = {"id": "g", "waypoints": [{"position": [0.5, 2.9]}]}
    answer = {"accepted": True, "id": "g", "code": 0, "message": "accepted"}
    recorder.receive_message(heard(3.1, "request", {"stamp": 102.0, "key": "goal", "payload": goal, "answer": answer}))
    recorder.receive_message(heard(3.2, "result", {"id": "g", "status": "succeeded", "code": 0, "message": "reached"}))
    recorder.receive_message(heard(3.3, "gone", b""))
    recorder.end_recording()
    (path,) = files(tmp_path)
    messages = read(path)
    assert sorted(messages, key=repr) == sorted(read_by_another(path), key=repr)
    assert len(on(messages, "state")) == 40
    assert len(on(messages, "scene")) == 2, "the arm looks otherwise once"
    (first, second) = on(messages, "frames")
    assert len(first["transforms"]) == 17
    held, new = second["transforms"][:17], second["transforms"][17:]
    assert [it["translation"] for it in held] == [it["translation"] for it in first["transforms"]] != new
    (before, after) = (it[0]["timestamp"]["sec"] + it[0]["timestamp"]["nsec"] / 1e9 for it in (held, new))
    assert (before, after) == pytest.approx((100.999, 101.0))
    assert [it["alive"] for it in on(messages, "alive")] == [True, False]
    texts = [it["message"] for it in on(messages, "log")]
    assert texts == [
        "the daemon is there",
        "ready: holding",
        "goal g accepted: accepted",
        "goal g succeeded: reached",
        "the daemon is gone",
    ]
    assert all(misfits(it, FOXGLOVE[LOG]) == [] for it in on(messages, "log"))
    assert on(messages, "arm")[0]["name"] == "planar16"
    kinds = names(path)
    assert kinds.count("Metadata") == kinds.count("Attachment") == 1


def test_each_recording_can_be_understood_alone(tmp_path: Path, arm: Arm) -> None:
    began: list[Path] = []
    recorder = Recorder("planar16", Folder(tmp_path, "planar16"), Limits(20_000, 10**9), began=began.append)
    recorder.receive_message(heard(1.0, "arm", described(arm)))
    for k in range(60):
        configuration = [(k + m) % 8 for m in range(16)]
        recorder.receive_message(heard(1.0 + k, "state", state(arm, configuration, stamp=float(k))))
        recorder.turn()
    recorder.end_recording()
    assert len(began) > 2
    assert began == files(tmp_path)
    states: list[dict[str, Any]] = []
    for path in began:
        messages = read(path)
        assert [len(on(messages, topic)) for topic in ("arm",)] == [1]
        assert {"arm", "state", "scene", "frames"} <= {message.topic.rpartition("/")[2] for message in messages}
        assert names(path).count("Attachment") == 1
        states += on(messages, "state")
    assert {it["stamp"] for it in states} == {float(k) for k in range(60)}


def test_a_recording_ends_with_its_time(tmp_path: Path, arm: Arm) -> None:
    recorder = Recorder("planar16", Folder(tmp_path, "planar16"), Limits(10**9, 1e-9))
    for k in range(3):
        recorder.receive_message(heard(1.0 + k, "state", state(arm, [0] * 16, stamp=float(k))))
        recorder.turn()
    recorder.end_recording()
    assert len(files(tmp_path)) >= 3


@pytest.mark.parametrize("years", [-20, 20])
def test_a_recording_begins_with_the_clock_as_it_is_then(tmp_path: Path, arm: Arm, years: int) -> None:
    wall = [1_700_000_000]
    recorder = Recorder("planar16", Folder(tmp_path, "planar16"), LIMITS, wall=lambda: wall[0] * SECOND)
    recorder.receive_message(heard(time.monotonic(), "arm", described(arm)))
    recorder.receive_message(heard(time.monotonic(), "state", state(arm, [0] * 16, stamp=wall[0])))
    wall[0] += years * 31_536_000
    recorder.turn()
    recorder.receive_message(heard(time.monotonic(), "goal", {"id": "g"}))
    recorder.end_recording()
    before, after = files(tmp_path)
    assert all(abs(message.at / SECOND - wall[0]) < 60 for message in read(after))
    assert len(on(read(after), "state")) == len(on(read(after), "goal")) == 1, "it can be understood alone"
    assert all(abs(message.at / SECOND - 1_700_000_000) < 60 for message in read(before))
    assert "the system's clock was set by" in on(read(before), "log")[-1]["message"]


@pytest.mark.parametrize(
    "data", [b"no JSON", b"", b"\xff\xfe", b'{"a": "\xff"}', b"[1, 2]", b"null", b"1", b'{"a": ', b"[" * 5000]
)
def test_whatever_is_published_is_recorded(tmp_path: Path, recorder: Recorder, arm: Arm, data: bytes) -> None:
    for key in ("goal", "setpoint", "state", "result", "request", "some/thing"):
        recorder.receive_message(heard(1.0, key, data))
    recorder.receive_message(heard(1.0, "arm", data))
    recorder.end_recording()
    messages = read(files(tmp_path)[0])
    assert len(on(messages, "other")) == 6
    assert {it["key"] for it in on(messages, "other")} == {
        "goal",
        "setpoint",
        "state",
        "result",
        "request",
        "some/thing",
    }


@pytest.mark.parametrize("message", [{}, {"stamp": "now"}, {"faults": 3}, {"measured": [0]}, {"stamp": 1e300}])
def test_messages_of_another_version_are_recorded(
    tmp_path: Path, recorder: Recorder, arm: Arm, message: dict[str, Any]
) -> None:
    recorder.receive_message(heard(1.0, "arm", described(arm)))
    for key in ("state", "result", "request", "diagnostics"):
        recorder.receive_message(heard(1.0, key, message))
    recorder.end_recording()
    messages = read(files(tmp_path)[0])
    assert [on(messages, key) for key in ("state", "result", "request", "diagnostics")] == [[message]] * 4


def test_many_keys_of_somebody_else_do_not_become_many_channels(tmp_path: Path, recorder: Recorder) -> None:
    for k in range(3 * MOST_TOPICS):
        recorder.receive_message(heard(1.0, f"key{k}", {"k": k}))
    recorder.end_recording()
    messages = read(files(tmp_path)[0])
    assert len({message.topic for message in messages}) == MOST_TOPICS + 1
    assert len(messages) == 3 * MOST_TOPICS


def test_a_disk_that_fails_is_told_and_tried_again(
    tmp_path: Path, recorder: Recorder, arm: Arm, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    recorder.receive_message(heard(1.0, "arm", described(arm)))
    recorder.receive_message(heard(1.0, "state", state(arm, [0] * 16, stamp=1.0)))
    write: Callable[..., None] = Recording.write

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Recording, "write", full)
    recorder.receive_message(heard(2.0, "state", state(arm, [1] * 16, stamp=2.0)))
    assert "No space left on device" in caplog.text
    recorder.receive_message(heard(2.5, "state", state(arm, [1] * 16, stamp=2.5)))
    assert len(files(tmp_path)) == 1, "the next attempt comes later"
    monkeypatch.setattr(Recording, "write", write)
    monkeypatch.setattr(module, "RETRY", 0.0)
    recorder.retry_at = 0.0
    recorder.receive_message(heard(3.0, "state", state(arm, [2] * 16, stamp=3.0)))
    recorder.end_recording()
    assert len(files(tmp_path)) == 2
    assert on(read(files(tmp_path)[1]), "state")[-1]["stamp"] == 3.0


@pytest.mark.parametrize("what", ["deleted", "moved", "folder"])
def test_a_recording_that_is_gone_is_noticed_and_the_next_one_begins(
    tmp_path: Path, arm: Arm, caplog: pytest.LogCaptureFixture, what: str
) -> None:
    place = tmp_path / "recordings"
    folder = Folder(place, "planar16")
    recorder = Recorder("planar16", folder, LIMITS)
    recorder.receive_message(heard(1.0, "arm", described(arm)))
    (gone,) = files(place)
    recorder.turn()
    assert files(place) == [gone]
    match what:
        case "deleted":
            gone.unlink()
        case "moved":
            gone.rename(tmp_path / gone.name)
        case "folder":
            place.rename(tmp_path / "elsewhere")
    recorder.turn()
    assert f"{gone} was deleted or moved while it was written: the next recording begins" in caplog.text
    with pytest.raises(FileInUse):
        Folder(place, "planar16")
    recorder.receive_message(heard(2.0, "state", state(arm, [0] * 16, stamp=100.0)))
    recorder.end_recording()
    (path,) = files(place)
    assert len(on(read(path), "state")) == 1
    if what == "moved":
        assert on(read(tmp_path / gone.name), "arm"), "the moved file is complete"
    folder.close()


def test_what_the_arm_publishes_fits_its_schema(arm: Arm) -> None:
    assert misfits(state(arm, [0] * 16, stamp=1.0), schema_of_type(TOPICS["state"])) == []
    assert misfits(described(arm), schema_of_type(TOPICS["arm"])) == []
    assert misfits({"stamp": "x"}, schema_of_type(TOPICS["state"]))


def test_a_defect_is_no_reason_to_log_a_traceback(recorder: Recorder, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG):
        recorder.receive_message(heard(1.0, "arm", {"name": "planar16"}))
    assert "Traceback" not in caplog.text
    recorder.end_recording()

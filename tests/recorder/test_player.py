"""Replay: everything comes again in its order and time, and pages move the time line."""

import itertools
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import zenoh

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client
from hyperbit.controller.recorder import player
from hyperbit.controller.recorder.folder import Folder
from hyperbit.controller.recorder.player import Player, Timeline
from hyperbit.controller.recorder.reader import RecordingReader
from hyperbit.controller.recorder.recorder import Limits, Recorder
from tests.recorder.samples import heard
from tests.told import arm as planar
from tests.told import described, state
from tests.waiting import PATIENCE, eventually


@pytest.fixture(scope="module")
def arm() -> Arm:
    return planar()


@pytest.fixture
def past(tmp_path: Path, arm: Arm) -> Iterator[RecordingReader]:
    """Ten seconds of an arm, a state every half second and a result every two."""
    began: list[Path] = []
    recorder = Recorder("planar16", Folder(tmp_path, "planar16"), Limits(10**9, 10**9), began=began.append)
    recorder.receive_message(heard(0.0, "arm", described(arm)))
    for k in range(21):
        recorder.receive_message(heard(0.5 * k, "state", state(arm, [k % 8] * 16, stamp=100.0 + 0.5 * k)))
        if k % 4 == 0:
            recorder.receive_message(heard(0.5 * k + 0.1, "result", {"id": f"g{k}", "status": "succeeded", "code": 0}))
    recorder.end_recording()
    past = RecordingReader(began[0])
    yield past
    past.close()


class Sessions:
    """A Zenoh session that only remembers what is put."""

    def __init__(self) -> None:
        self.put_at: list[tuple[float, str, dict[str, Any]]] = []
        self.now = 0.0

    def declare_queryable(self, *_: object) -> "Sessions":
        return self

    def liveliness(self) -> "Sessions":
        return self

    def declare_token(self, *_: object) -> "Sessions":
        return self

    def undeclare(self) -> None:
        pass

    def put(self, key: str, data: bytes, **_: object) -> None:
        self.put_at.append((self.now, key, json.loads(data)))

    def clock(self, step: float) -> Callable[[], float]:
        """A clock that goes on by a step [s] at each look."""
        times = itertools.count()

        def look() -> float:
            self.now = next(times) * step
            return self.now

        return look


def played(
    past: RecordingReader, speed: float, step: float = 0.05, begin: float = 0.0
) -> list[tuple[float, str, dict[str, Any]]]:
    sessions, timeline = Sessions(), Timeline(past.begin / 1e9, past.end / 1e9, speed)
    timeline.change({"at": timeline.begin + begin})
    replay = Player(past, sessions, "replay", timeline)  # type: ignore[arg-type]
    with mock.patch.object(player, "LONGEST_WAIT", 0.0):  # the clock goes on without it
        replay.play(lambda: False, stay=False, clock=sessions.clock(step))
    return sessions.put_at


def test_all_messages_are_replayed_in_order_and_time(past: RecordingReader) -> None:
    for speed in (1.0, 4.0):
        put = played(past, speed, step=0.01)
        states = [(at, message["stamp"]) for at, key, message in put if key == "replay/planar16/state"]
        assert [stamp for _, stamp in states] == [100.0 + 0.5 * k for k in range(21)]
        for at, stamp in states:
            assert (stamp - 100.0) / speed <= at + 1e-6 <= (stamp - 100.0) / speed + 0.05
        results = [message["id"] for _, key, message in put if key == "replay/planar16/result"]
        assert results == [f"g{k}" for k in range(0, 21, 4)]
        lines = [message for _, key, message in put if key == "replay/planar16/timeline"]
        assert lines[-1]["at"] == lines[-1]["end"] == past.end / 1e9
        assert {key.rpartition("/")[2] for _, key, _ in put} == {"state", "result", "timeline"}


def test_a_fast_replay_leaves_out_states_but_no_result(past: RecordingReader) -> None:
    put = played(past, 1000.0, step=0.01)
    assert sum(key.endswith("/state") for _, key, _ in put) < 21
    assert [message["stamp"] for _, key, message in put if key.endswith("/state")][-1] == 110.0
    assert sum(key.endswith("/result") for _, key, _ in put) == 6


def test_a_replay_that_begins_later_publishes_the_latest_snapshots(past: RecordingReader) -> None:
    put = played(past, 1.0, begin=5.2)
    assert [message["stamp"] for _, key, message in put if key.endswith("/state")] == [
        105.0,
        *(105.5 + 0.5 * k for k in range(10)),
    ]


def test_wishes_for_the_time_line() -> None:
    line = Timeline(100.0, 110.0)
    line.advance(2.0)
    assert line.at == 102.0
    assert line.change({"speed": 4, "at": 105}) is None
    line.advance(1.0)
    assert line.at == 109.0
    line.advance(1.0)
    assert line.at == 110.0
    assert line.change({"paused": True, "at": -5.0}) is None
    line.advance(1.0)
    assert line.at == 100.0


@pytest.mark.parametrize(
    "wish",
    [[], 3, None, {"at": "x"}, {"at": True}, {"speed": 0}, {"speed": -1}, {"speed": 1e9}, {"paused": 1}, {"jump": 1}],
)
def test_other_wishes_are_refused_and_change_nothing(wish: Any) -> None:
    line = Timeline(100.0, 110.0)
    assert line.change(wish)
    assert line.payload() == {"begin": 100.0, "end": 110.0, "at": 100.0, "speed": 1.0, "paused": False}


def test_a_page_sees_the_past_and_moves_the_time_line(past: RecordingReader, arm: Arm, tmp_path: Path) -> None:
    endpoint = f"unixsock-stream/{tmp_path}/z.sock"
    with ExitStack() as stack:
        served = stack.enter_context(zenoh.open(session.configuration("peer", listen=endpoint)))
        page = stack.enter_context(zenoh.open(session.configuration("client", connect=endpoint)))
        timeline = Timeline(past.begin / 1e9, past.end / 1e9, paused=True)
        player = Player(past, served, "replay", timeline)
        stack.callback(player.close)
        states: list[dict[str, Any]] = []
        client, ending = Client(page, "planar16", prefix="replay"), False
        client.subscribe("state", states.append)

        def serve() -> None:
            player.play(lambda: ending, stay=True)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            eventually(client.alive)
            assert client.request("arm", timeout=PATIENCE) == described(arm)
            begin = past.begin / 1e9
            answer = client.request("timeline", {"at": begin + 7.2, "paused": True}, PATIENCE)
            assert (answer["accepted"], answer["at"], answer["paused"]) == (True, pytest.approx(begin + 7.2), True)
            eventually(lambda: states and states[-1]["stamp"] == 107.0)
            answer = client.request("timeline", {"speed": "fast"}, PATIENCE)
            assert not answer["accepted"]
            for key in ("goal", "stop", "cancel", "jog", "plan"):
                answer = client.request(key, {"waypoints": []}, PATIENCE)
                assert not answer["accepted"]
                assert "past" in answer["message"]
            assert client.request("timeline", {"paused": False, "speed": 100}, PATIENCE)["accepted"]
            eventually(lambda: states[-1]["stamp"] == 110.0)
            assert client.request("timeline", {"at": 0.0, "paused": True}, PATIENCE)["at"] == begin
        finally:
            ending = True
            thread.join()

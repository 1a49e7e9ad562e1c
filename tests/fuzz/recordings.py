"""Damaged recordings, and recordings with messages of any form, for all that reads recordings."""

from __future__ import annotations

import json
import random
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

from hyperbit.controller.host import files
from hyperbit.controller.network.listener import ReceivedMessage
from hyperbit.controller.recorder import folder as folder_module
from hyperbit.controller.recorder import regression
from hyperbit.controller.recorder.folder import Folder
from hyperbit.controller.recorder.player import Player, Timeline
from hyperbit.controller.recorder.reader import RecordingReader
from hyperbit.controller.recorder.recorder import Limits, Recorder
from hyperbit.controller.recorder.recording import Recording
from hyperbit.controller.recorder.repair import BadRecording
from tests import told
from tests.fuzz.mutations import changed, spoiled
from tests.fuzz.still import ROOM, Query, StillSession, Take
from tests.recorder.samples import SECOND, read

NAME = "planar16-20260101T000000Z.mcap"


class Arm:
    """A simulated arm that accepts all, and reaches all."""

    def ask(self, key: str, payload: Any) -> dict[str, Any]:
        return {"accepted": True}

    def wait_ready(self, timeout: float = 0.0) -> dict[str, Any]:
        return {}

    def bring(self, configuration: str) -> bool:
        return True

    def run(self, goal: Any) -> tuple[dict[str, Any], dict[int, str | None]]:
        return {"status": "succeeded", "configuration": "00"}, {0: "00"}


def messages() -> list[tuple[str, Any]]:
    """The messages of a goal with a result."""
    lock = {"stamp": 100.5, "key": "degrade", "payload": told.DEGRADE, "answer": told.ANSWER}
    request = {"stamp": 101.0, "key": "goal", "payload": told.GOAL, "answer": told.ANSWER}
    return [
        ("arm", told.described()),
        ("state", told.state(stamp=100.0)),
        ("diagnostics", told.DIAGNOSTICS),
        ("request", lock),
        ("request", request),
        ("feedback", told.FEEDBACK),
        ("result", told.RESULT | {"configuration": "1" * 16}),
    ]


def write(path: Path, recorded: list[tuple[str, Any]]) -> bytes:
    recording = Recording(path)
    recording.attach("a.yaml", "application/yaml", b"name: a", 0)
    for k, (key, message) in enumerate(recorded):
        recording.write(f"hyperbit/planar16/{key}", key, json.dumps(message).encode(), (100 + k) * SECOND, 1)
    recording.close()
    return path.read_bytes()


@cache
def whole() -> bytes:
    with tempfile.TemporaryDirectory() as room:
        return write(Path(room, NAME), messages() * 3)


def damaged(draw: random.Random) -> bytes:
    """A recording with changed bytes, cut, or with a wrong length in one of its records."""
    data = whole()
    for _ in range(draw.randrange(1, 5)):
        data = data[:16] + changed(data[16:], draw)
    if draw.random() < 0.3:
        record = 8
        for _ in range(draw.randrange(40)):
            follows = record + 9 + int.from_bytes(data[record + 1 : record + 9], "little")
            record = follows if follows + 9 < len(data) else record
        field = record + draw.choice((1, 9, 17, 25, 33))
        size = draw.choice((0, 1, 21, 2**16, 2**26, 2**32, 2**63, 2**64 - 1))
        data = data[:field] + size.to_bytes(8, "little") + data[field + 8 :]
    return data


def read_all(path: Path, room: Path) -> None:
    """Reads a recording as `replay` and `replay --goals` do; BadRecording is their sentence for a user."""

    @contextmanager
    def simulated(past: RecordingReader, file: Path | None) -> Iterator[Arm]:
        regression.prepared(past, None, room / "recorded", room / "ledger.db")
        yield Arm()

    with closing(RecordingReader(path)) as past:
        line = Timeline(past.begin / 1e9, past.end / 1e9, 1000.0)
        with closing(Player(past, mock.MagicMock(), "replay", line)) as player:
            times = iter(range(10**6))
            player.play(lambda: False, stay=False, clock=lambda: 1e9 * next(times))
        with mock.patch.object(regression, "simulated", simulated):
            regression.compare(past, None, lambda found: None)


def read_recording(key: str, data: bytes) -> None:
    """Reads a recording that is damaged, or has messages of any form; `data` is the seed of the damage."""
    draw = random.Random(data)
    silent = [mock.patch.object(log, "disabled", True) for log in (files.log, folder_module.log)]
    with silent[0], silent[1], tempfile.TemporaryDirectory() as place:
        room, path = Path(place), Path(place, NAME)
        (room / "recorded").mkdir()
        if draw.random() < 0.7:
            path.write_bytes(damaged(draw))
        else:
            odd = lambda it: spoiled(it, draw) if draw.random() < 0.5 else it  # noqa: E731
            write(path, [(name, odd(message)) for name, message in messages() * 2])
        with suppress(BadRecording):
            read_all(path, room)
        path.write_bytes(whole()[:8] + path.read_bytes()[8 : -draw.randrange(1, 200)])
        Folder(room, "planar16").close()
        if path.exists():
            assert read(path) is not None, "what is repaired has no damage"


def recorder() -> Take:
    folder = Path(tempfile.mkdtemp(dir=ROOM))
    one = Recorder("planar16", Folder(folder, "planar16"), Limits(10**7, 10**9))

    def take(key: str, data: bytes) -> None:
        one.receive_message(ReceivedMessage(time.monotonic_ns(), key, data))
        one.turn()
        for old in sorted(folder.glob("*.mcap"))[:-1]:
            old.unlink()

    return take


def player() -> Take:
    folder, began = Path(tempfile.mkdtemp(dir=ROOM)), list[Path]()
    one = Recorder("planar16", Folder(folder, "planar16"), Limits(10**9, 10**9), began=began.append)
    for k, (key, value) in enumerate(told.published().items()):
        one.receive_message(ReceivedMessage(k * 10**9, key, json.dumps(value).encode()))
    one.end_recording()
    past, session = RecordingReader(began[0]), StillSession()
    replay = Player(past, session, "replay", Timeline(past.begin / 1e9, past.end / 1e9))  # type: ignore[arg-type]

    def take(key: str, data: bytes) -> None:
        query = Query("replay/planar16/timeline", data)
        replay._carry_out(query)  # type: ignore[arg-type]
        (answer,) = [json.loads(reply) for reply in query.replies]
        assert isinstance(answer["accepted"], bool)
        assert answer["message"]

    return take

"""Damaged recordings, and recordings with messages of any form, for all that reads recordings."""

from __future__ import annotations

import json
import random
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

from hyperbit.controller.host import files
from hyperbit.controller.recorder import folder as folder_module
from hyperbit.controller.recorder import regression
from hyperbit.controller.recorder.folder import Folder
from hyperbit.controller.recorder.player import Player, Timeline
from hyperbit.controller.recorder.reader import RecordingReader
from hyperbit.controller.recorder.recording import Recording
from hyperbit.controller.recorder.repair import BadRecording
from tests.recorder.samples import SECOND, planar, read, state, told

JUNK = (None, True, -1, 2**70, 1e308, "", "*", "\0", [], [1], {}, {"a": 1}, "00", 0.5)


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


@cache
def messages() -> list[tuple[str, dict[str, Any]]]:
    """The messages of a goal with a result."""
    arm = planar()
    goal = {"id": "g", "stamp": 101.0, "waypoints": [{"position": [0.5, 2.9]}]}
    answer = {"accepted": True, "id": "g", "code": 0, "message": "accepted"}
    return [
        ("arm", told(arm)),
        ("state", state(arm, [0] * 16, 100.0) | {"configuration": "0" * 16}),
        ("diagnostics", {"stamp": 100.0, "counts": [1] * len(arm.manipulator.actuators)}),
        ("request", {"stamp": 100.5, "key": "degrade", "payload": {"actuator": "1.left"}, "answer": answer}),
        ("request", {"stamp": 101.0, "key": "goal", "payload": goal, "answer": answer}),
        ("feedback", {"id": "g", "waypoint": 0, "configuration": "1" * 16}),
        ("result", {"id": "g", "status": "succeeded", "code": 0, "configuration": "1" * 16, "message": "reached"}),
    ]


def write(path: Path, told: list[tuple[str, Any]]) -> bytes:
    recording = Recording(path)
    recording.attach("a.yaml", "application/yaml", b"name: a", 0)
    for k, (key, message) in enumerate(told):
        recording.write(f"hyperbit/planar16/{key}", key, json.dumps(message).encode(), (100 + k) * SECOND, 1)
    recording.close()
    return path.read_bytes()


@cache
def whole() -> bytes:
    with tempfile.TemporaryDirectory() as room:
        return write(Path(room, "planar16-20260101T000000Z.mcap"), messages() * 3)


def spoiled(value: Any, draw: random.Random) -> Any:
    """A JSON value with some values of another form in it."""
    if draw.random() < 0.03:
        return draw.choice(JUNK)
    if isinstance(value, dict):
        return {key: spoiled(entry, draw) for key, entry in value.items() if draw.random() > 0.02}
    return [spoiled(entry, draw) for entry in value] if isinstance(value, list) and len(value) < 20 else value


def damaged(draw: random.Random) -> bytes:
    """A recording with flipped bytes, cut, with wrong lengths, or with zeros as flash memory has them."""
    data = bytearray(whole())
    for _ in range(draw.randrange(1, 5)):
        at, length = draw.randrange(len(data)), draw.choice((1, 1, 4, 8, 512))
        match draw.randrange(4):
            case 0:
                data[at] ^= 1 << draw.randrange(8)
            case 1:
                data[at : at + length] = draw.choice((b"\0", b"\xff")) * len(data[at : at + length])
            case 2:
                record = 8
                for _ in range(draw.randrange(40)):
                    follows = record + 9 + int.from_bytes(data[record + 1 : record + 9], "little")
                    record = follows if follows + 9 < len(data) else record
                size = draw.choice((0, 1, 21, 2**16, 2**26, 2**32, 2**63, 2**64 - 1))
                field = record + draw.choice((1, 9, 17, 25, 33))
                data[field : field + 8] = size.to_bytes(8, "little")
            case 3:
                del data[max(at, 16) : at + draw.choice((1, 8, 100, len(data)))]
    return bytes(data)


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


def read_recording(data: bytes) -> int:
    """Reads one recording that is damaged, or has messages of any form; `data` is the seed of the damage."""
    draw = random.Random(data)
    silent = [mock.patch.object(log, "disabled", True) for log in (files.log, folder_module.log)]
    with silent[0], silent[1], tempfile.TemporaryDirectory() as place:
        room, path = Path(place), Path(place, "planar16-20260101T000000Z.mcap")
        (room / "recorded").mkdir()
        if draw.random() < 0.7:
            path.write_bytes(damaged(draw))
        else:
            write(path, [(key, spoiled(message, draw)) for key, message in messages() * 2])
        with suppress(BadRecording):
            read_all(path, room)
        path.write_bytes(whole()[:8] + path.read_bytes()[8 : -draw.randrange(1, 200)])
        Folder(room, "planar16").close()
        if path.exists():
            assert read(path) is not None, "what is repaired has no damage"
    return 1

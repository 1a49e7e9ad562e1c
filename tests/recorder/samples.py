"""What reads recordings: the package mcap, and small_mcap as a second one."""

import io
import json
from pathlib import Path
from typing import Any, NamedTuple

import small_mcap
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader

from hyperbit.controller.network.listener import ReceivedMessage
from hyperbit.controller.recorder.recording import Recording

SECOND = 1_000_000_000  # [ns]


class Read(NamedTuple):
    topic: str
    at: int
    data: dict[str, Any]


def read(path: Path) -> list[Read]:
    """The messages of a complete file, by the package mcap, its index and checksums included."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_summary() is not None
        return [Read(c.topic, m.log_time, json.loads(m.data)) for _, c, m in reader.iter_messages()]


def read_by_another(path: Path) -> list[Read]:
    """The messages of a complete file, by another reader."""
    with path.open("rb") as stream:
        return [Read(c.topic, m.log_time, json.loads(bytes(m.data))) for _, c, m in small_mcap.read_message(stream)]


def read_unfinished(data: bytes) -> list[Read]:
    """The whole messages of a file that was cut off, by the package mcap."""
    found: list[Read] = []
    try:
        messages = NonSeekingReader(io.BytesIO(data)).iter_messages(log_time_order=False)
        found.extend(Read(c.topic, m.log_time, json.loads(m.data)) for _, c, m in messages)
    except Exception:  # at the cut, whatever the library raises there
        return found
    return found


def recovered_by_another(data: bytes) -> list[Read]:
    """The whole messages of a file that was cut off, by another reader's recovery."""
    found: list[Read] = []
    channels: dict[int, str] = {}
    try:
        for record in small_mcap.stream_reader(io.BytesIO(data), emit_chunks=False):
            if isinstance(record, small_mcap.Channel):
                channels[record.id] = record.topic
            elif isinstance(record, small_mcap.Message):
                found.append(Read(channels[record.channel_id], record.log_time, json.loads(bytes(record.data))))
    except Exception:
        return found
    return found


def names(path: Path) -> list[str]:
    with path.open("rb") as stream:
        return [type(record).__name__ for record in StreamReader(stream).records]


TOPIC = "hyperbit/a/state"


def written(path: Path, count: int = 100, every: float = 0.05) -> Recording:
    """A recording with messages, the first at 1000 s, not completed."""
    recording = Recording(path)
    recording.add_metadata("hyperbit", {"arm": "a"})
    recording.attach("a.yaml", "application/yaml", b"name: a", 0)
    for k in range(count):
        at = round((1000 + k * every) * SECOND)
        recording.write(TOPIC, "state", json.dumps({"k": k, "stamp": 1.5}).encode(), at, 1)
    return recording


def numbers(messages: list) -> list[int]:
    return [message.data["k"] for message in messages]


def heard(at: float, key: str, message: Any) -> ReceivedMessage:
    """A message that came at a monotonic time [s]."""
    data = message if isinstance(message, bytes) else json.dumps(message).encode()
    return ReceivedMessage(round(at * SECOND), key, data)

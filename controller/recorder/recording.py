"""One recording: an MCAP file of JSON messages, flushed each second, so that a kill loses at most one second."""

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path

from mcap.writer import CompressionType, Writer

from hyperbit.controller.host.files import is_at
from hyperbit.controller.recorder.schemas import schema_of

FLUSH_EVERY = 1_000_000_000  # [ns] of the messages' log time
LIBRARY = "hyperbit"


class Recording:
    """A recording that is being written. All methods raise OSError if the file cannot be written.

    Attributes:
        path: path of the file.
        begun: log time of the first message [ns]; None before it.

    Args:
        path: path of the file, which must not exist.
        fsync: whether each flush waits until the data is on the disk.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, path: Path, *, fsync: bool = False) -> None:
        self.path, self._fsync = path, fsync
        self.begun: int | None = None
        self._file = path.open("xb")
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequences: dict[int, int] = {}
        self._unflushed: int | None = None  # log time of the first message that is not flushed
        self._writer.flush()  # type: ignore[no-untyped-call]

    @property
    def size(self) -> int:
        """Bytes written so far, without unflushed data."""
        return self._file.tell()

    def write(self, topic: str, kind: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Writes a message; first flushes data that is older than a second.

        Args:
            topic: topic of the channel.
            kind: name of the schema, see `schema_of`.
            data: JSON.
            log_time: time of arrival on the recorder's clock [ns].
            publish_time: time of publication on the sender's clock [ns].
        """
        if self.due(log_time):
            self.flush()
        channel = self._channel(topic, kind)
        self._sequences[channel] = sequence = self._sequences.get(channel, -1) + 1
        self._writer.add_message(channel, log_time, data, publish_time, sequence)
        self.begun = log_time if self.begun is None else self.begun
        self._unflushed = log_time if self._unflushed is None else self._unflushed

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Writes a metadata record of named texts."""
        self._writer.add_metadata(name, values)

    def attach(self, name: str, kind: str, data: bytes, log_time: int) -> None:
        """Writes a file as an attachment; `kind` is its media type."""
        self._writer.add_attachment(log_time, log_time, name, kind, data)

    def due(self, log_time: int) -> bool:
        """Returns whether data is due to be flushed at a log time [ns]."""
        return self._unflushed is not None and log_time - self._unflushed >= FLUSH_EVERY

    def flush(self) -> None:
        """Passes all data to the kernel, and with `fsync` to the disk."""
        self._unflushed = None
        self._writer.flush()  # type: ignore[no-untyped-call]
        if self._fsync:
            os.fsync(self._file.fileno())

    def is_gone(self) -> bool:
        """Returns whether somebody has deleted or moved the file."""
        return not is_at(self.path, self._file.fileno())

    def close(self) -> None:
        """Completes the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def abandon(self) -> None:
        """Closes a file that can no longer be written; a later repair completes it."""
        with contextlib.suppress(OSError, ValueError):
            self._file.raw.close()
        with contextlib.suppress(OSError, ValueError):
            self._file.close()

    def _channel(self, topic: str, kind: str) -> int:
        channel = self._channels.get(topic)
        if channel is None:
            name, text = schema_of(kind)
            if name not in self._schemas:
                self._schemas[name] = self._writer.register_schema(name, "jsonschema", text)
            channel = self._writer.register_channel(topic, "json", self._schemas[name])
            self._channels[topic] = channel
        return channel


class LogClock:
    """Clock of one recording's log times: UNIX time at its start, advanced by CLOCK_MONOTONIC.

    So log times never step back inside a recording. `wall` is UNIX time [ns], which may be set at any time.
    """

    def __init__(self, wall: Callable[[], int] = time.time_ns) -> None:
        self._wall, self._offset = wall, wall() - time.monotonic_ns()

    def at(self, monotonic: int) -> int:
        """Returns the log time [ns] of a monotonic time [ns]."""
        return max(monotonic + self._offset, 0)

    def step(self) -> float:
        """Returns by how much UNIX time was set since the start [s]."""
        return (self._wall() - self.at(time.monotonic_ns())) / 1e9

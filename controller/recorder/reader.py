"""Reads a recording of one arm, complete or incomplete."""

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

from mcap.reader import SeekingReader

from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.host.files import open_file
from hyperbit.controller.network.fleet import is_name
from hyperbit.controller.recorder.repair import BadRecording, guarded, rewrite, unfinished

SNAPSHOTS = ("state", "diagnostics")  # keys whose latest message replaces all earlier ones
SKIPPED = (
    "arm",
    "alive",
    "log",
    "scene",
    "frames",
    "other",
    "timeline",
)  # written by the recorder, or served in another way
KEY = re.compile(r"[^/*$#?\0]+(/[^/*$#?\0]+)*")  # other keys are no keys of Zenoh, or stand for several


class RecordedMessage(NamedTuple):
    """A recorded message: its log time [ns], its key after "hyperbit/<arm>/", and its payload."""

    at: int
    key: str
    data: bytes


class RecordingReader:
    """An open recording.

    Attributes:
        path: path of the file.
        arm: name of the arm.
        description: payload of `arm`; None if the recording has none.
        begin: log time of the first message [ns].
        end: log time of the last message [ns].
        whole: whether the file is complete; otherwise only its readable part is used.

    Args:
        path: path of the file.

    Raises:
        BadRecording: the file is no recording of one arm.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with guarded(path):
            self._file, self.whole = opened(path)
            self._reader = SeekingReader(self._file, validate_crcs=True)
            summary = self._reader.get_summary()
            topics = {channel.topic for channel in summary.channels.values()} if summary else set[str]()
            statistics = summary.statistics if summary else None
        arms = {parts[1] for topic in topics if len(parts := topic.split("/", 2)) == 3 and parts[0] == "hyperbit"}
        if len(arms) != 1 or statistics is None or not statistics.message_count:
            what = "of no arm" if not arms else f"of {len(arms)} arms"
            raise BadRecording(f"{path}: a recording {what}; one of `hyperbit record` is needed")
        (self.arm,) = arms
        if not is_name(self.arm):
            raise BadRecording(f"{path}: a recording of the arm {self.arm!r}, which is no name of an arm")
        self.begin, self.end = statistics.message_start_time, statistics.message_end_time
        if self.begin > self.end:
            raise BadRecording(f"{path}: damaged: its end is before its begin")
        prefix = f"hyperbit/{self.arm}/"
        keys = {topic.removeprefix(prefix) for topic in topics if topic.startswith(prefix)}
        self._topics = [prefix + key for key in keys if KEY.fullmatch(key) and key not in SKIPPED]
        latest = self._last("arm", self.end)
        try:
            self.description: dict[str, Any] | None = None if latest is None else decode(latest.data, dict[str, Any])
        except Unreadable:
            self.description = None

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def messages(self, begin: int | None = None) -> Iterator[RecordedMessage]:
        """Yields the arm's messages from a log time [ns] on, ordered by log time.

        Raises:
            BadRecording: the file is damaged.
        """
        yield from self._read(begin, None, self._topics)

    def latest_before(self, at: int) -> list[RecordedMessage]:
        """Returns the latest message of each key of SNAPSHOTS before a log time [ns], or else the first after it."""
        found = [self._last(key, at - 1) or self._first(key, at) for key in SNAPSHOTS]
        return [message for message in found if message is not None and message.at != at]

    def _last(self, key: str, at: int) -> RecordedMessage | None:
        topic = [f"hyperbit/{self.arm}/{key}"]
        return next(iter(self._read(None, at + 1, topic, reverse=True)), None)

    def _first(self, key: str, at: int) -> RecordedMessage | None:
        return next(iter(self._read(at, None, [f"hyperbit/{self.arm}/{key}"])), None)

    def _read(
        self, begin: int | None, end: int | None, topics: list[str], reverse: bool = False
    ) -> Iterator[RecordedMessage]:
        with guarded(self.path):
            found = self._reader.iter_messages(topics, starting_at=begin, ending_before=end, reverse=reverse)
            for _, channel, message in found:
                if not self.begin <= message.log_time <= self.end:
                    raise BadRecording(f"{self.path}: damaged: a message lies outside the times of the recording")
                yield RecordedMessage(message.log_time, channel.topic.split("/", 2)[2], message.data)


def opened(path: Path) -> tuple[IO[bytes], bool]:
    """Opens a file; of an incomplete file, opens a repaired copy. Returns the file and whether it is complete.

    Raises:
        OSError: the file cannot be read.
    """
    if not unfinished(path):
        return open_file(path, None), True
    copy = tempfile.TemporaryFile()  # noqa: SIM115  # returned open
    with open_file(path, None) as cut:
        rewrite(cut, copy)
    copy.seek(0)
    return copy, False

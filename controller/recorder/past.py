"""A recording as it is read: whole or cut off, of one arm."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import msgspec
from mcap.reader import SeekingReader

from controller.recorder.repair import DAMAGE, rewrite, unfinished

KEPT = ("state", "diagnostics")  # keys whose latest message tells how things stand
DRAWN = ("arm", "alive", "log", "scene", "frames", "other")  # written by the recorder, or told in another way


class BadRecording(Exception):
    """A file that is no recording of an arm, in a sentence."""


class Told(NamedTuple):
    """A recorded message: its log time [ns], its key after "hyperbit/<arm>/", and its payload."""

    at: int
    key: str
    data: bytes


class Past:
    """One recording.

    Attributes:
        path: of the file.
        arm: its name.
        description: payload of `arm`; None if the daemon was never asked.
        begin: log time of the first message [ns].
        end: of the last [ns].
        whole: whether the file is complete; else what it has was read.

    Args:
        path: of the file.

    Raises:
        BadRecording: it is none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file, self.whole = opened(path)
            self._reader = SeekingReader(self._file, validate_crcs=True)
            summary = self._reader.get_summary()
            topics = {channel.topic for channel in summary.channels.values()} if summary else set[str]()
            statistics = summary.statistics if summary else None
        except OSError as error:
            raise BadRecording(f"{path}: cannot be read: {error.strerror or error}") from None
        except DAMAGE as error:
            raise BadRecording(f"{path}: no MCAP file, or damaged: {error}") from None
        arms = {parts[1] for topic in topics if len(parts := topic.split("/", 2)) == 3 and parts[0] == "hyperbit"}
        if len(arms) != 1 or statistics is None or not statistics.message_count:
            what = "of no arm" if not arms else f"of {len(arms)} arms"
            raise BadRecording(f"{path}: a recording {what}, as `hyperbit record` writes none")
        (self.arm,) = arms
        self.begin, self.end = statistics.message_start_time, statistics.message_end_time
        self._topics = [topic for topic in topics if topic.split("/", 2)[2] not in DRAWN]
        told = self._last("arm", self.end)
        try:
            self.description: dict[str, Any] | None = (
                None if told is None else msgspec.json.decode(told.data, type=dict)
            )
        except msgspec.MsgspecError:
            self.description = None

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def messages(self, begin: int | None = None) -> Iterator[Told]:
        """Yields the arm's messages from a log time on [ns], in its order.

        Raises:
            BadRecording: the file is damaged there.
        """
        yield from self._read(begin, None, self._topics)

    def standing(self, at: int) -> list[Told]:
        """Returns the latest message of each key of KEPT before a log time [ns], or else the first after it."""
        found = [self._last(key, at - 1) or self._first(key, at) for key in KEPT]
        return [told for told in found if told is not None and told.at != at]

    def _last(self, key: str, at: int) -> Told | None:
        topic = [f"hyperbit/{self.arm}/{key}"]
        return next(iter(self._read(None, at + 1, topic, reverse=True)), None)

    def _first(self, key: str, at: int) -> Told | None:
        return next(iter(self._read(at, None, [f"hyperbit/{self.arm}/{key}"])), None)

    def _read(self, begin: int | None, end: int | None, topics: list[str], reverse: bool = False) -> Iterator[Told]:
        try:
            found = self._reader.iter_messages(topics, starting_at=begin, ending_before=end, reverse=reverse)
            for _, channel, message in found:
                yield Told(message.log_time, channel.topic.split("/", 2)[2], message.data)
        except OSError as error:
            raise BadRecording(f"{self.path}: cannot be read: {error.strerror or error}") from None
        except DAMAGE as error:
            raise BadRecording(f"{self.path}: damaged: {error}") from None


def opened(path: Path) -> tuple[IO[bytes], bool]:
    """Returns a file, and whether it is complete; what an unfinished one has is read from a copy.

    Raises:
        OSError: it cannot be read.
    """
    if not unfinished(path):
        return path.open("rb"), True
    copy = tempfile.TemporaryFile()  # noqa: SIM115  # it is returned open
    with path.open("rb") as cut:
        rewrite(cut, copy)
    copy.seek(0)
    return copy, False

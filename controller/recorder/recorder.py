"""The recorder's thread: writes the received messages of an arm into one recording after the other."""

import logging
import platform
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta, Struct

from hyperbit.controller.armfile.units import METRES_TAKEN
from hyperbit.controller.decoding.decoding import OTHER_FORM, Unreadable, decode
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.goals import Note, Result
from hyperbit.controller.messages.state import State
from hyperbit.controller.network.fault_changes import ActiveFaults
from hyperbit.controller.network.listener import Listener, ReceivedMessage
from hyperbit.controller.pictures.scene import FoxgloveScene, Shown, shown_of
from hyperbit.controller.recorder.folder import Folder
from hyperbit.controller.recorder.recording import LogClock, Recording
from hyperbit.controller.recorder.schemas import LOG, SCENE, TOPICS, TRANSFORMS, Alive

log = logging.getLogger(__name__)

POLL = 0.2  # [s] between two checks of the clock
ASK_EVERY = 5.0  # [s] between two requests for the arm's description, while there is no answer
RETRY = 10.0  # [s] after a failure of the disk
OWN = ("scene", "frames", "log")  # topics that the recorder makes; a message on such a key is recorded as "other"
MOST_TOPICS = 100  # topics of unknown keys; further ones are recorded as "other"
INFO, WARNING, ERROR = 2, 3, 4  # levels of foxglove.Log
CLOCK_STEP = 1.0  # [s] by which the system's clock must be set to end a recording
LOGGED: dict[str, type[Struct]] = {"state": State, "request": Note, "result": Result, "alive": Alive}
STEP_BEFORE = 0.001  # [s] before a change, at which the old frames are repeated


class EventLog:
    """Makes log lines from changes between messages."""

    def __init__(self) -> None:
        self._mode: tuple[str, str] | None = None
        self._faults = ActiveFaults()

    def lines(self, message: Struct) -> Iterator[tuple[int, str]]:
        """Yields the log lines of a message, each with its level."""
        match message:
            case State():
                yield from self._state(message)
            case Note(key, answer):
                named = f" {answer.id}" if answer.id else ""
                outcome = "accepted" if answer.accepted else "refused"
                yield INFO if answer.accepted else WARNING, f"{key}{named} {outcome}: {answer.message}"
            case Result():
                level = INFO if message.code == 0 else WARNING
                yield level, f"goal {message.id} {message.status}: {message.message}"
            case Alive(alive):
                yield (INFO if alive else ERROR), "the daemon is there" if alive else "the daemon is gone"

    def _state(self, state: State) -> Iterator[tuple[int, str]]:
        mode = state.mode, state.reason
        if mode != self._mode:
            self._mode = mode
            yield (WARNING if mode[0] in ("fault", "stopped") else INFO), f"{mode[0]}: {mode[1]}"
        changes = self._faults.take(state)
        for (code, source), message in changes.came.items():
            yield ERROR, f"{code} at {source}: {message}"
        for code, source in changes.went:
            yield INFO, f"{code} at {source} is gone"


class Limits(NamedTuple):
    """Limits of one recording, after which the next begins: size in bytes, and duration [s]."""

    size: int
    seconds: float


class Recorder:
    """Writes all messages of one arm. Each recording begins with the arm's description and state.

    Arrival times, `at`, are of CLOCK_MONOTONIC [ns]. Each recording has a clock of its own for its log times; if the
    system's clock is set, the next recording begins.

    Args:
        arm: name of the arm.
        folder: folder of the recordings.
        limits: limits of one recording.
        fsync: whether each flush waits for the disk.
        began: called with the path of each new recording.
        wall: UNIX time [ns].
    """

    def __init__(
        self,
        arm: str,
        folder: Folder,
        limits: Limits,
        *,
        fsync: bool = False,
        began: Callable[[Path], None] = lambda path: None,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        self._arm, self._folder, self._limits, self._fsync, self._began = arm, folder, limits, fsync, began
        self._wall, self._clock, self._events = wall, LogClock(wall), EventLog()
        self._recording: Recording | None = None
        self.retry_at = 0.0
        self.description: bytes | None = None
        self._scene: FoxgloveScene | None = None
        self._drawn: tuple[FoxgloveScene, Shown] | None = None
        self._state: tuple[int, State, bytes] | None = None  # the latest: arrival, decoded, encoded
        self._topics: set[str] = set()
        self._obstacles: int | None = None
        self._asked_at = -ASK_EVERY
        self._needs_description = False  # the daemon is there, but has not described the arm

    def run(self, listener: Listener, ending: Callable[[], bool], beat: Callable[[], None]) -> None:
        """Records until `ending` returns True; calls `beat` several times a second."""
        while not ending():
            for item in listener.receive_messages(POLL):
                self.receive_message(item)
            if dropped := listener.dropped():
                self._say(ERROR, f"{dropped} messages were dropped: the disk is too slow")
            if self._needs_description and time.monotonic() >= self._asked_at + ASK_EVERY:
                self._asked_at = time.monotonic()
                listener.ask()
            self.turn()
            beat()

    def end_recording(self) -> None:
        """Completes the recording."""
        if self._recording is not None:
            self._attempt(self._recording.close)
            self._recording = None

    def receive_message(self, item: ReceivedMessage) -> None:
        """Writes a message, and the drawing and log lines that follow from it."""
        at = item.at
        if item.key == "arm":
            self._accept_description(item.data, at)
            return
        if item.key in ("alive", "gone"):
            self._needs_description = item.key == "alive"
            key, data = "alive", msgspec.json.encode({"alive": item.key == "alive"})
        else:
            key, data = self._plain(item.key, item.data)
        self._write(key, key, data, at, published(data))
        if key not in LOGGED:
            return
        try:
            message = decode(data, LOGGED[key])
        except Unreadable:  # of a stranger
            return
        for level, text in self._events.lines(message):
            self._say(level, text, at)
        if isinstance(message, State):
            self._state = at, message, data
            if message.obstacles != self._obstacles:  # other obstacles were sent: the description has them
                self._obstacles, self._needs_description = message.obstacles, True
            self._draw()

    def _accept_description(self, data: bytes, at: int) -> None:
        """Writes the arm's description if it is new."""
        self._needs_description = False
        if data == self.description:
            return
        try:
            arm = decode(data, Description)
            self._scene = FoxgloveScene(arm)
        except OTHER_FORM as error:
            self._say(WARNING, f"the daemon's description of the arm cannot be drawn: {error}", at)
            self._scene = None
        else:
            self.description, self._drawn = data, None
            if arm.unit is None:
                log.warning("arm %s: scenes: %s", self._arm, METRES_TAKEN)
            self._write_description(at)
            self._draw()

    def _write_description(self, at: int) -> None:
        """Writes the arm's description: a message, the versions as metadata, and the arm's file."""
        if self.description is None:
            return
        arm = decode(self.description, Description)
        file = arm.file or None
        values = {
            "arm": self._arm,
            "version": arm.version or "",
            "recorder_version": version("hyperbit"),
            "recorder_host": platform.node(),
            "daemon_host": arm.daemon.host or "",
            "unit": arm.unit or "",
            "file": file.name if file else "",
            "file_sha256": file.sha256 if file else "",
        }

        def add_description(recording: Recording) -> None:
            recording.add_metadata("hyperbit", values)
            begun = self._clock.at(at)
            if file is None:
                return
            recording.attach(file.name, "application/yaml", file.text.encode(), begun)
            for name, text in file.tables.items():
                recording.attach(name, "text/csv", text.encode(), begun)

        if self._recording is None:
            self._open(at)  # a recording begins with the description
            return
        recording = self._recording
        self._attempt(lambda: add_description(recording))
        self._write("arm", "arm", self.description, at)

    def _draw(self) -> None:
        """Writes scene and frames if the arm's shape, target or obstacles have changed."""
        if self._scene is None or self._state is None:
            return
        at, state, data = self._state
        shown = shown_of(state)
        if (self._scene, shown) == self._drawn:
            return
        before, self._drawn = self._drawn, (self._scene, shown)
        stamp = published(data) or self._clock.at(at)
        try:
            scene = msgspec.json.encode(self._scene.update(shown, stamp / 1e9))
            frames = self._scene.transforms(shown, stamp / 1e9)
            if before is not None:  # otherwise a viewer would interpolate the frames since the last change
                held = self._scene.transforms(before[1], stamp / 1e9 - STEP_BEFORE)
                frames["transforms"][:0] = held["transforms"]
        except OTHER_FORM as error:  # a state of another arm or version
            self._say(WARNING, f"a state cannot be drawn: {error}", at)
            return
        self._write("scene", SCENE, scene, at, stamp)
        self._write("frames", TRANSFORMS, msgspec.json.encode(frames), at, stamp)

    def _plain(self, key: str, data: bytes) -> tuple[str, bytes]:
        """Returns topic and JSON object of a message of any form."""
        known = key not in OWN and (key in TOPICS or key in self._topics or len(self._topics) < MOST_TOPICS)
        try:
            value = decode(data)
        except Unreadable:
            return "other", msgspec.json.encode({"key": key, "text": data[:1000].decode(errors="replace")})
        if not known or not isinstance(value, dict):
            return "other", msgspec.json.encode({"key": key, "value": msgspec.Raw(data)})
        if key not in TOPICS:
            self._topics.add(key)
        return key, data

    def _say(self, level: int, text: str, at: int | None = None) -> None:
        """Writes a line of the log."""
        at = time.monotonic_ns() if at is None else at
        self._open(at)  # the line has the time of its recording
        seconds, nanoseconds = divmod(self._clock.at(at), 1_000_000_000)
        entry = {"timestamp": {"sec": seconds, "nsec": nanoseconds}, "level": level, "message": text}
        entry |= {"name": self._arm, "file": "", "line": 0}
        self._write("log", LOG, msgspec.json.encode(entry), at)

    def _write(self, key: str, kind: str, data: bytes, at: int, sent: int | None = None) -> None:
        """Writes a message that arrived `at`; `sent`: its stamp [UNIX ns], if it has one."""
        if (recording := self._open(at)) is not None:
            log_time = self._clock.at(at)
            topic, publish_time = f"hyperbit/{self._arm}/{key}", log_time if sent is None else sent
            self._attempt(lambda: recording.write(topic, kind, data, log_time, publish_time))

    def turn(self) -> None:
        """Flushes data that is due, and ends a recording that has reached its limits, or is gone."""
        at = time.monotonic_ns()
        recording, now = self._recording, self._clock.at(at)
        if recording is not None and recording.is_gone():
            log.error("%s was deleted or moved while it was written: the next recording begins", recording.path)
            self.end_recording()
            self._open(at)
            return
        if recording is None or recording.begun is None:
            return
        stepped = abs(step := self._clock.step()) >= CLOCK_STEP
        if stepped:
            self._say(WARNING, f"the system's clock was set by {step:+.1f} s: the next recording begins", at)
        if stepped or recording.size >= self._limits.size or now - recording.begun >= self._limits.seconds * 1e9:
            self.end_recording()
            self._open(at)
        elif recording.due(now):
            self._attempt(recording.flush)
            self._attempt(lambda: self._folder.make_room(recording.path))

    def _open(self, at: int) -> Recording | None:
        """Returns the recording; begins one if there is none, except within RETRY of a disk failure."""
        if self._recording is not None or time.monotonic() < self.retry_at:
            return self._recording
        clock = LogClock(self._wall)
        try:
            self._recording = Recording(self._folder.new(self._wall() / 1e9), fsync=self._fsync)
        except OSError as error:
            self._failed(error)
            return None
        self._clock = clock
        log.info("recording to %s", self._recording.path)
        self._began(self._recording.path)
        self._drawn = None
        self._write_description(at)
        if self._state is not None and self.description is not None:
            heard_at, _, data = self._state
            self._write("state", "state", data, max(at, heard_at), published(data))
            self._draw()
        return self._recording

    def _attempt(self, act: Callable[[], None]) -> None:
        """Calls a function that writes; abandons the recording if the disk fails."""
        try:
            act()
        except OSError as error:
            self._failed(error)

    def _failed(self, error: OSError) -> None:
        recording, self._recording = self._recording, None
        where = "" if recording is None else f"{recording.path}: "
        log.error("%scannot be written: %s; next attempt in %g s", where, error.strerror or error, RETRY)
        self.retry_at = time.monotonic() + RETRY
        if recording is not None:
            recording.abandon()


class Stamped(Struct):
    stamp: Annotated[float, Meta(gt=0, lt=2**63 / 1e9)]  # [UNIX s]


def published(data: bytes) -> int | None:
    """Returns the stamp of a message [ns]; None if it has no plausible one."""
    try:
        return int(decode(data, Stamped).stamp * 1e9)
    except Unreadable:
        return None

"""Publishes a recording again over Zenoh below another prefix, with a timeline that pages can move."""

import contextlib
import queue
import time
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import zenoh

from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.recorder.reader import SNAPSHOTS, RecordedMessage, RecordingReader

JSON = zenoh.Encoding.APPLICATION_JSON
PUBLISH_EVERY = 0.2  # [s] between two messages on the key `timeline`
LONGEST_WAIT = 0.05  # [s]
FASTEST = 1000.0
MOST_REQUESTS = 100  # for the timeline that wait; further ones are not answered
LATEST = 1e11  # UNIX time [s]
COMMANDS = ("goal", "jog", "cancel", "stop", "reset", "degrade", "obstacles", "plan")
REFUSAL = {"accepted": False, "id": None, "code": -1, "message": "this is the past: a replay takes no commands"}


class Timeline:
    """Position and speed of a replay.

    Attributes:
        begin, end: bounds of the recording, UNIX time [s].
        at: present position, UNIX time [s].
        speed: recorded seconds in a second.
        paused: whether the replay is paused.
    """

    def __init__(self, begin: float, end: float, speed: float = 1.0, *, paused: bool = False) -> None:
        self.begin, self.end, self.at, self.speed, self.paused = begin, end, begin, speed, paused

    def advance(self, seconds: float) -> None:
        """Advances the position by real time [s]."""
        if not self.paused:
            self.at = min(self.at + seconds * self.speed, self.end)

    def change(self, request: Any) -> str | None:
        """Applies a request, a mapping with `at`, `speed` or `paused`; returns why it is refused, or None."""
        if not isinstance(request, dict) or (unknown := request.keys() - {"at", "speed", "paused"}):
            what = "a mapping is needed" if not isinstance(request, dict) else f"unknown: {', '.join(sorted(unknown))}"
            return f"{what}; its fields are at, speed and paused"
        at, speed, paused = request.get("at"), request.get("speed"), request.get("paused")
        for name, value in (("at", at), ("speed", speed)):
            number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LATEST
            if value is not None and not number:
                return f"{name}: a number is needed, below {LATEST:g}"
        if speed is not None and not 0.0 < speed <= FASTEST:
            return f"speed: a number above 0 and up to {FASTEST:g} is needed"
        if paused is not None and not isinstance(paused, bool):
            return "paused: true or false is needed"
        self.at = self.at if at is None else min(max(float(at), self.begin), self.end)
        self.speed = self.speed if speed is None else float(speed)
        self.paused = self.paused if paused is None else paused
        return None

    def payload(self) -> dict[str, Any]:
        """Returns the payload of `timeline`."""
        return {"begin": self.begin, "end": self.end, "at": self.at, "speed": self.speed, "paused": self.paused}


class Player:
    """Serves a recording below `prefix`/<arm>, with the keys of the arm's daemon.

    Args:
        past: the recording.
        session: open session.
        prefix: prefix of all keys.
        timeline: position and speed at the begin.
    """

    def __init__(self, past: RecordingReader, session: zenoh.Session, prefix: str, timeline: Timeline) -> None:
        self._past, self._session, self.timeline = past, session, timeline
        self._prefix = f"{prefix}/{past.arm}"
        self._requests: queue.Queue[zenoh.Query] = queue.Queue(MOST_REQUESTS)
        description = msgspec.json.encode(past.description or {"name": past.arm})
        self._declared: list[Any] = [
            session.declare_queryable(f"{self._prefix}/arm", self._answering("arm", description)),
            *(
                session.declare_queryable(f"{self._prefix}/{key}", self._answering(key, msgspec.json.encode(REFUSAL)))
                for key in COMMANDS
            ),
            session.declare_queryable(f"{self._prefix}/timeline", self._receive),
            session.liveliness().declare_token(f"{self._prefix}/alive"),
        ]
        self._coming: Iterator[RecordedMessage] = iter(())
        self._next: RecordedMessage | None = None
        self._published_at = 0.0

    def close(self) -> None:
        """Undeclares all keys."""
        while self._declared:
            self._declared.pop().undeclare()

    def play(self, ending: Callable[[], bool], *, stay: bool, clock: Callable[[], float] = time.monotonic) -> None:
        """Publishes the messages until the recording's end; with `stay`, until `ending` returns True.

        Raises:
            BadRecording: the file is damaged.
        """
        self._seek()
        before = clock()
        while not ending():
            self._wait()
            now = clock()
            self.timeline.advance(now - before)
            before = now
            self._publish_due()
            if now >= self._published_at + PUBLISH_EVERY:
                self._publish_timeline(now)
            if self._next is None and self.timeline.at >= self.timeline.end and not stay:
                self._publish_timeline(now)
                return

    def _receive(self, query: zenoh.Query) -> None:
        with contextlib.suppress(queue.Full):  # the query ends without an answer
            self._requests.put_nowait(query)

    def _wait(self) -> None:
        """Waits for the next message or request, at most LONGEST_WAIT, and applies the request."""
        timeout = LONGEST_WAIT
        if self._next is not None and not self.timeline.paused:
            remaining = (self._next.at / 1e9 - self.timeline.at) / self.timeline.speed
            timeout = min(max(remaining, 0.0), LONGEST_WAIT)
        try:
            query = self._requests.get(timeout=timeout) if timeout else self._requests.get_nowait()
        except queue.Empty:
            return
        self._carry_out(query)

    def _carry_out(self, query: zenoh.Query) -> None:
        """Applies a request for the timeline, and answers it."""
        data = b"" if query.payload is None else query.payload.to_bytes()
        before = self.timeline.at
        try:
            refusal = self.timeline.change(decode(data) if data else {})
        except Unreadable as error:
            refusal = f"no JSON: {error}"
        if self.timeline.at != before:
            self._seek()
        answer = {"accepted": refusal is None, "message": refusal or "done", **self._timeline_payload()}
        with query:
            query.reply(f"{self._prefix}/timeline", msgspec.json.encode(answer), encoding=JSON)
        self._published_at = 0.0

    def _seek(self) -> None:
        """Continues at the timeline's position, after publishing the latest snapshots before it."""
        at = self._nanoseconds()
        for message in self._past.latest_before(at):
            self._put(message)
        self._coming = self._past.messages(at)
        self._next = next(self._coming, None)

    def _publish_due(self) -> None:
        """Publishes the messages that are due; of several states or diagnostics, only the latest."""
        due, until = [], self._nanoseconds()
        while self._next is not None and self._next.at <= until:
            due.append(self._next)
            self._next = next(self._coming, None)
        latest = {message.key: message for message in due if message.key in SNAPSHOTS}
        for message in due:
            if message.key not in SNAPSHOTS or latest[message.key] is message:
                self._put(message)

    def _nanoseconds(self) -> int:
        """Returns the position as log time [ns]; exact at both ends, where float seconds are not."""
        line, past = self.timeline, self._past
        return past.end if line.at >= line.end else past.begin if line.at <= line.begin else round(line.at * 1e9)

    def _put(self, message: RecordedMessage) -> None:
        if message.key != "timeline":  # a stranger may have published on the recorded arm's
            self._session.put(f"{self._prefix}/{message.key}", message.data, encoding=JSON)

    def _publish_timeline(self, now: float) -> None:
        self._published_at = now
        self._session.put(f"{self._prefix}/timeline", msgspec.json.encode(self._timeline_payload()), encoding=JSON)

    def _timeline_payload(self) -> dict[str, Any]:
        return {**self.timeline.payload(), "file": self._past.path.name}

    def _answering(self, key: str, data: bytes) -> Callable[[zenoh.Query], None]:
        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(f"{self._prefix}/{key}", data, encoding=JSON)

        return answer

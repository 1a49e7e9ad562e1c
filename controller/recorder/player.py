"""Replays a recording over Zenoh, below another prefix, with a time line that pages move."""

import queue
import time
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import zenoh

from controller.recorder.past import KEPT, Past, Told

JSON = zenoh.Encoding.APPLICATION_JSON
TELL_EVERY = 0.2  # [s] between two messages on the time line
LONGEST_WAIT = 0.05  # [s]
FASTEST = 1000.0
COMMANDS = ("goal", "jog", "cancel", "stop", "reset", "degrade", "obstacles", "plan")
REFUSAL = {"accepted": False, "id": None, "code": -1, "message": "this is the past: a recording is replayed"}


class Timeline:
    """Where a replay is, and how it goes on.

    Attributes:
        begin, end: of the recording, UNIX time [s].
        at: now [s].
        speed: seconds of the recording in a second.
        paused: whether it stands still.
    """

    def __init__(self, begin: float, end: float, speed: float = 1.0, *, paused: bool = False) -> None:
        self.begin, self.end, self.at, self.speed, self.paused = begin, end, begin, speed, paused

    def advance(self, seconds: float) -> None:
        """Lets time pass [s]."""
        if not self.paused:
            self.at = min(self.at + seconds * self.speed, self.end)

    def change(self, wish: Any) -> str | None:
        """Carries out a wish, a mapping with `at`, `speed` or `paused`; returns why it is refused."""
        if not isinstance(wish, dict) or (unknown := wish.keys() - {"at", "speed", "paused"}):
            what = "a mapping is needed" if not isinstance(wish, dict) else f"unknown: {', '.join(sorted(unknown))}"
            return f"{what}; at, speed and paused may be there"
        at, speed, paused = wish.get("at"), wish.get("speed"), wish.get("paused")
        for name, value in (("at", at), ("speed", speed)):
            if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
                return f"{name}: a number is needed"
        if speed is not None and not 0.0 < speed <= FASTEST:
            return f"speed: a number above 0 and up to {FASTEST:g} is needed"
        if paused is not None and not isinstance(paused, bool):
            return "paused: true or false is needed"
        self.at = self.at if at is None else min(max(float(at), self.begin), self.end)
        self.speed = self.speed if speed is None else float(speed)
        self.paused = self.paused if paused is None else paused
        return None

    def told(self) -> dict[str, Any]:
        """Returns the payload of `timeline`."""
        return {"begin": self.begin, "end": self.end, "at": self.at, "speed": self.speed, "paused": self.paused}


class Player:
    """Serves a recording as its arm's daemon would, below `prefix`/<arm>.

    Args:
        past: the recording.
        session: open session.
        prefix: of all keys.
        timeline: where it begins.
    """

    def __init__(self, past: Past, session: zenoh.Session, prefix: str, timeline: Timeline) -> None:
        self._past, self._session, self.timeline = past, session, timeline
        self._prefix = f"{prefix}/{past.arm}"
        self._wishes: queue.SimpleQueue[zenoh.Query] = queue.SimpleQueue()
        description = msgspec.json.encode(past.description or {"name": past.arm})
        self._declared: list[Any] = [
            session.declare_queryable(f"{self._prefix}/arm", self._answering("arm", description)),
            *(
                session.declare_queryable(f"{self._prefix}/{key}", self._answering(key, msgspec.json.encode(REFUSAL)))
                for key in COMMANDS
            ),
            session.declare_queryable(f"{self._prefix}/timeline", self._wishes.put),
            session.liveliness().declare_token(f"{self._prefix}/alive"),
        ]
        self._coming: Iterator[Told] = iter(())
        self._next: Told | None = None
        self._told_at = 0.0

    def close(self) -> None:
        """Takes the keys away."""
        while self._declared:
            self._declared.pop().undeclare()

    def play(self, ending: Callable[[], bool], *, stay: bool, clock: Callable[[], float] = time.monotonic) -> None:
        """Replays until the end, or with `stay` until `ending`.

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
            if now >= self._told_at + TELL_EVERY:
                self._tell(now)
            if self._next is None and self.timeline.at >= self.timeline.end and not stay:
                self._tell(now)
                return

    def _wait(self) -> None:
        """Waits for the next message or a wish, a short time at most, and carries the wish out."""
        patience = LONGEST_WAIT
        if self._next is not None and not self.timeline.paused:
            left = (self._next.at / 1e9 - self.timeline.at) / self.timeline.speed
            patience = min(max(left, 0.0), LONGEST_WAIT)
        try:
            query = self._wishes.get(timeout=patience) if patience else self._wishes.get_nowait()
        except queue.Empty:
            return
        self._carry_out(query)

    def _carry_out(self, query: zenoh.Query) -> None:
        """Carries out a wish for the time line, and answers."""
        data = b"" if query.payload is None else query.payload.to_bytes()
        before = self.timeline.at
        try:
            refusal = self.timeline.change(msgspec.json.decode(data) if data else {})
        except (msgspec.MsgspecError, RecursionError) as error:
            refusal = f"no JSON: {error}"
        if self.timeline.at != before:
            self._seek()
        answer = {"accepted": refusal is None, "message": refusal or "done", **self._told()}
        with query:
            query.reply(f"{self._prefix}/timeline", msgspec.json.encode(answer), encoding=JSON)
        self._told_at = 0.0

    def _seek(self) -> None:
        """Goes to where the time line is: tells how things stood there, then goes on from there."""
        at = self._nanoseconds()
        for told in self._past.standing(at):
            self._put(told)
        self._coming = self._past.messages(at)
        self._next = next(self._coming, None)

    def _publish_due(self) -> None:
        """Publishes what is due; of states and diagnostics that are due at once, the latest."""
        due, until = [], self._nanoseconds()
        while self._next is not None and self._next.at <= until:
            due.append(self._next)
            self._next = next(self._coming, None)
        latest = {told.key: told for told in due if told.key in KEPT}
        for told in due:
            if told.key not in KEPT or latest[told.key] is told:
                self._put(told)

    def _nanoseconds(self) -> int:
        """Returns the log time [ns]; seconds as a float are a few hundred nanoseconds beside it."""
        line, past = self.timeline, self._past
        return past.end if line.at >= line.end else past.begin if line.at <= line.begin else round(line.at * 1e9)

    def _put(self, told: Told) -> None:
        self._session.put(f"{self._prefix}/{told.key}", told.data, encoding=JSON)

    def _tell(self, now: float) -> None:
        self._told_at = now
        self._session.put(f"{self._prefix}/timeline", msgspec.json.encode(self._told()), encoding=JSON)

    def _told(self) -> dict[str, Any]:
        return {**self.timeline.told(), "file": self._past.path.name}

    def _answering(self, key: str, data: bytes) -> Callable[[zenoh.Query], None]:
        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(f"{self._prefix}/{key}", data, encoding=JSON)

        return answer

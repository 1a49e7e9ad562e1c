"""History of an arm while the panel runs: goals and results, errors and lateness over time, a log."""

import time
from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import UNSET, to_builtins

from hyperbit.controller.messages.goals import Feedback, Note, Result
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.network.fault_changes import ActiveFaults

Message = dict[str, Any]

MOST_GOALS, MOST_LINES = 30, 200
MOST_BYTES = 50_000  # of a goal that is kept to be sent again
MOST_POINTS = 600  # of each curve over time
SKIPPED = "skipped"  # status of a goal whose result a replay has not shown
LONGEST = 500  # characters of a log line


class ArmHistory:
    """History of one arm, of bounded size. `clock` returns UNIX time [s]. Not thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self.goals: deque[Message] = deque(maxlen=MOST_GOALS)
        self._goals: dict[str, Message] = {}  # what was sent, by id
        self.lines: deque[Message] = deque(maxlen=MOST_LINES)
        self.errors: deque[tuple[float, float]] = deque(maxlen=MOST_POINTS)
        self.lateness: deque[tuple[float, float]] = deque(maxlen=MOST_POINTS)
        self._mode = ""
        self._faults = ActiveFaults()

    def set_clock(self, clock: Callable[[], float]) -> None:
        """Uses the time of a replay from now on, also for earlier messages."""
        self._clock, now = clock, clock()
        for entry in (*self.lines, *self.goals):
            entry.update({name: now for name in ("at", "ended") if name in entry})
        self.errors.clear()
        self.lateness.clear()

    def rewind(self) -> None:
        """Drops entries later than the present time of a replay that was moved back."""
        now = self._clock()
        for entries in (self.lines, self.goals):
            kept = [entry for entry in entries if entry["at"] <= now]
            entries.clear()
            entries.extend(kept)
        for entry in self.goals:
            if entry["status"] == SKIPPED or entry.get("ended", now) > now:
                entry.pop("ended", None)
                entry.pop("message", None)
                entry["status"] = "running"
        for curve in (self.errors, self.lateness):
            kept_points = [point for point in curve if point[0] <= now]
            curve.clear()
            curve.extend(kept_points)

    def skip(self) -> None:
        """Marks the running goals of a replay that was moved forward: their results may be in the skipped part."""
        for entry in self.goals:
            if entry["status"] == "running":
                entry.update(status=SKIPPED, message="its end is in a skipped part of the recording")

    def say(self, text: str, kind: str = "note") -> None:
        """Adds a line to the log; `kind` is "note", "warning" or "fault"."""
        self.lines.append({"at": self._clock(), "kind": kind, "text": text[:LONGEST]})

    def request(self, note: Note) -> None:
        if note.key in ("goal", "jog") and note.answer.accepted and note.answer.id:
            self.sent(note.answer.id, note.payload if isinstance(note.payload, dict) else {})

    def sent(self, name: str, goal: Message) -> None:
        """Records an accepted goal, or a jog, which has no waypoints."""
        points = goal.get("waypoints")
        entry = self.goal(name, len(points) if isinstance(points, list) else 1)
        again = {field: value for field, value in goal.items() if field not in ("id", "stamp")}
        if points and len(msgspec.json.encode(again)) <= MOST_BYTES:
            entry["again"] = True
            self._goals[name] = again
            for old in self._goals.keys() - {it["id"] for it in self.goals}:
                del self._goals[old]

    def goal_of(self, name: str) -> Message | None:
        """Returns a goal that was sent, without its id and time stamp; None if it is not kept."""
        return self._goals.get(name)

    def goal(self, name: str, waypoints: int | None) -> Message:
        for entry in reversed(self.goals):
            if entry["id"] == name:
                entry["waypoints"] = waypoints or entry["waypoints"]
                return entry
        fresh: Message = {"id": name, "at": self._clock(), "waypoints": waypoints, "reached": 0, "status": "running"}
        self.goals.append(fresh)
        return fresh

    def has_result(self, name: object) -> bool:
        return any(entry["id"] == name and entry["status"] != "running" for entry in self.goals)

    def feedback(self, feedback: Feedback) -> None:
        """Records feedback: the arm has settled at a waypoint."""
        entry = self.goal(str(feedback.id), feedback.waypoints)
        entry["reached"] = (feedback.waypoint or 0) + 1
        self._error(feedback.error)

    def result(self, result: Result) -> None:
        if result.id is None:  # a refused put
            self.say(f"a request was refused: {result.message}", "warning")
            return
        entry, told = self.goal(result.id, None), to_builtins(result)
        fields = ("status", "code", "message", "switches", "error", "certificate", "travels")
        entry.update({name: told[name] for name in fields if name in told}, ended=self._clock())
        self.say(
            f"{result.id}: {result.status}, {result.message}", "note" if result.status == "succeeded" else "warning"
        )
        if entry["waypoints"] in (None, 1):
            self._error(result.error)

    def state(self, state: State) -> bool:
        """Logs changes of mode and faults; returns whether there were any."""
        before = len(self.lines), self.lines[-1]["at"] if self.lines else 0.0
        if (mode := state.mode) != self._mode:
            self._mode = mode
            self.say(f"{mode}: {state.reason}", "fault" if mode == "fault" else "note")
        for entry in self.goals:
            if entry["status"] == SKIPPED and entry["id"] == state.goal:
                entry.pop("message")
                entry["status"] = "running"
        changes = self._faults.take(state)
        for (code, _), message in changes.came.items():
            self.say(f"{code}: {message}", "fault" if mode == "fault" else "warning")
        for code, source in changes.went:
            self.say(f"{code} of {source} is gone")
        return (len(self.lines), self.lines[-1]["at"] if self.lines else 0.0) != before

    def diagnostics(self, diagnostics: Diagnostics) -> None:
        """Records the worst lateness of the executor's loop in the last second."""
        if (late := diagnostics.loop.late_worst) is not UNSET:
            self.lateness.append((self._clock(), late))

    def _error(self, error: float | None) -> None:
        if error is not None:
            self.errors.append((self._clock(), error))

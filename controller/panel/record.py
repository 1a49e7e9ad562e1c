"""What happened to an arm while the panel ran: goals and their results, errors and lateness over time, a log."""

import time
from collections import deque
from collections.abc import Mapping
from typing import Any

Message = dict[str, Any]

MOST_GOALS, MOST_LINES = 30, 200
MOST_POINTS = 600  # of each curve over time
LONGEST = 500  # characters of a line


class Record:
    """The past of one arm, bounded. One thread's."""

    def __init__(self) -> None:
        self.goals: deque[Message] = deque(maxlen=MOST_GOALS)
        self.lines: deque[Message] = deque(maxlen=MOST_LINES)
        self.errors: deque[tuple[float, float]] = deque(maxlen=MOST_POINTS)
        self.lateness: deque[tuple[float, float]] = deque(maxlen=MOST_POINTS)
        self._mode = ""
        self._faults: frozenset[tuple[str, str]] = frozenset()

    def say(self, text: str, kind: str = "note") -> None:
        """Adds a line to the log; `kind` is "note", "warning" or "fault"."""
        self.lines.append({"at": time.time(), "kind": kind, "text": text[:LONGEST]})

    def request(self, told: Mapping[str, Any]) -> None:
        """Takes the goals and jogs of other programs that the daemon tells."""
        answer = told.get("answer") or {}
        if told.get("key") not in ("goal", "jog") or not answer.get("accepted"):
            return
        payload = told.get("payload")
        waypoints = payload.get("waypoints") if isinstance(payload, dict) else None
        self.goal(str(answer.get("id")), len(waypoints) if isinstance(waypoints, list) else 1)

    def goal(self, name: str, waypoints: int | None) -> Message:
        """Returns the entry of a goal, a new one if there is none."""
        for entry in reversed(self.goals):
            if entry["id"] == name:
                entry["waypoints"] = waypoints or entry["waypoints"]
                return entry
        fresh: Message = {"id": name, "at": time.time(), "waypoints": waypoints, "reached": 0, "status": "running"}
        self.goals.append(fresh)
        return fresh

    def feedback(self, told: Mapping[str, Any]) -> None:
        """Takes feedback: a waypoint is settled."""
        entry = self.goal(str(told.get("id")), told.get("waypoints"))
        entry["reached"] = int(told.get("waypoint") or 0) + 1
        self._error(told)

    def result(self, told: Mapping[str, Any]) -> None:
        """Takes a result."""
        if told.get("id") is None:  # of a put that was refused
            self.say(f"a request was refused: {told.get('message')}", "warning")
            return
        entry = self.goal(str(told["id"]), None)
        taken = ("status", "code", "message", "switches", "error", "certificate", "travels")
        entry.update({name: told[name] for name in taken if name in told}, ended=time.time())
        succeeded = told.get("status") == "succeeded"
        self.say(f"{told['id']}: {told.get('status')}, {told.get('message')}", "note" if succeeded else "warning")
        if entry["waypoints"] in (None, 1):
            self._error(told)

    def state(self, told: Mapping[str, Any]) -> bool:
        """Notes changes of mode and faults; returns whether there are any."""
        before = len(self.lines), self.lines[-1]["at"] if self.lines else 0.0
        if (mode := str(told.get("mode"))) != self._mode:
            self._mode = mode
            self.say(f"{mode}: {told.get('reason')}", "fault" if mode == "fault" else "note")
        faults = {(str(fault["code"]), str(fault["source"])): fault for fault in told.get("faults", ())}
        for key in faults.keys() - self._faults:
            self.say(f"{key[0]}: {faults[key]['message']}", "fault" if mode == "fault" else "warning")
        for code, source in self._faults - faults.keys():
            self.say(f"{code} of {source} is gone")
        self._faults = frozenset(faults)
        return (len(self.lines), self.lines[-1]["at"] if self.lines else 0.0) != before

    def diagnostics(self, told: Mapping[str, Any]) -> None:
        """Takes how late the executor's loop was at worst in the last second."""
        late = (told.get("loop") or {}).get("late_worst")
        if isinstance(late, int | float):
            self.lateness.append((time.time(), float(late)))

    def _error(self, told: Mapping[str, Any]) -> None:
        if isinstance(error := told.get("error"), int | float):
            self.errors.append((time.time(), float(error)))

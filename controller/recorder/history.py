"""The requests of a recording: goals with the reached configurations, and changes between the goals."""

import bisect
from collections import defaultdict, deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import msgspec

from hyperbit.controller.recorder.reader import RecordingReader
from hyperbit.controller.recorder.repair import guarded

Message = Mapping[str, Any]

CHANGES = ("degrade", "obstacles")  # requests that affect the plans of later goals
OUT_OF_REACH = -5


class RecordedGoal(NamedTuple):
    """A recorded goal.

    Attributes:
        id: id in the daemon's answer.
        stamp: time of receipt, UNIX time [s].
        payload: payload as received.
        accepted: whether the daemon accepted it.
        start: configuration before the goal, as text; None if unknown.
        moving: whether the arm was moving when the goal was received.
        configurations: measured configuration at each waypoint, by its number.
        result: payload of the result; None if there was none.
    """

    id: str
    stamp: float
    payload: dict[str, Any]
    accepted: bool
    start: str | None
    moving: bool
    configurations: dict[int, str | None]
    result: Message | None

    @property
    def incomparable(self) -> str | None:
        """Why the goal cannot be compared with a simulation; None if it can."""
        if not self.accepted:
            return None
        if self.start is None:
            return "the configuration before it is unknown"
        if self.moving:
            return "it began while the arm moved"
        if self.result is None:
            return "the recording ends before its result"
        if self.result.get("status") != "succeeded":
            return f"it ended as {self.result.get('status')}"
        if any(self.result.get("bias") or ()):
            return "measured tips corrected it"
        return None


class RecordedChange(NamedTuple):
    """A recorded request that affects the plans of later goals: its key and payload."""

    key: str
    payload: dict[str, Any]


def history(past: RecordingReader) -> list[RecordedGoal | RecordedChange]:
    """Returns the goals of a recording and the changes between them, ordered by time.

    Raises:
        BadRecording: the file is damaged.
    """
    with guarded(past.path):
        return read_history(past)


def read_history(past: RecordingReader) -> list[RecordedGoal | RecordedChange]:
    """Returns the same as `history`; raises nearly any exception if a message has another form."""
    notes: list[Message] = []
    states: list[tuple[float, Message]] = []
    feedback: dict[str, deque[dict[int, str | None]]] = defaultdict(lambda: deque([{}]))
    results: dict[str, deque[Message]] = defaultdict(deque)
    for entry in past.messages():
        if entry.key not in ("request", "state", "feedback", "result"):
            continue
        message = msgspec.json.decode(entry.data)
        name = str(message.get("id"))
        match entry.key:
            case "request":
                notes.append(message)
            case "state" if brief(message) != (brief(states[-1][1]) if states else None):
                states.append((message.get("stamp", 0.0), message))
            case "feedback":
                feedback[name][-1][int(message.get("waypoint", -1))] = message.get("configuration")
            case "result" if not (message.get("repeated") and results[name]):
                results[name].append(message)
                feedback[name].append({})  # an id may be used again
    steps: list[RecordedGoal | RecordedChange] = list(initial_changes(past, states[0][1] if states else {}))
    stamps = [stamp for stamp, _ in states]
    for note in sorted(notes, key=lambda note: note.get("stamp", 0.0)):
        payload, answer = note.get("payload"), note.get("answer") or {}
        if not isinstance(payload, dict):
            continue
        if note.get("key") in CHANGES and answer.get("accepted"):
            steps.append(RecordedChange(note["key"], payload))
        if note.get("key") != "goal" or not (answer.get("accepted") or answer.get("code") == OUT_OF_REACH):
            continue
        name, accepted, stamp = str(answer.get("id")), bool(answer.get("accepted")), note.get("stamp", 0.0)
        before = states[max(bisect.bisect_right(stamps, stamp) - 1, 0)][1] if states else {}
        there = feedback[name].popleft() if accepted and feedback[name] else {}
        result = results[name].popleft() if accepted and results[name] else None
        start, moving = before.get("configuration"), before.get("mode") == "executing"
        steps.append(RecordedGoal(name, stamp, payload, accepted, start, moving, there, result))
    return steps


def initial_changes(past: RecordingReader, state: Message) -> list[RecordedChange]:
    """Returns the changes that restore the arm at the begin of the recording: locked actuators, sent obstacles."""
    locked = [RecordedChange("degrade", dict(entry)) for entry in state.get("degraded") or ()]
    regions = (past.description or {}).get("sent_obstacles")
    return [*locked, RecordedChange("obstacles", {"regions": regions})] if regions else locked


def brief(state: Message) -> tuple[Any, ...]:
    """Returns the fields of a state that goals depend on."""
    return state.get("mode"), state.get("configuration"), state.get("goal")

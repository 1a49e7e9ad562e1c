"""What a recording tells of requests: goals with the configurations that they led to, and changes between them."""

import bisect
from collections import defaultdict, deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import msgspec

from controller.recorder.past import Past

Message = Mapping[str, Any]

CHANGES = ("degrade", "obstacles")  # requests that goals are planned by
OUT_OF_REACH = -5


class Goal(NamedTuple):
    """A recorded goal.

    Attributes:
        id: as answered.
        stamp: when it was received, UNIX time [s].
        payload: as it came.
        accepted: whether it was.
        start: configuration before it, as text; None if it is not known.
        moving: whether the arm moved then.
        configurations: measured at each waypoint, by its number.
        result: its payload; None if there was none.
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
    def obstacle(self) -> str | None:
        """Why it cannot be compared; None if it can."""
        if not self.accepted:
            return None
        if self.start is None:
            return "the arm was in no known configuration"
        if self.moving:
            return "it began while the arm moved"
        if self.result is None:
            return "the recording ends before it"
        if self.result.get("status") != "succeeded":
            return f"it ended as {self.result.get('status')}"
        if any(self.result.get("bias") or ()):
            return "it was corrected by the tracker"
        return None


class Change(NamedTuple):
    """A recorded request that goals are planned by: its key and payload."""

    key: str
    payload: dict[str, Any]


def history(past: Past) -> list[Goal | Change]:
    """Returns the goals of a recording, and the changes between them, in the order of time.

    Raises:
        BadRecording: the file is damaged.
    """
    notes: list[Message] = []
    states: list[tuple[float, Message]] = []
    feedback: dict[str, deque[dict[int, str | None]]] = defaultdict(lambda: deque([{}]))
    results: dict[str, deque[Message]] = defaultdict(deque)
    for told in past.messages():
        if told.key not in ("request", "state", "feedback", "result"):
            continue
        message = msgspec.json.decode(told.data)
        name = str(message.get("id"))
        match told.key:
            case "request":
                notes.append(message)
            case "state" if brief(message) != (brief(states[-1][1]) if states else None):
                states.append((message.get("stamp", 0.0), message))
            case "feedback":
                feedback[name][-1][message.get("waypoint", -1)] = message.get("configuration")
            case "result":
                results[name].append(message)
                feedback[name].append({})  # an id may come again
    steps: list[Goal | Change] = list(standing(past, states[0][1] if states else {}))
    stamps = [stamp for stamp, _ in states]
    for note in sorted(notes, key=lambda note: note.get("stamp", 0.0)):
        payload, answer = note.get("payload"), note.get("answer") or {}
        if not isinstance(payload, dict):
            continue
        if note.get("key") in CHANGES and answer.get("accepted"):
            steps.append(Change(note["key"], payload))
        if note.get("key") != "goal" or not (answer.get("accepted") or answer.get("code") == OUT_OF_REACH):
            continue
        name, accepted, stamp = str(answer.get("id")), bool(answer.get("accepted")), note.get("stamp", 0.0)
        before = states[max(bisect.bisect_right(stamps, stamp) - 1, 0)][1] if states else {}
        there = feedback[name].popleft() if accepted and feedback[name] else {}
        result = results[name].popleft() if accepted and results[name] else None
        start, moving = before.get("configuration"), before.get("mode") == "executing"
        steps.append(Goal(name, stamp, payload, accepted, start, moving, there, result))
    return steps


def standing(past: Past, state: Message) -> list[Change]:
    """Returns the changes that make an arm as it was when the recording began: locked actuators, sent obstacles."""
    locked = [Change("degrade", dict(entry)) for entry in state.get("degraded") or ()]
    regions = (past.description or {}).get("sent_obstacles")
    return [*locked, Change("obstacles", {"regions": regions})] if regions else locked


def brief(state: Message) -> tuple[Any, ...]:
    """Returns what goals are compared by."""
    return state.get("mode"), state.get("configuration"), state.get("goal")

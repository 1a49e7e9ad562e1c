"""The account of one action: its goals as clients see them on the wire."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from tests.ros2.client import ABORTED, ACCEPTED, CANCELED, CANCELING, EXECUTING, SUCCEEDED, Reading

ACTIVE, ENDS = (ACCEPTED, EXECUTING, CANCELING), (SUCCEEDED, CANCELED, ABORTED)
LEGAL = {
    (ACCEPTED, EXECUTING),
    (ACCEPTED, CANCELING),
    (ACCEPTED, ABORTED),  # the end of the server takes both steps at once
    (EXECUTING, CANCELING),
    *((before, end) for before in (EXECUTING, CANCELING) for end in (SUCCEEDED, ABORTED)),
    (CANCELING, CANCELED),
}
KEPT = 50.0  # [s] for which a result is kept at least
MOST_KNOWN = 30  # requests of goals after which an earlier result may be forgotten; two actions share 64
NO_UUID = bytes(16)
NONE, UNKNOWN_GOAL, TERMINATED = 0, 2, 3


class Wrong(BaseException):
    """The bridge has broken a rule. No `except Exception` of the bridge catches it."""


class Result(NamedTuple):
    status: int
    code: int
    text: str


@dataclass
class Goal:
    """A goal of the action.

    Attributes:
        joints: of its trajectory; none: not known.
        status: last one on the wire; 0: none yet.
        canceled: whether a cancel was accepted.
        ended: when it ended [s].
        result: first one that a client received.
        told: what the daemon had told of it when it ended: code and sentence.
        later: requests of goals that came after its acceptance.
    """

    uuid: bytes
    joints: list[str]
    status: int = 0
    canceled: bool = False
    ended: float = 0.0
    result: Result | None = None
    told: tuple[tuple[int, str], ...] = ()
    later: int = 0

    @property
    def id(self) -> str:
        return f"ros2-{self.uuid.hex()}"

    @property
    def active(self) -> bool:
        return self.status not in ENDS


class Actions:
    """All goals of an action.

    Attributes:
        goals: by id, in the order of acceptance.
        orphans: ids of goals whose clients had no answer when the bridge was killed.
        doubtful: ids of goals that may be canceled: their clients had no answer to a cancel.
        opening: whether a bridge restores its goals.

    Args:
        clock: returns the time [s].
    """

    def __init__(
        self, clock: Callable[[], float], on_end: Callable[[Goal], None], on_cancel: Callable[[Goal], None]
    ) -> None:
        self._clock, self._on_end, self._on_cancel = clock, on_end, on_cancel
        self.goals: dict[bytes, Goal] = {}
        self.orphans: dict[bytes, list[str]] = {}
        self.doubtful: set[bytes] = set()
        self.opening = False
        self.accepted = self.ended = 0

    def receive_request(self) -> None:
        for goal in self.goals.values():
            goal.later += 1

    def receive_acceptance(self, uuid: bytes, joints: list[str]) -> None:
        """Accepts that a client is told that its goal is accepted."""
        if uuid in self.goals and self.goals[uuid].active:
            raise Wrong(f"goal {uuid.hex()} is accepted twice")
        self.goals.pop(uuid, None)
        self.goals[uuid] = Goal(uuid, joints)
        self.orphans.pop(uuid, None)
        self.doubtful.discard(uuid)
        self.accepted += 1

    def receive_status(self, data: bytes) -> None:
        reading, states = Reading(data), {}
        for _ in range(reading.get("I")):
            uuid = reading.raw(16)
            states[uuid] = (reading.get("i"), reading.get("I"), reading.get("b"))[2]
        for uuid, status in states.items():
            if uuid in self.orphans and status in ACTIVE and not (uuid in self.goals and self.goals[uuid].active):
                self.goals.pop(uuid, None)
                self.goals[uuid] = Goal(uuid, self.orphans.pop(uuid), EXECUTING)
                self.accepted += 1
            if uuid not in self.goals:
                raise Wrong(f"a status tells of goal {uuid.hex()}, which was not accepted")
            self._step(self.goals[uuid], status)
        for goal in self.goals.values():
            if goal.active and goal.uuid not in states and not self.opening:
                raise Wrong(f"goal {goal.uuid.hex()} has gone without a result")

    def _step(self, goal: Goal, status: int) -> None:
        old, goal.status = goal.status, status
        if status == old:
            return
        if (old or ACCEPTED, status) not in LEGAL and not (old == 0 and status == ACCEPTED):
            raise Wrong(f"goal {goal.uuid.hex()} has come from status {old} to {status}")
        if status == CANCELING and not goal.canceled:
            if goal.uuid not in self.doubtful:
                raise Wrong(f"goal {goal.uuid.hex()} is canceling, and no cancel was accepted")
            goal.canceled = True
        if status in ENDS:
            goal.ended = self._clock()
            self.ended += 1
            self._on_end(goal)

    def receive_cancel(self, asked: bytes, data: bytes) -> None:
        """Accepts the answer to a cancel; `asked` is its request."""
        reading = Reading(data)
        code, told = reading.get("b"), []
        for _ in range(reading.get("I")):
            told.append(reading.raw(16))
            reading.get("i"), reading.get("I")
        uuid, timed = asked[4:20], any(asked[20:28])
        able = [it.uuid for it in self.goals.values() if it.active and not it.canceled]
        goal = self.goals.get(uuid)
        if set(told) - set(able) or (told and code != NONE):
            raise Wrong(
                f"a cancel is answered {code} for {[it.hex() for it in told]}, of which some cannot be canceled"
            )
        if uuid == NO_UUID and not timed and set(told) != set(able):
            raise Wrong("a cancel of all goals leaves some out")
        if uuid != NO_UUID and not timed and uuid not in self.orphans | dict.fromkeys(self.doubtful):
            if uuid in able:
                expected = (NONE,)
            elif goal is not None and goal.active:
                expected = (TERMINATED,)
            else:
                expected = (UNKNOWN_GOAL,) if goal is None else (TERMINATED, UNKNOWN_GOAL)
            if code not in expected or told != [uuid] * (code == NONE):
                raise Wrong(f"a cancel of goal {uuid.hex()} is answered {code}, expected {expected}")
        for it in told:
            self.goals[it].canceled = True
            self._on_cancel(self.goals[it])

    def receive_result(self, uuid: bytes, data: bytes) -> tuple[Goal, Result] | None:
        """Accepts an answer to get_result; returns it with its goal if it is the first of an ended goal."""
        reading = Reading(data)
        result = Result(reading.get("b"), reading.get("i"), reading.text())
        goal = self.goals.get(uuid)
        if result.status == 0:
            if goal is not None and uuid not in self.orphans and (goal.active or self._is_kept(goal)):
                raise Wrong(f"{goal} is told to be unknown at {self._clock():.2f}")
            return None
        if goal is None:
            raise Wrong(f"goal {uuid.hex()} has a result, and was not accepted")
        if goal.result not in (None, result):
            raise Wrong(f"goal {uuid.hex()} has two results: {goal.result} and {result}")
        if result.status not in ENDS or goal.status not in (result.status, EXECUTING, CANCELING):
            raise Wrong(f"goal {uuid.hex()} has status {goal.status}, and {result}")
        first, goal.result = goal.result is None, result
        return (goal, result) if first else None

    def _is_kept(self, goal: Goal) -> bool:
        """Returns whether the result of an ended goal must be known still."""
        return self._clock() < goal.ended + KEPT and goal.later < MOST_KNOWN

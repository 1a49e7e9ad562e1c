"""What the table of faults on the executor's page makes of one fault of an otherwise undisturbed world."""

from __future__ import annotations

from typing import NamedTuple

from hyperbit.controller.program import Snapshot
from tests.simulation.judge.snapshots import STANDING
from tests.simulation.judge.verdict import require

CLEARING = frozenset({"bus-down", "bus-off", "bus-busy", "board-lost", "board-missing", "pulse-overdue"})
WARNINGS = STANDING | {"bus-passive", "journal"}


class Expected(NamedTuple):
    """What must be told of a fault.

    Attributes:
        codes: one of them must be told; empty: nothing may be told.
        sources: of which the source of this fault must be one, perhaps with its place in brackets.
        within: time from the cause until it is told [s].
        also: codes that may be told as well.
        cleared: whether the arm becomes ready without a reset when the cause is gone.
        words: words that the message of this fault must contain.
        locks: label of an actuator, and whether it is locked when the arm is ready again; None: nothing is judged.
        asks: whether the executor must ask the planner about a stage.
        refused: reason for which a reset is refused while the cause is there; "" if it is not.
    """

    codes: frozenset[str]
    sources: tuple[str, ...]
    within: float
    also: frozenset[str] = frozenset()
    cleared: bool = False
    refused: str = ""
    words: tuple[str, ...] = ()
    locks: tuple[str, bool] | None = None
    asks: bool = False


def _names(source: str, name: str) -> bool:
    return source == name or source.startswith(f"{name} (")


def told(expected: Expected, snapshot: Snapshot | None) -> bool:
    """Returns whether a snapshot tells the expected fault, and judges all that it tells.

    Raises:
        Violation: it tells a fault without a cause, or in a wrong mode.
    """
    if snapshot is None:
        return False
    found = False
    for fault in snapshot.faults:
        if fault.code in STANDING:
            continue
        ours = fault.code in expected.codes
        require(ours or fault.code in expected.also, f"{fault} is told; only {sorted(expected.codes)} has a cause")
        if ours:
            right = not expected.sources or any(_names(fault.source, word) for word in expected.sources)
            require(right or fault.code in expected.also, f"{fault} is told; its source is in {expected.sources}")
            worded = not right or all(word in fault.message for word in expected.words)
            require(worded, f"{fault} is told; its sentence has {expected.words}")
            found |= right
    stops = any(fault.code not in WARNINGS for fault in snapshot.faults)
    if stops:
        require(snapshot.mode in ("fault", "starting", "stopped"), f"mode {snapshot.mode} with {snapshot.faults}")
    elif snapshot.mode == "fault":
        require(False, f"mode fault, and only warnings are told: {snapshot.faults}")
    return found


def judge_locks(expected: Expected, snapshot: Snapshot | None) -> None:
    if expected.locks is None or snapshot is None or snapshot.mode != "ready":
        return
    label, locked = expected.locks
    told = any(fault.code == "degraded" and fault.source == label for fault in snapshot.faults)
    require(told == locked, f"actuator {label} is told as locked: {told}; the arm continues on stuck: {locked}")

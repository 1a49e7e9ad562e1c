"""Locked actuators in words, the same for planner and executor."""

from collections.abc import Iterable

STATES = ("contracted", "extended")  # of the states 0 and 1


def locks_in_words(locks: Iterable[tuple[str, int]]) -> str:
    """Returns locked actuators, each with its label and state, in words, e.g. "locked: 5.left (contracted)"."""
    names = [f"{label} ({STATES[state]})" for label, state in locks]
    return f"locked: {', '.join(names)}" if names else "no actuator is locked"


def lock_warning(label: str, state: int) -> str:
    """Returns the message of the warning "degraded" of a locked actuator."""
    return f"actuator {label} is locked {STATES[state]}: plans do not switch it"

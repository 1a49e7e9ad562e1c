"""Which faults of an arm came and went from one of its states to the next."""

from typing import NamedTuple

from hyperbit.controller.messages.state import State

Key = tuple[str, str]  # code and source


class Changes(NamedTuple):
    """Faults that came, with their sentences, and those that went."""

    came: dict[Key, str]
    went: list[Key]


class ActiveFaults:
    """The faults and warnings in an arm's last state. Not thread-safe."""

    def __init__(self) -> None:
        self._last: dict[Key, str] = {}

    def take(self, state: State) -> Changes:
        """Takes a `state`; returns what has changed since the one before."""
        last, self._last = self._last, active(state)
        came = {key: message for key, message in self._last.items() if key not in last}
        return Changes(came, sorted(last.keys() - self._last.keys()))


def active(state: State) -> dict[Key, str]:
    """Returns the sentence of each fault and warning."""
    return {(fault.code, fault.source): fault.message for fault in state.faults}

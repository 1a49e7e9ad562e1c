"""Which faults of an arm came and went from one of its states to the next."""

from collections.abc import Mapping
from typing import Any, NamedTuple

Key = tuple[str, str]  # code and source


class Changes(NamedTuple):
    """Faults that came, with their sentences, and those that went."""

    came: dict[Key, str]
    went: list[Key]


class ActiveFaults:
    """The faults and warnings in an arm's last state. Not thread-safe."""

    def __init__(self) -> None:
        self._last: dict[Key, str] = {}

    def take(self, state: Mapping[str, Any]) -> Changes:
        """Takes a payload of `state`; returns what has changed since the one before."""
        last, self._last = self._last, active(state)
        came = {key: message for key, message in self._last.items() if key not in last}
        return Changes(came, sorted(last.keys() - self._last.keys()))


def active(state: Mapping[str, Any]) -> dict[Key, str]:
    """Returns the sentence of each fault and warning in a payload of `state`."""
    return {(str(it["code"]), str(it["source"])): str(it["message"]) for it in state.get("faults") or ()}

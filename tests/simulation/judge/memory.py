"""Memory: no container of the executor's core grows without a bound, whatever its clients do."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Any

from tests.simulation.judge.verdict import require

CONTAINERS = (dict, list, set, deque)
PLAIN = (int, float, str, bytes, bool, type(None), Enum, type, tuple, frozenset)
ROOM = 25  # elements of all containers beyond those of an arm at rest at its first calm


def sizes(root: object) -> dict[str, int]:
    """Returns the number of elements of each container that an object holds, by the attributes that lead there.

    Functions and what they refer to are left out. Elements of containers are walked, too.
    """
    found: dict[str, int] = {}
    seen = {id(root)}
    waiting: list[tuple[str, Any]] = [("", root)]
    while waiting:
        path, thing = waiting.pop()
        if isinstance(thing, CONTAINERS):
            found[path] = found.get(path, 0) + len(thing)
        for name, part in _parts(thing):
            if not isinstance(part, PLAIN) and not callable(part) and id(part) not in seen:
                seen.add(id(part))
                waiting.append((f"{path}{name}", part))
    return found


def _parts(thing: object) -> Iterable[tuple[str, Any]]:
    if isinstance(thing, Mapping):
        return (("[]", value) for value in list(thing.values()))
    if isinstance(thing, list | set | deque):
        return (("[]", value) for value in list(thing))
    fields = getattr(thing, "__dict__", None)
    return () if fields is None else ((f".{name}", value) for name, value in list(fields.items()))


class Memory:
    """Compares the containers of one process at rest with those at its first rest."""

    def __init__(self) -> None:
        self._instance, self._first = 0, dict[str, int]()

    def judge(self, instance: int, core: object, owed: int) -> None:
        """Judges the containers of a process at rest.

        Args:
            core: walked, and nothing else is asked of it.
            owed: number of results that the planner has not acknowledged.
        """
        now = sizes(core)
        if instance != self._instance:
            self._instance, self._first = instance, now
        total, first = sum(now.values()), sum(self._first.values())
        grown = {path: size for path, size in now.items() if size > self._first.get(path, 0) + 4}
        require(total <= first + ROOM + owed, f"the containers have grown from {first} to {total} elements: {grown}")

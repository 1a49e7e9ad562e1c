"""The statement on containers: none grows without a bound, whatever the clients do."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Any

from tests.simulation.statements.account import Account
from tests.simulation.statements.statement import Statement

CONTAINERS = (dict, list, set, deque)
ROOM = 25  # elements of all containers beyond those of an arm at its first rest
PLAIN = (int, float, str, bytes, bool, type(None), Enum, type, tuple, frozenset)


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


class ContainersReturnToTheirSize(Statement):
    """At rest the containers of the executor's core have the size of its first rest, up to results that are owed."""

    number = 12

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._instance, self._first = 0, dict[str, int]()

    def rests(self) -> None:
        account, now = self.account, sizes(self.account.world.executor.core)
        if account.instance != self._instance:
            self._instance, self._first = account.instance, now
        total, first = sum(now.values()), sum(self._first.values())
        grown = {path: size for path, size in now.items() if size > self._first.get(path, 0) + 4}
        room = ROOM + len(account.owed)
        self.require(total <= first + room, f"the containers have grown from {first} to {total}: {grown}")

"""No container grows without a bound, whatever the clients do."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Set
from enum import Enum
from typing import TYPE_CHECKING, Any

from tests.simulation.statements.account import Account
from tests.simulation.statements.statement import Statement
from tests.simulation.verdict import require

if TYPE_CHECKING:
    from tests.simulation.whole.planner_process import PlannerProcess

ROOMS = ("hyperbit.controller.planning.core", "hyperbit.controller.planning.loop", "hyperbit.controller.gateway")
MOST = 24  # entries of a container when nothing is asked for
HISTORIES = {  # greatest lengths of those that keep what is over
    "Admission.canceled": 256,
    "Admission.unresolved": 256,
    "RepeatedGoals.known": 1_000,
    "Results._told": 10**6,  # one identity for each goal of the process
    "Rate._times": 100,
}
OPAQUE = ("_manipulator", "manipulator", "_arm", "_description", "_densities", "publishers", "_tracker", "_filter")
ROOM = 25  # elements of all containers beyond those of an arm at its first rest
PLAIN = (int, float, str, bytes, bool, type(None), Enum, type, tuple)


def lengths(
    roots: Iterable[object], walks: Callable[[object], bool], opaque: Collection[str] = ()
) -> Iterator[tuple[str, int]]:
    """Yields name and length of each container that objects hold; what `walks` accepts is walked, too.

    Attributes of the names `opaque` are left out.
    """
    seen, todo = set[int](), list(roots)
    while todo:
        owner = todo.pop()
        if id(owner) in seen:
            continue
        seen.add(id(owner))
        waiting = [
            (f"{type(owner).__name__}.{name}", value) for name, value in list(vars(owner).items()) if name not in opaque
        ]
        while waiting:
            name, value = waiting.pop()
            if isinstance(value, Mapping | Set | list | deque):
                yield name, len(value)
                parts: Iterable[Any] = list(value.values()) if isinstance(value, Mapping) else list(value)
                waiting += [(f"{name}[]", part) for part in parts if not isinstance(part, PLAIN)]
            elif hasattr(value, "__dict__") and walks(value):
                todo.append(value)


def is_walked(value: object) -> bool:
    """Returns whether an object of the executor is walked: functions and what they refer to are left out."""
    return not isinstance(value, PLAIN) and not callable(value)


class ContainersReturnToTheirSize(Statement):
    """At rest the containers of the executor's core have the size of its first rest, up to results that are owed."""

    number = 12

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._instance, self._first = 0, Counter[str]()

    def rests(self) -> None:
        account, now = self.account, Counter[str]()
        for name, length in lengths([account.world.executor.core], is_walked):
            now[name] += length
        if account.instance != self._instance:
            self._instance, self._first = account.instance, now
        total, first = sum(now.values()), sum(self._first.values())
        grown = {path: size for path, size in now.items() if size > self._first[path] + 4}
        room = ROOM + len(account.owed)
        self.require(total <= first + room, f"the containers have grown from {first} to {total}: {grown}")


def check_containers(process: PlannerProcess) -> None:
    """Checks that no container has grown, when all requests are answered and all goals have ended."""
    roots = process.core, process.server, process.outbox, process.goals, process.loop
    for name, length in lengths(roots, ours, OPAQUE):
        require(length <= HISTORIES.get(name, MOST), f"{name} has {length} entries, and nothing is asked for")


def ours(value: object) -> bool:
    """Returns whether an object is of the planner or the gateway."""
    return type(value).__module__.startswith(ROOMS) and not isinstance(value, tuple)

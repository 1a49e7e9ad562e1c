"""The form of a statement: one sentence that must hold in the world, judged over the account; and who tells it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from tests.simulation.verdict import Violation

if TYPE_CHECKING:
    from tests.simulation.statements.account import Account


class Statement:
    """One sentence that must hold in the world. The docstring of a subclass is the sentence.

    A subclass has a method for each kind of fact that it looks at; the method's name is the kind, see `Account`. It
    sees a fact before the account takes it: the account has what was before.

    Attributes:
        number: of the statement in the table of README.md.
        least: how often a long run must have armed it.
        armed: how often it could have failed.
        reached: how many facts it has seen.
    """

    number = 0
    least = 1

    def __init__(self, account: Account) -> None:
        self.account = account
        self.armed = self.reached = 0

    @classmethod
    def title(cls) -> str:
        return f"statement {cls.number:2} {cls.__name__}"

    def require(self, holds: object, text: Callable[[], str] | str) -> None:
        """Arms the statement. Raises `Violation` with time and facts if it does not hold."""
        self.armed += 1
        if not holds:
            facts = text if isinstance(text, str) else text()
            raise Violation(f"{self.number} {type(self).__name__}, {self.account.now - 1000:.6f} s: {facts}")


class Statements:
    """All statements of a world; hands each fact to those that look at its kind."""

    def __init__(self, every: Iterable[Statement]) -> None:
        self.every = list(every)
        self._takers: dict[str, list[tuple[Statement, Callable[..., None]]]] = {}

    def see(self, kind: str, facts: tuple[Any, ...]) -> None:
        takers = self._takers.get(kind)
        if takers is None:
            found = ((one, getattr(one, kind, None)) for one in self.every)
            takers = self._takers[kind] = [(one, method) for one, method in found if method is not None]
        for one, method in takers:
            one.reached += 1
            method(*facts)

    def counts(self) -> Counter[str]:
        """Returns how often each statement was reached and armed."""
        counts: Counter[str] = Counter()
        for one in self.every:
            if not one.number:
                continue
            counts[f"{one.title()}: armed"] += one.armed
            counts[f"{one.title()}: reached"] += one.reached
        return counts


class Witness:
    """Sees what the executor's process takes and does: a fact of a kind calls the method of this name, see `Account`.

    What `sends` returns belongs to the frame.
    """

    def see(self, kind: str, *facts: Any) -> Any:
        take = getattr(type(self), kind, None)
        return None if take is None else take(self, *facts)


class Witnesses:
    """Several witnesses. The first that knows tells what belongs to a frame."""

    def __init__(self, *witnesses: Witness) -> None:
        self._witnesses = list(witnesses)

    def add(self, witness: Witness) -> None:
        self._witnesses.append(witness)

    def see(self, kind: str, *facts: Any) -> Any:
        told = [witness.see(kind, *facts) for witness in self._witnesses]
        return next((one for one in told if one is not None), None)

"""Clients of the socket: who is welcome, who hears what, and who is sent away with which reason."""

from __future__ import annotations

from typing import NamedTuple

from hyperbit.controller.program import (
    VERSION,
    Answer,
    Diagnostics,
    Goodbye,
    Hello,
    PlayableFaults,
    PlayFault,
    Snapshot,
    Stop,
    Welcome,
)
from tests.simulation.judge.account import Account
from tests.simulation.judge.verdict import require

NAME = "simulated"


class Client(NamedTuple):
    number: int
    planner: bool


class Clients:
    """Judges to whom one executor tells what.

    Attributes:
        playable: faults that can be played in the boards; None: the boards count as real.
    """

    def __init__(self, account: Account) -> None:
        self.playable: PlayableFaults | None = None
        self._a = account
        self.begin()

    def begin(self) -> None:
        self._roles: dict[int, str] = {}
        self._due: tuple[int, object, str | None] | None = None  # client, message, and words of the Goodbye that is due
        self._heard: dict[type, set[int]] = {Snapshot: set(), Diagnostics: set()}
        self._plays: list[tuple[int, int]] = []  # clients and requests of faults to play
        self._operators: dict[tuple[int, int], float] = {}  # unanswered stops of operators

    def hears(self, client: int, message: object) -> None:
        role, away = self._roles.get(client), None
        if isinstance(message, Hello):
            away = self._unwelcome(client, message)
            self._due = client, message, away
        elif role is None:
            self._due = client, message, "Hello must be the first"
        elif role == "operator" and not isinstance(message, Stop):
            self._due = client, message, "may only stop"
        elif isinstance(message, PlayFault):
            if self.playable is None:
                self._due = client, message, None
            else:
                self._plays.append((client, message.request))
        elif role == "operator" and isinstance(message, Stop):
            self._operators[client, message.request] = self._a.now

    def may_ask(self, client: int, message: object) -> bool:
        """Returns whether the executor has to do what a client asks for."""
        return isinstance(message, Hello) or self._roles.get(client) == "planner" or self._stops(client, message)

    def _stops(self, client: int, message: object) -> bool:
        return isinstance(message, Stop) and client in self._roles

    def _unwelcome(self, client: int, hello: Hello) -> str | None:
        """Returns words of the reason for which a client is not accepted."""
        if client in self._roles:
            return "sent before"
        if hello.version != VERSION:
            return f"version {VERSION}"
        if hello.arm not in (NAME, "") or (hello.role == "planner" and not hello.arm):
            return "arm"
        if hello.role == "planner" and "planner" in self._roles.values():
            return "a planner is connected already"
        return None

    def played(self, client: int, request: int, text: str, done: bool) -> None:
        if client in self._roles:
            self._due = client, (request, text, done), None

    def loses(self, client: int) -> None:
        self._roles.pop(client, None)
        self._operators = {key: at for key, at in self._operators.items() if key[0] != client}

    def tells(self, client: int, message: object) -> None:
        due, role, text = self._due, self._roles.get(client), f"{type(message).__name__} is told to client {client}"
        if due is not None and due[0] == client:
            self._answers(client, due[1], due[2], message)
            return
        require(not isinstance(message, Goodbye | Welcome), f"{text}, and nothing asks for it")
        require(role is not None, f"{text}, who has said no Hello")
        if isinstance(message, Snapshot | Diagnostics):
            self._heard[type(message)].add(client)
        elif role == "operator":
            require(isinstance(message, Answer), f"{text}, an operator")
            assert isinstance(message, Answer)
            known = self._operators.pop((client, message.request), None)
            require(known is not None, f"{text}, and was not asked for: {message}")
            right = message.refused is None and message.message.startswith("stopped")
            require(right, f"{text}: a stop is answered by {message}")

    def _answers(self, client: int, asked: object, away: str | None, message: object) -> None:
        text = f"client {client} asked {asked}, and is told {message}"
        if away is not None:
            require(isinstance(message, Goodbye) and away in message.reason, f"{text}; {away!r} is due")
        elif isinstance(asked, Hello):
            require(isinstance(message, Welcome), text)
            assert isinstance(message, Welcome)
            right = (message.version, message.arm, message.simulation) == (VERSION, NAME, self.playable)
            require(right, text)
            self._roles[client] = asked.role
        elif isinstance(asked, PlayFault):
            require(isinstance(message, Answer) and message.request == asked.request, text)
            assert isinstance(message, Answer)
            require(message.refused is not None and message.refused.reason.value == "not-simulated", text)
        elif isinstance(asked, tuple):
            request, words, done = asked
            right = isinstance(message, Answer) and message.request == request and words in message.message
            require(right and (message.refused is None) == done, text)  # type: ignore[attr-defined]
        self._due = None

    def close_step(self) -> None:
        """Requires that what is due was told, and that all clients have heard the same."""
        due, self._due = self._due, None
        require(due is None, f"client {due and due[0]} is not answered at once: {due}")
        for kind, heard in self._heard.items():
            missing = set(self._roles) - heard if heard else set()
            require(not missing, f"a {kind.__name__} is told to {sorted(heard)}, and not to {sorted(missing)}")
            heard.clear()

    def tick(self) -> None:
        """Finds stops of operators without an answer."""
        a = self._a
        longest = a.arm.timing.heartbeat_timeout / 2 + 0.02
        for (client, request), at in self._operators.items():
            if a.clear and at >= a.clear_since:
                require(a.now - at <= longest, f"stop {request} of client {client} has no answer for {a.now - at:g} s")

    def ends(self) -> None:
        """The process has ended in order: each stop of an operator has its answer."""
        require(not self._operators, f"the executor has ended in order, and has not answered {self._operators}")

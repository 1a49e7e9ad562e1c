"""The connected clients and their roles."""

from collections.abc import Callable
from typing import Literal

from hyperbit.controller import program
from hyperbit.controller.executor.core.events import ClientId

Role = Literal["planner", "operator", "commissioner"]


class Clients:
    """The connected clients: operators, at most one planner or commissioner in its place, and whether that is alive."""

    def __init__(self, arm: str, timeout: float, send: Callable[[ClientId, program.Up], None]) -> None:
        self.planner: ClientId | None = None
        self.roles: dict[ClientId, Role] = {}  # role of each client that has sent Hello
        self._arm, self._timeout, self.send = arm, timeout, send
        self._heard, self._silent = 0.0, False

    def to_planner(self, message: program.Up) -> None:
        if self.planner is not None:
            self.send(self.planner, message)

    def to_all(self, message: program.Up) -> None:
        for client in self.roles:
            self.send(client, message)

    def greet(self, client: ClientId, hello: program.Hello, clock: float) -> bool:
        """Returns whether a client is accepted; a refused client gets a Goodbye with the reason."""
        reason = self._refusal(client, hello)
        if reason is not None:
            self.send(client, program.Goodbye(reason))
            return False
        self.roles[client] = hello.role
        if hello.role != "operator":
            self.planner = client
            self.hear(clock)
        return True

    def hear(self, clock: float) -> None:
        self._heard, self._silent = clock, False

    def fell_silent(self, clock: float) -> Role | None:
        """Returns the role of a connected planner that has been silent for longer than `timeout`, once."""
        if self.planner is None or self._silent or clock - self._heard < self._timeout:
            return None
        self._silent = True
        return self.roles[self.planner]

    def remove(self, client: ClientId) -> bool:
        self.roles.pop(client, None)
        if client != self.planner:
            return False
        self.planner = None
        return True

    def _refusal(self, client: ClientId, hello: program.Hello) -> str | None:
        if client in self.roles:
            return "Hello was sent before"
        if hello.version != program.VERSION:
            return f"the executor speaks version {program.VERSION} of the contract, this client version {hello.version}"
        if hello.arm not in (self._arm, "") or (hello.role != "operator" and hello.arm != self._arm):
            return f"this is the executor of arm {self._arm}, not of {hello.arm[:100]!r}"
        if hello.role != "operator" and self.planner is not None:
            role = self.roles[self.planner]
            return f"a {role} is connected already, process {self.planner.pid}; only one may drive the arm"
        return None

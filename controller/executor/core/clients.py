"""The clients of the executor: at most one planner, and operators."""

from collections.abc import Callable
from typing import Literal

from hyperbit.controller.executor.core.events import ClientId
from hyperbit.controller.program import VERSION, Goodbye, Hello, Up

Role = Literal["planner", "operator"]


class Clients:
    """The connected clients, and whether the planner is alive."""

    def __init__(self, arm: str, timeout: float, send: Callable[[ClientId, Up], None]) -> None:
        self.planner: ClientId | None = None
        self.roles: dict[ClientId, Role] = {}  # role of each client that has sent Hello
        self._arm, self._timeout, self._send = arm, timeout, send
        self._heard, self._silent = 0.0, False

    def to_planner(self, message: Up) -> None:
        if self.planner is not None:
            self._send(self.planner, message)

    def to_all(self, message: Up) -> None:
        for client in self.roles:
            self._send(client, message)

    def greet(self, client: ClientId, hello: Hello, clock: float) -> bool:
        """Returns whether a client is accepted; a refused client gets a Goodbye with the reason."""
        reason = self._refusal(client, hello)
        if reason is not None:
            self._send(client, Goodbye(reason))
            return False
        self.roles[client] = hello.role
        if hello.role == "planner":
            self.planner = client
            self.hear(clock)
        return True

    def hear(self, clock: float) -> None:
        self._heard, self._silent = clock, False

    def fell_silent(self, clock: float) -> bool:
        """Returns True once when a connected planner has been silent for longer than `timeout`."""
        if self.planner is None or self._silent or clock - self._heard < self._timeout:
            return False
        self._silent = True
        return True

    def remove(self, client: ClientId) -> bool:
        """Removes a client; returns whether it was the planner."""
        self.roles.pop(client, None)
        if client != self.planner:
            return False
        self.planner = None
        return True

    def _refusal(self, client: ClientId, hello: Hello) -> str | None:
        if client in self.roles:
            return "Hello was sent before"
        if hello.version != VERSION:
            return f"the executor speaks version {VERSION} of the contract, this client version {hello.version}"
        if hello.arm not in (self._arm, "") or (hello.role == "planner" and hello.arm != self._arm):
            return f"this is the executor of arm {self._arm}, not of {hello.arm[:100]!r}"
        if hello.role == "planner" and self.planner is not None:
            return f"a planner is connected already, process {self.planner.pid}; only one may drive the arm"
        return None

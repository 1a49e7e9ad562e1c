"""A client's connection to the executor's socket: packets arrive in order, after a short delay."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from random import Random

from hyperbit.controller.executor.core.events import ClientGone, ClientId, FromClient
from hyperbit.controller.program import VERSION, Down, Hello, Stop, Up, decode_down, decode_up, encode
from tests.simulation.agenda import Agenda
from tests.simulation.executor.process import ExecutorProcess

LATENCY = 0.001  # [s], longest delay of the socket


class Connection:
    """The planner's connections, one after the other, and those of operators.

    Attributes:
        client: the planner's connection; None if it has none.

    Args:
        awake_at: returns when the planner is awake to hear it [s].
    """

    def __init__(
        self,
        arm: str,
        agenda: Agenda,
        random: Random,
        executor: ExecutorProcess,
        hear: Callable[[Up], None],
        awake_at: Callable[[], float],
    ) -> None:
        self.client: ClientId | None = None
        self.sent: Counter[str] = Counter()
        self._arm, self._agenda, self._random, self._executor = arm, agenda, random, executor
        self._hear, self._awake_at = hear, awake_at
        self._connections = 0
        self._last_out = self._last_in = 0.0

    def open(self, role: str = "planner") -> None:
        """Connects the planner, or a commissioner in its place, if an executor runs."""
        if self._executor.core is not None:
            self.client = self._greet(role)

    def close(self) -> None:
        if self.client is not None:
            self._executor.hear(self.client, ClientGone(self.client))
        self.client = None

    def halt(self) -> None:
        """Makes an operator halt the arm over a separate connection."""
        client = self._greet("operator")
        self._executor.hear(client, FromClient(client, Stop(1)))
        self._executor.hear(client, ClientGone(client))
        self.sent["Stop"] += 1

    def send(self, message: Down) -> None:
        client = self.client
        assert client is not None
        self.sent[type(message).__name__] += 1
        packet = encode(message)
        self._last_out = max(self._last_out, self._agenda.now + self._random.uniform(0.0, LATENCY))

        def arrive() -> None:
            if client == self.client:
                self._executor.hear(client, FromClient(client, decode_down(packet)))

        self._agenda.at(self._last_out, arrive)

    def deliver(self, client: ClientId, message: Up) -> None:
        """Delivers a message of the executor, when the socket and the process are ready."""
        if client != self.client:
            return
        self._last_in = max(self._last_in, self._agenda.now + self._random.uniform(0.0, LATENCY))
        packet = encode(message)

        def arrive() -> None:
            if self._agenda.now < self._awake_at():
                self._agenda.at(self._awake_at(), arrive)
            elif client == self.client:
                self._hear(decode_up(packet))

        self._agenda.at(self._last_in, arrive)

    def _greet(self, role: str) -> ClientId:
        self._connections += 1
        client = ClientId(self._connections, 1000 + self._connections)
        hello = Hello(VERSION, role, self._arm)  # type: ignore[arg-type]
        self._executor.hear(client, FromClient(client, hello))
        return client

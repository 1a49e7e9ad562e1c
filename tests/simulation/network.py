"""The sockets between planner and executor: packets arrive in order, those sent before an end before the end."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from random import Random

from hyperbit.controller.executor.core.events import ClientGone, ClientId, FromClient
from hyperbit.controller.planning.link import RETRY, Connection, ExecutorLink
from hyperbit.controller.program import (
    VERSION,
    Diagnostics,
    Down,
    Goodbye,
    Hello,
    Snapshot,
    Stop,
    Up,
    decode_down,
    decode_up,
    encode,
)
from tests.simulation.agenda import Agenda
from tests.simulation.executor.process import ExecutorProcess

LATENCY = 0.001  # [s], longest delay of the socket


class Socket(Connection):
    """The planner's end of one connection, as `ExecutorLink` uses it.

    Args:
        client: number and process of this end.
    """

    def __init__(self, network: Network, client: ClientId) -> None:
        self.client, self.arrived = client, deque[bytes]()
        self.ended = self.shut_down = False  # by the executor; by the planner
        self._network, self._last_out, self._last_in = network, 0.0, 0.0
        self.socket = self  # type: ignore[assignment]

    def __del__(self) -> None:
        """There is no file to close."""

    @property
    def ready(self) -> bool:
        return bool(self.arrived) or self.ended

    def fileno(self) -> int:
        return self.client.number

    def recv(self, most: int) -> bytes:
        """Returns the next packet; an empty one at the end."""
        if self.arrived:
            return self.arrived.popleft()
        if self.ended:
            return b""
        raise BlockingIOError

    def send(self, data: bytes) -> None:
        """Sends a packet.

        Raises:
            BrokenPipeError: the connection has ended.
            BlockingIOError: the socket is full.
        """
        if self.ended or self.shut_down:
            raise BrokenPipeError
        self._network.take_place()
        message = decode_down(data)
        self.forth(lambda: self._network.to_executor(self.client, message))

    def wait_writable(self, timeout: float) -> None:
        """Waits in vain: no time passes in a step."""

    def shut(self) -> None:
        if not self.shut_down:
            self.shut_down = True
            self.arrived.clear()
            self._network.hears(None)
            self.forth(lambda: self._network.gone(self.client))

    def forth(self, happen: Callable[[], None]) -> None:
        """Makes something happen at the executor's end, after all before."""
        self._last_out = self._network.delayed(self._last_out, happen)

    def back(self, data: bytes | None) -> None:
        """Makes a packet of the executor arrive, or the end."""

        def arrive() -> None:
            if self.shut_down:
                return
            if data is None:
                self.ended = True
            else:
                self.arrived.append(data)
            if not self.shut_down:
                self._network.hears(None if data is None else decode_up(data))
            self._network.wake()

        self._last_in = self._network.delayed(self._last_in, arrive)


class Network:
    """All connections to the executor.

    Attributes:
        hears: takes what arrives at the planner's end; None: the end of the connection.
        sends: takes what the planner sends in order.
    """

    def __init__(self, arm: str, agenda: Agenda, random: Random, executor: ExecutorProcess) -> None:
        self.sent: Counter[str] = Counter()
        self.wake: Callable[[], None] = lambda: None
        self.hears: Callable[[Up | None], None] = lambda message: None
        self.sends: Callable[[ClientId, Down], None] = lambda client, message: None
        self._arm, self._agenda, self._random, self._executor = arm, agenda, random, executor
        self._sockets: dict[ClientId, Socket] = {}
        self._numbers = 0
        self._unread = random.choice([3, 20, 200])  # packets that fit into the executor's end of a socket
        self._places: int | None = None  # packets that fit into the planner's socket; None: any number

    def fill(self, places: int) -> None:
        """Makes the planner's socket full after some packets."""
        self._places = places

    @property
    def full(self) -> bool:
        """Whether the planner's socket is full, or soon is."""
        return self._places is not None

    def drain(self) -> None:
        self._places = None
        self.wake()

    def take_place(self) -> None:
        """Takes the place of a packet in the planner's socket, or raises BlockingIOError."""
        if self._places is not None:
            if not self._places:
                raise BlockingIOError
            self._places -= 1

    def connect(self) -> Socket | None:
        """Returns a new connection of the planner; None if no executor listens."""
        if self._executor.core is None:
            return None
        client = self._new_client()
        self._sockets[client], self._places = Socket(self, client), None
        return self._sockets[client]

    def halt(self) -> None:
        """Makes an operator halt the arm over a connection of its own."""
        client = self._new_client()
        self._executor.hear(client, FromClient(client, Hello(VERSION, "operator", self._arm)))
        self._executor.hear(client, FromClient(client, Stop(1)))
        self._executor.hear(client, ClientGone(client))
        self.sent["Stop"] += 1

    def deliver(self, client: ClientId, message: Up) -> None:
        """Sends a message of the executor; a `Goodbye` ends the connection."""
        socket = self._sockets.get(client)
        if socket is not None:
            full = len(socket.arrived) >= self._unread
            if full and isinstance(message, Snapshot | Diagnostics):
                return  # the executor's server drops telemetry for a client that does not read
            socket.back(encode(message))
            if isinstance(message, Goodbye):
                self._end(client)

    def cut_off(self) -> None:
        """Ends all connections, because the executor has ended."""
        for client in list(self._sockets):
            self._end(client)

    def to_executor(self, client: ClientId, message: Down) -> None:
        if client in self._sockets:
            self.sent[type(message).__name__] += 1
            self._executor.hear(client, FromClient(client, message))

    def gone(self, client: ClientId) -> None:
        if self._sockets.pop(client, None) is not None:
            self._executor.hear(client, ClientGone(client))

    def delayed(self, after: float, happen: Callable[[], None]) -> float:
        """Makes something happen soon, but after a time [s]; returns when."""
        at = max(after, self._agenda.now + self._random.uniform(0.0, LATENCY))
        self._agenda.at(at, happen)
        return at

    def _end(self, client: ClientId) -> None:
        self._sockets.pop(client).back(None)

    def _new_client(self) -> ClientId:
        self._numbers += 1
        return ClientId(self._numbers, 1000 + self._numbers)


class SimulatedLink(ExecutorLink):
    """The link of a process; `between` is called before and after what another thread sends."""

    def __init__(
        self,
        network: Network,
        arm: str,
        digest: str,
        clock: Callable[[], float],
        simulated: bool,
        between: Callable[[], None],
    ) -> None:
        super().__init__(Path(), arm, digest, clock, simulated=simulated)
        self._network, self._between = network, between

    def send(self, message: Down) -> None:
        if isinstance(self._welcomed, Socket):
            self._network.sends(self._welcomed.client, message)
        super().send(message)

    def send_now(self, message: Down) -> str | None:
        self._between()
        unsent = super().send_now(message)
        self._between()
        return unsent

    @property
    def ready(self) -> bool:
        return bool(self.received) or (isinstance(self._connection, Socket) and self._connection.ready)

    def connect(self, now: float) -> None:
        """Connects and sends Hello, at most every RETRY seconds."""
        if self._connection is not None or now < self.retry_at:
            return
        self.retry_at = now + RETRY
        self._connection = self._network.connect()
        if self._connection is None:
            self._report("waiting for the executor at its socket: Connection refused")
        else:
            self._connection.send(encode(Hello(VERSION, "planner", self._arm)))

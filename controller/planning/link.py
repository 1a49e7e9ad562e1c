"""The loop's sources of events: its inbox, and the connection to the executor, without threads and locks."""

import contextlib
import os
import select
import socket
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from hyperbit.controller.planning.core.events import Event, FromExecutor, LinkDown
from hyperbit.controller.program import MOST_BYTES, VERSION, Down, Goodbye, Hello, Malformed, Welcome, decode_up, encode

RETRY = 0.5  # [s] between two attempts to connect, and after the end of a connection
SEND_TIMEOUT = 0.2  # [s] that `send_now` waits for an executor that does not read
MOST_BEHIND = 1.0  # [s], longest wait of a message in the queue
MOST_QUEUED = 1_000  # messages in the queue
MOST_RECEIVED = 256  # packets in one call, so that a flood of them does not block the loop
UNREAD = "the executor does not read its messages"


class Connection:
    """A connected socket, which is closed with the last reference.

    A sending thread holds a reference, so that the kernel cannot give the socket's number to another file meanwhile.
    """

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)

    def send(self, data: bytes) -> None:
        """Sends one packet, which is atomic. For any thread. Raises BlockingIOError if the socket is full."""
        self.socket.send(data, socket.MSG_NOSIGNAL)

    def wait_writable(self, timeout: float) -> None:
        writable = select.poll()
        writable.register(self.socket, select.POLLOUT)
        writable.poll(timeout * 1000)

    def shut(self) -> None:
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)

    def __del__(self) -> None:
        if hasattr(self, "socket"):  # missing after an error for too many open files
            self.socket.close()


class ExecutorLink:
    """The connection to one executor. Belongs to the loop's thread; only `send_now` is for any thread.

    `digest` is the SHA-256 of the arm's file, in hexadecimal. If `simulated`, the executor must simulate its boards,
    otherwise it must not: the ledger counts switches of either simulated or real boards.
    """

    def __init__(
        self, path: Path, arm: str, digest: str, clock: Callable[[], float] = time.monotonic, *, simulated: bool = False
    ) -> None:
        self.retry_at = 0.0  # time of the next attempt to connect, while there is no connection [s]
        self._path, self._arm, self._digest, self._clock, self._simulated = path, arm, digest, clock, simulated
        self._connection: Connection | None = None
        self._welcomed: Connection | None = None  # the same, after its Welcome
        self._reason = "waiting for the executor"  # of the last LinkDown
        self.received: list[FromExecutor | LinkDown] = []  # `receive` returns them though the socket cannot be read
        self.queue: deque[tuple[float, bytes]] = deque()  # time and data of messages that wait for `flush`

    def fileno(self) -> int:  # -1 without a connection
        return -1 if self._connection is None else self._connection.socket.fileno()

    def connect(self, now: float) -> None:
        if self._connection is not None or now < self.retry_at:
            return
        self.retry_at = now + RETRY
        try:
            connection = Connection()
            connection.socket.connect(str(self._path))
            connection.send(encode(Hello(VERSION, "planner", self._arm)))
        except OSError as error:
            self._report(f"waiting for the executor at its socket: {error.strerror or error}")
        else:
            self._connection = connection

    def close(self) -> None:
        """Ends the connection without an event. Sent messages can still be read."""
        if self._connection is not None:
            self._connection.shut()
        self._connection = self._welcomed = None
        self.queue.clear()

    def drop(self, reason: str) -> None:
        if self._connection is not None:
            self._report(reason)
            self.close()
            self.retry_at = self._clock() + RETRY  # the executor must first notice the end of this connection

    def receive(self) -> list[FromExecutor | LinkDown]:
        for _ in range(MOST_RECEIVED):
            if self._connection is None:
                break
            try:
                data = self._connection.socket.recv(MOST_BYTES + 1)
            except BlockingIOError:
                break
            except ConnectionResetError:  # the executor closed its end without reading all; its last messages follow
                continue
            except OSError as error:
                self.drop(f"the connection to the executor is broken: {error}")
                break
            if (reason := self._accept(data)) is not None:
                self.drop(reason)
        received, self.received = self.received, []
        return received

    def _accept(self, data: bytes) -> str | None:
        """Handles a packet; returns why the connection must end, or None."""
        if not data:
            return "the executor closed the connection"
        try:
            message = decode_up(data)
        except Malformed as error:
            return f"a message of the executor cannot be decoded, perhaps of another version: {error}"
        match message:
            case Goodbye():
                return f"the executor refused this planner: {message.reason}"
            case Welcome() if message.arm != self._arm:
                return f"the executor drives the arm {message.arm!r}, not {self._arm!r}"
            case Welcome() if message.digest != self._digest:
                return "the executor was started with another version of the arm's file: restart it"
            case Welcome() if message.simulation is not None and not self._simulated:
                return "the executor simulates its boards: start this daemon with --simulate, too"
            case Welcome() if message.simulation is None and self._simulated:
                return "the executor commands real boards: start this daemon without --simulate"
            case Welcome():
                self._welcomed = self._connection
        if self._welcomed is not None:
            self.received.append(FromExecutor(message))
        return None

    def _report(self, reason: str) -> None:
        if self._welcomed is not None or reason != self._reason:
            self.received.append(LinkDown(reason))
        self._reason = reason

    def send(self, message: Down) -> None:
        """Sends a message, or queues it while the socket is full. Without a Welcome the message is dropped."""
        if self._welcomed is not None:
            self.queue.append((self._clock(), encode(message)))
            self.flush()

    def flush(self) -> None:
        """Sends queued messages; drops the connection if the executor does not read."""
        while self.queue and self._connection is not None:
            try:
                self._connection.send(self.queue[0][1])
            except BlockingIOError:
                if len(self.queue) > MOST_QUEUED or self._clock() - self.queue[0][0] > MOST_BEHIND:
                    self.drop(UNREAD)
                return
            except OSError:  # `receive` detects the end, after the last messages
                self.queue.clear()
                return
            self.queue.popleft()

    def send_now(self, message: Down) -> str | None:
        """Sends a message before all queued ones; returns why it was not sent, or None.

        For any thread; waits up to SEND_TIMEOUT for a full socket.
        """
        connection = self._welcomed
        if connection is None:
            return self._reason
        data = encode(message)
        try:
            with contextlib.suppress(BlockingIOError):
                connection.send(data)
                return None
            connection.wait_writable(SEND_TIMEOUT)
            connection.send(data)
        except BlockingIOError:
            return UNREAD
        except OSError as error:
            return f"the connection to the executor is broken: {error}"
        return None


class Inbox:
    """A queue of events. One thread reads it, and waits for it and for the link together.

    A post wakes a sleeping thread within about 50 us. A `SimpleQueue` needs 10 us less, but cannot wait for a socket.
    """

    def __init__(self) -> None:
        # Oldest first; only the reading thread removes events. A thread that appends here then calls `wake`.
        self.events: deque[Event] = deque()
        self._asleep = False  # whether the reading thread must be woken
        self._wakeups = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._epoll = select.epoll()
        # Edge-triggered, so that wake-ups need not be read: each system call releases the GIL.
        self._epoll.register(self._wakeups, select.EPOLLIN | select.EPOLLET)
        self._watched = (-1, False)

    def post(self, event: Event) -> None:
        """Appends an event, and wakes the reading thread. For any thread; never waits."""
        self.events.append(event)
        self.wake()

    def wake(self) -> None:
        """Wakes the reading thread if it sleeps, which releases the GIL. For any thread."""
        if self._asleep:
            self._asleep = False  # before the wake-up, after which the reading thread may set it again
            os.eventfd_write(self._wakeups, 1)

    def end_wait(self) -> None:
        """Ends the present `wait`, or the next one. For any thread."""
        os.eventfd_write(self._wakeups, 1)

    def wait(self, timeout: float, link: ExecutorLink) -> bool:
        """Waits for an event, or for the link, for at most `timeout` seconds; returns whether the link is ready."""
        watched = number, sending = link.fileno(), bool(link.queue)
        if self._watched != watched:
            if self._watched[0] >= 0:
                with contextlib.suppress(OSError):  # a closed socket is not watched any more
                    self._epoll.unregister(self._watched[0])
            if number >= 0:
                self._epoll.register(number, select.EPOLLIN | (select.EPOLLOUT if sending else 0))
            self._watched = watched
        self._asleep = True  # before `events` is tested, so that no event is missed
        ready = self._epoll.poll(0 if self.events else timeout)
        self._asleep = False
        return number in dict(ready)

    def __del__(self) -> None:
        os.close(self._wakeups)  # not earlier, because threads may post until the end

"""The planner's side of the executor's socket: connects, sends messages and keep-alives, dispatches what arrives."""

import contextlib
import logging
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

from controller.planning.answers import Answers, OnAnswer
from controller.planning.connection import Connection, NotConnected
from controller.program import (
    ALIVE_EVERY,
    VERSION,
    Alive,
    Answer,
    Diagnostics,
    Down,
    Goodbye,
    Hello,
    Malformed,
    Snapshot,
    Up,
    Welcome,
    decode_up,
    encode,
)

log = logging.getLogger(__name__)

T = TypeVar("T")

RETRY = 0.5  # [s] between two attempts to connect


class Listener(Protocol):
    """Receives the link's messages, in the link's thread; must not wait."""

    def welcomed(self, welcome: Welcome) -> None:
        """The executor accepts this planner."""

    def heard(self, message: Up) -> None:
        """A message arrived."""

    def lost(self, reason: str) -> None:
        """The connection ended; called once for each `welcomed`."""


class ExecutorLink:
    """The connection to one executor. For any thread.

    Attributes:
        snapshot: the latest; None while not connected.
        diagnostics: the latest; None while not connected.
        welcome: of this connection; None while not connected.
        problem: why there is no connection; None while there is one.
        patience: as given [s].

    Args:
        path: of the socket, or a function that returns it for each attempt.
        arm: name of the arm.
        digest: SHA-256 of the arm's file, in hexadecimal.
        patience: longest time for an answer, and longest silence, before the connection counts as lost [s].
    """

    def __init__(self, path: Path | Callable[[], Path], arm: str, digest: str, patience: float = 2.0) -> None:
        self._path = path if callable(path) else lambda: path
        self._arm, self._digest = arm, digest
        self.patience = patience
        self._most_silent = round(patience / ALIVE_EVERY)  # iterations of the thread that sends Alive
        self.snapshot: Snapshot | None = None
        self.diagnostics: Diagnostics | None = None
        self.welcome: Welcome | None = None
        self.problem: str | None = "waiting for the executor"
        self._listener: Listener
        self._connection: Connection | None = None
        self._answers = Answers(patience)
        self._silent, self._closing = 0, threading.Event()
        self._threads: Sequence[threading.Thread] = ()

    @property
    def connected(self) -> bool:
        """Whether the executor accepts messages."""
        return self.welcome is not None

    @property
    def waiting(self) -> int:
        """Number of requests that wait for the executor's answer."""
        return len(self._answers)

    def start(self, listener: Listener) -> None:
        """Starts the threads that connect and listen, and that send keep-alives."""
        self._listener = listener
        self._threads = (
            threading.Thread(target=self._run, name="executor-link", daemon=True),
            threading.Thread(target=self._stay_alive, name="executor-alive", daemon=True),
        )
        for thread in self._threads:
            thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Ends the connection and the threads."""
        self._closing.set()
        self._drop()
        for thread in self._threads:
            thread.join(timeout)

    # --- to the executor

    def send(self, message: Down) -> None:
        """Sends a message at once.

        Raises:
            NotConnected: there is no connection, or the executor does not read.
        """
        connection = self._connection
        if connection is None or not self.connected:
            raise NotConnected(self.problem or "the executor is not connected")
        connection.send(encode(message))

    def ask(self, make: Callable[[int], Down], on_answer: OnAnswer) -> None:
        """Sends a request; `on_answer` gets the executor's answer once, or None if the connection ends before.

        Args:
            make: returns the message, given the request's number.
            on_answer: called from another thread; must not wait.

        Raises:
            NotConnected: as `send`; `on_answer` is not called then.
        """
        number = self._answers.expect(on_answer)
        try:
            self.send(make(number))
        except NotConnected:
            if self._answers.withdraw(number):
                raise

    def _stay_alive(self) -> None:
        """Sends keep-alives, and drops the connection if the executor is silent.

        Silence is counted in iterations of this thread, so that a stop of the whole process does not count as silence.
        """
        while not self._closing.wait(ALIVE_EVERY):
            with contextlib.suppress(NotConnected):
                self.send(Alive())
            self._silent += 1
            if self.connected and (self._silent > self._most_silent or self._answers.overdue()):
                log.warning("the executor is silent: reconnecting")
                self._drop()

    # --- from the executor

    def _run(self) -> None:
        while not self._closing.is_set():
            reason = self._serve()
            if self._closing.is_set():
                break
            if reason != self.problem:
                log.info("no connection to the executor: %s", reason)
            self.problem = reason
            self._closing.wait(RETRY)

    def _serve(self) -> str:
        """Connects and dispatches messages until the connection ends; returns why it ended."""
        try:
            connection = Connection(self._path())
        except (NotConnected, OSError) as error:
            return str(error)
        self._connection, self._silent = connection, 0
        try:
            connection.send(encode(Hello(VERSION, "planner", self._arm)))
            reason = self._listen(connection)
        except NotConnected as error:
            reason = str(error)
        except Exception:
            log.exception("the link to the executor failed")
            reason = "internal error, see the journal"
        finally:
            self._connection = None
            connection.close()
        self._ended(reason)
        return reason

    def _listen(self, connection: Connection) -> str:
        """Dispatches messages; returns why the connection ended.

        Raises:
            NotConnected: the connection is broken.
        """
        while data := connection.receive():
            self._silent = 0
            try:
                message = decode_up(data)
            except Malformed as error:
                return f"a message of the executor cannot be decoded, perhaps of another version: {error}"
            match message:
                case Goodbye():
                    return f"the executor refused this planner: {message.reason}"
                case Welcome():
                    if (mismatch := self._mismatch(message)) is not None:
                        return mismatch
                    self.welcome, self.problem = message, None
                    self._notify(self._listener.welcomed, message)
                case Answer() if self.connected:
                    self._answers.answer(message)
                case _ if self.connected:
                    self._store(message)
                    self._notify(self._listener.heard, message)
                case _:
                    pass
        return "the executor closed the connection"

    def _mismatch(self, welcome: Welcome) -> str | None:
        """Returns why this planner must not use the executor; None if it may."""
        if welcome.arm != self._arm:
            return f"the executor drives the arm {welcome.arm!r}, not {self._arm!r}"
        if welcome.digest != self._digest:
            return "the executor was started with another version of the arm's file: restart it"
        return None

    def _store(self, message: Up) -> None:
        match message:
            case Snapshot():
                self.snapshot = message
            case Diagnostics():
                self.diagnostics = message
            case _:
                pass

    def _ended(self, reason: str) -> None:
        was, self.problem = self.connected, reason
        self.welcome = self.snapshot = self.diagnostics = None
        if was:
            self._notify(self._listener.lost, reason)
        self._answers.fail_all()

    def _notify(self, to: Callable[[T], None], what: T) -> None:
        """Calls the listener; its exceptions are logged, so that they do not end the connection."""
        try:
            to(what)
        except Exception:
            log.exception("a message of the executor was not handled")

    def _drop(self) -> None:
        if (connection := self._connection) is not None:
            connection.shut()

"""The planner's end of the executor's socket: connects, says that it is alive, sends, and hands on what it hears."""

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
    """Who is told what the link hears; called from the link's thread, must not wait."""

    def welcomed(self, welcome: Welcome) -> None:
        """The executor takes this planner."""

    def heard(self, message: Up) -> None:
        """A message came."""

    def lost(self, reason: str) -> None:
        """The connection ended; called once for each `welcomed`."""


class ExecutorLink:
    """The connection to one executor. All methods may be called from any thread.

    Attributes:
        snapshot: the latest; None while not connected.
        diagnostics: the latest; None while not connected.
        welcome: of this connection; None while not connected.
        problem: why there is no connection, in words; None while there is one.
        patience: as given [s].

    Args:
        path: of the socket, or a function that returns it anew for each attempt.
        arm: name of the arm.
        digest: SHA-256 of the arm's file, in hexadecimal.
        patience: time for the executor to answer, and its longest silence, until the connection counts as lost [s].
    """

    def __init__(self, path: Path | Callable[[], Path], arm: str, digest: str, patience: float = 2.0) -> None:
        self._path = path if callable(path) else lambda: path
        self._arm, self._digest = arm, digest
        self.patience = patience
        self._most_silent = round(patience / ALIVE_EVERY)  # turns of the thread that says alive
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
        """Whether the executor takes messages."""
        return self.welcome is not None

    @property
    def waiting(self) -> int:
        """How many requests wait for the executor's answer."""
        return len(self._answers)

    def start(self, listener: Listener) -> None:
        """Starts the threads that connect and listen, and that say that the planner is alive."""
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

    # --- down

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
        """Sends a request; `on_answer` gets the executor's answer once, None if the connection ends before.

        Args:
            make: returns the message of a request number.
            on_answer: called from another thread; must not wait.

        Raises:
            NotConnected: as of `send`; then `on_answer` is not called.
        """
        number = self._answers.expect(on_answer)
        try:
            self.send(make(number))
        except NotConnected:
            if self._answers.withdraw(number):
                raise

    def _stay_alive(self) -> None:
        """Says that the planner is alive, and drops a connection on which the executor is silent.

        Silence is counted in turns of this thread, so that a stop of the whole process is not the executor's silence.
        """
        while not self._closing.wait(ALIVE_EVERY):
            with contextlib.suppress(NotConnected):
                self.send(Alive())
            self._silent += 1
            if self.connected and (self._silent > self._most_silent or self._answers.overdue()):
                log.warning("the executor is silent: connecting anew")
                self._drop()

    # --- up

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
        """Connects and hands on what is heard until the connection ends; returns why it ended."""
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
        """Hands on what is heard; returns why the connection ended.

        Raises:
            NotConnected: the connection is broken.
        """
        while data := connection.receive():
            self._silent = 0
            try:
                message = decode_up(data)
            except Malformed as error:
                return f"the executor speaks another language: {error}"
            match message:
                case Goodbye():
                    return f"the executor does not serve this planner: {message.reason}"
                case Welcome():
                    if (wrong := self._wrong(message)) is not None:
                        return wrong
                    self.welcome, self.problem = message, None
                    self._tell(self._listener.welcomed, message)
                case Answer() if self.connected:
                    self._answers.answer(message)
                case _ if self.connected:
                    self._keep(message)
                    self._tell(self._listener.heard, message)
                case _:
                    pass
        return "the executor closed the connection"

    def _wrong(self, welcome: Welcome) -> str | None:
        """Returns why this planner must not drive an executor; None if it may."""
        if welcome.arm != self._arm:
            return f"the executor drives the arm {welcome.arm!r}, not {self._arm!r}"
        if welcome.digest != self._digest:
            return "the executor was started with another version of the arm's file: restart it"
        return None

    def _keep(self, message: Up) -> None:
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
            self._tell(self._listener.lost, reason)
        self._answers.lose()

    def _tell(self, to: Callable[[T], None], what: T) -> None:
        """Tells the listener; a defect there must not end the connection."""
        try:
            to(what)
        except Exception:
            log.exception("a message of the executor was not handled")

    def _drop(self) -> None:
        if (connection := self._connection) is not None:
            connection.shut()

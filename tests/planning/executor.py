"""An executor that the test plays, on a real socket, and the other parts that a planner needs."""

import contextlib
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from controller.program import (
    Accepted,
    Alive,
    Answer,
    Begun,
    Cancel,
    Counts,
    Declined,
    Down,
    Ended,
    Hello,
    Program,
    Settled,
    Snapshot,
    Up,
    Welcome,
    decode_down,
    encode,
    pack,
)
from tests.waiting import PATIENCE

T = TypeVar("T", bound=Down)

DIGEST = "d" * 64


class ScriptedExecutor:
    """Listens on a socket. The test receives each message with `expect`, and answers it.

    Attributes:
        state: the latest snapshot; `show` changes and sends it.
        greets: whether a planner's Hello is answered by Welcome.
    """

    def __init__(self, path: Path, actuators: int, name: str = "small") -> None:
        self.actuators, self.name, self.greets = actuators, name, True
        self.instance, self.greatest = 1, 0
        full, none = (1 << actuators) - 1, bytes((actuators + 7) // 8)
        known = pack(full, actuators)
        self.state = Snapshot(
            time.monotonic(), "ready", "holding", 1, none, none, known, known, none, 0, False, 0.0, -1, -1, -1, ()
        )  # fmt: skip
        self._results = 0
        self._messages: queue.Queue[Down] = queue.Queue()
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(path))
        self._server.listen()
        self._client: socket.socket | None = None
        self._greeted = False
        self._closing, self._lock = threading.Event(), threading.Lock()
        for work in (self._serve, self._stay_alive):
            threading.Thread(target=work, daemon=True).start()

    # --- messages of the planner

    def expect(self, kind: type[T], *passing: type[Any]) -> T:
        """Returns the next message and checks its kind; messages of kind `passing` are skipped."""
        while True:
            message = self._messages.get(timeout=PATIENCE)
            if isinstance(message, kind):
                return message
            assert isinstance(message, passing), f"{message} came where {kind.__name__} was expected"

    def nothing(self, kind: type[Any]) -> bool:
        """Whether no message of a kind has come."""
        return not any(isinstance(message, kind) for message in list(self._messages.queue))

    # --- messages of the executor

    def send(self, message: Up) -> None:
        assert self._client is not None
        self._client.send(encode(message))

    def show(self, **changes: Any) -> None:
        """Sends a snapshot; an integer sets `outputs`, and the measured states as well."""
        if isinstance(bits := changes.get("outputs"), int):
            changes["outputs"] = pack(bits, self.actuators)
        if "outputs" in changes and "measured" not in changes:
            changes["measured"] = changes["outputs"]
        with self._lock:
            self.state = msgspec.structs.replace(self.state, at=time.monotonic(), **changes)
            self.send(self.state)

    def answer(self, message: Any, text: str, accepted: bool = True, **changes: Any) -> None:
        """Answers a request as the executor does: it begins a new epoch if needed, and sends a snapshot."""
        ends = not isinstance(message, Cancel) or message.program is None
        self.send(Answer(message.request, accepted, text))
        self.show(epoch=self.state.epoch + ends, **changes)

    def accept(self, program: Program) -> None:
        begin = program.begin or time.monotonic()
        self.send(Accepted(program.program, begin))
        self.show(mode="executing", reason=program.name, program=program.program)

    def decline(self, program: Program, cause: Any, reason: str = "because") -> None:
        self.send(Declined(program.program, cause, reason))

    def run(self, program: Program, stage: int, switches: int = 1, measured: bytes | None = None) -> None:
        """Carries out a stage of a program, and settles its mark if it has one."""
        states = program.stages[stage]
        self.send(Begun(program.program, stage, switches))
        self.show(outputs=states.states, measured=measured or states.states)
        if states.mark >= 0:
            known = self.state.known
            at = measured or states.states
            self.send(Settled(program.program, states.mark, at, known, switches, 1, True))

    def end(self, program: Program, status: Any = "done", message: str = "done", **fields: Any) -> Ended:
        """Sends the result of a program."""
        self._results += 1
        last = program.stages[-1]
        ended = Ended(
            self._results, program.program, program.context, status, message, fields.get("mark", last.mark),
            fields.get("switches", 1), fields.get("measured", self.state.measured), self.state.known,
            fields.get("travels", ()),
        )  # fmt: skip
        self.send(ended)
        self.show(mode="ready", reason=f"holding; {program.name} ended", program=-1)
        return ended

    # --- the connection

    def drop(self) -> None:
        """Closes the connection, like an executor that dies."""
        assert self._client is not None
        self._client.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._closing.set()
        self._server.close()
        if self._client is not None:
            self._client.close()

    def _stay_alive(self) -> None:
        """Repeats the snapshot, so that the executor does not count as silent."""
        while not self._closing.wait(0.2):
            with self._lock, contextlib.suppress(OSError):
                if self._greeted and self._client is not None:
                    self._client.send(encode(self.state))

    def _serve(self) -> None:
        while not self._closing.is_set():
            try:
                self._greeted = False
                self._client, _ = self._server.accept()
                self._listen(self._client)
            except OSError:
                continue

    def _listen(self, client: socket.socket) -> None:
        while data := client.recv(70_000):
            match message := decode_down(data):
                case Hello():
                    if self.greets:
                        size = (0,) * self.actuators
                        self.send(Welcome(1, self.name, DIGEST, self.instance, size, self.greatest))
                        self.send(self.state)
                        self._greeted = True
                    self._messages.put(message)
                case Alive() | Counts():
                    pass
                case _:
                    self._messages.put(message)


class FakeLedger:
    """Remembers what is recorded."""

    fault: str | None = None
    instance = 0

    def __init__(self, actuators: int) -> None:
        self.entries: list[tuple[Any, ...]] = []
        self._known = (0,) * actuators

    def accepted(self, number: int, goal: str, waypoints: int) -> None:
        self.entries.append(("accepted", goal, waypoints))

    def ended(
        self, number: int, status: str, code: int, message: str, switches: int, accepted: Any | None = None
    ) -> None:
        self.entries.append(("ended", status, code, switches) if accepted is None else ("adopted", *accepted[::2]))

    def counts(self, counts: Any) -> None:
        self._known = tuple(counts)

    def known(self) -> tuple[int, ...]:
        return self._known


class Inbox:
    """Published payloads, in order; reading waits for the next."""

    def __init__(self) -> None:
        self._queue: queue.Queue[tuple[str, dict[str, Any]]] = queue.Queue()

    def put(self, key: str, payload: Any) -> None:
        self._queue.put((key, dict(payload)))

    def replying(self, name: str = "reply") -> Callable[[Any], None]:
        return lambda payload: self.put(name, payload)

    def next(self, key: str) -> dict[str, Any]:
        """Returns the next payload, and checks its key."""
        came, payload = self._queue.get(timeout=PATIENCE)
        assert came == key, f"{came} {payload} came where {key} was expected"
        return payload

    @property
    def empty(self) -> bool:
        return self._queue.empty()


@contextmanager
def closing(thing: Any) -> Iterator[Any]:
    try:
        yield thing
    finally:
        thing.close()

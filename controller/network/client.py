"""The client's side of the interface, for commands, pages and tests.

It imports nothing slow, because `hyperbit stop` uses it.
"""

import contextlib
import os
import queue
import socket
import time
import uuid
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import zenoh
from msgspec import Struct

from hyperbit.controller.decoding.decoding import Unreadable, convert
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.goals import Answer
from hyperbit.controller.messages.reading import Message, UnreadCount, read
from hyperbit.controller.messages.state import State

# Attempts until a reply comes, and the first pause between them [s]; the last attempt uses a new session.
TRIES, PAUSE = 4, 0.1
ANSWER_TIMEOUT, REPLY = 10.0, 2.0  # [s] for an answer; longest time between the acceptance of a goal and its answer


class Unanswered(RuntimeError):
    """No daemon answered in time."""


class Client:
    """A client of one arm's daemon.

    A message that cannot be read is counted, and reaches no caller. A request without any reply is repeated, because
    Zenoh's routes may be stale. Each request has a number, so that the daemon does not run a goal twice. `reopen` opens
    a new session for the last attempt; None: all attempts use `session`. `prefix` is that of all keys.
    """

    def __init__(
        self,
        session: zenoh.Session,
        arm: str,
        reopen: Callable[[], zenoh.Session] | None = None,
        prefix: str = "hyperbit",
    ) -> None:
        self._session, self._arm, self._reopen = session, arm, reopen
        self._prefix, self._unread = f"{prefix}/{arm}", UnreadCount()
        self._name = f"{socket.gethostname()[:40]}:{os.getpid()}:{uuid.uuid4().hex[:8]}"
        self._opened: list[zenoh.Session] = []
        self._on_renewal: list[Callable[[], None]] = []

    def close(self) -> None:
        for session in self._opened:
            session.close()  # type: ignore[no-untyped-call]
        self._opened.clear()

    def request(
        self,
        key: str,
        payload: Mapping[str, Any] | None = None,
        timeout: float | None = None,
        sending: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext,
    ) -> Message:
        """Returns the daemon's answer on `key`, such as goal, stop, plan or arm.

        Args:
            timeout: longest time to wait [s].
            sending: entered while an attempt is sent; an exception from it ends the request.

        Raises:
            Unanswered: no answer that can be read came within `timeout` seconds, or the daemon does not accept this
                client's requests.
                Without a `timeout`, the payload's time to its acceptance counts, and 2 s more.
        """
        timeout = answer_timeout(payload or {}) if timeout is None else timeout
        form = Description if key == "arm" else Answer
        data, number = msgspec.json.encode(payload or {}), uuid.uuid4().hex.encode()
        until = time.monotonic() + timeout
        for attempt in range(TRIES):
            if attempt > 0:
                if (pause := PAUSE * 2 ** (attempt - 1)) > until - time.monotonic():
                    break
                time.sleep(pause)
            if attempt == TRIES - 1:
                self._renew()
            with sending():
                replies = self._session.get(
                    f"{self._prefix}/{key}",
                    payload=data,
                    encoding=zenoh.Encoding.APPLICATION_JSON,
                    attachment=number,
                    target=zenoh.QueryTarget.ALL,
                    timeout=max(until - time.monotonic(), PAUSE),
                )
            late = False
            for reply in replies:
                if reply.ok is None:
                    late = True  # the time is over, but the request was received
                elif (answer := self._read(key, reply.ok, form)) is not None:
                    return answer
            if late:
                break
        if self.alive():
            why = "this client may lack the right, or send too often"
            raise Unanswered(f"the daemon of arm {self._arm!r} did not accept this {key}: {why}")
        raise Unanswered(f"no daemon for arm {self._arm!r} answered on {self._prefix}/{key}")

    def describe(self) -> Description:
        """Returns the daemon's description of its arm; raises as `request`."""
        return convert(self.request("arm"), Description)

    def put(self, key: str, payload: bytes) -> None:
        """Publishes a payload on `key`: setpoint or measured_tip. There is no answer.

        The attached name tells the daemon whose stream it is.
        """
        encoding = zenoh.Encoding.APPLICATION_JSON
        self._session.put(f"{self._prefix}/{key}", payload, encoding=encoding, attachment=self._name)

    def subscribe(self, key: str, callback: Callable[[Message], None]) -> zenoh.Subscriber[None]:
        """Calls `callback` with each message on `key`: state, feedback, result or diagnostics.

        Undeclare the subscriber before the session is closed, for instance by a `with` statement: Zenoh logs samples
        that arrive during the close as errors, on the standard output.
        """

        def receive(sample: zenoh.Sample) -> None:
            if (message := self._read(key, sample)) is not None:
                callback(message)

        return self._session.declare_subscriber(f"{self._prefix}/{key}", receive)

    def next_state(self, timeout: float = 10.0) -> State:
        """Returns the next state. Raises Unanswered if none came within `timeout` [s]."""
        news: queue.SimpleQueue[Message] = queue.SimpleQueue()
        subscriber = self.subscribe("state", news.put)
        try:
            return convert(news.get(timeout=timeout), State)
        except queue.Empty:
            raise Unanswered(f"no state from arm {self._arm!r} for {timeout:g} s") from None
        finally:
            subscriber.undeclare()  # type: ignore[no-untyped-call]

    def alive(self, timeout: float = 1.0) -> bool:
        return any(reply.ok for reply in self._session.liveliness().get(f"{self._prefix}/alive", timeout=timeout))

    def run(
        self,
        goal: Mapping[str, Any],
        on_feedback: Callable[[Message], None] = lambda message: None,
        silence: float = 10.0,
        key: str = "goal",
    ) -> Message:
        """Sends a goal and returns its result, or the daemon's answer if it was refused.

        Args:
            goal: its payload; an id is added if it has none.
            on_feedback: called with the daemon's answer first, then with each feedback of the goal.
            silence: longest time without a message on the goal [s].
            key: "goal", or "jog"; the id of a jog comes with its answer.

        Raises:
            Unanswered: the daemon did not answer, or stopped sending messages on the goal.
        """
        name = goal.get("id", uuid.uuid4().hex[:12])
        payload = {**goal, "id": name} if key == "goal" else goal
        news: queue.SimpleQueue[tuple[str, Message]] = queue.SimpleQueue()

        def hand_over(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr).rpartition("/")[2]
            if key in ("feedback", "result", "state") and (message := self._read(key, sample)) is not None:
                news.put((key, message))

        # One subscriber for all keys: only within one subscriber do messages keep their order.
        subscribers = [self._session.declare_subscriber(f"{self._prefix}/*", hand_over)]

        def move() -> None:
            subscribers[0].undeclare()  # type: ignore[no-untyped-call]
            subscribers[0] = self._session.declare_subscriber(f"{self._prefix}/*", hand_over)

        self._on_renewal.append(move)
        try:
            answer = self.request(key, payload)
            on_feedback(answer)
            if not answer["accepted"]:
                return answer
            name = answer.get("id", name)
            until = time.monotonic() + silence
            while True:
                kind, message = news.get(timeout=max(until - time.monotonic(), 0.0))
                if name not in (message.get("id"), message.get("goal")):
                    continue  # of another goal, or of a restarted daemon that does not know this goal
                until = time.monotonic() + silence
                if kind == "result":
                    return message
                if kind == "feedback":
                    on_feedback(message)
        except queue.Empty:
            raise Unanswered(f"no message on {key} {name} from arm {self._arm!r} for {silence:g} s") from None
        finally:
            self._on_renewal.remove(move)
            subscribers[0].undeclare()  # type: ignore[no-untyped-call]

    def _read(self, key: str, sample: zenoh.Sample, form: type[Struct] | None = None) -> Message | None:
        """Returns a message; None if it cannot be read, as that of a stranger."""
        try:
            return read(key, sample.payload.to_bytes(), form)
        except Unreadable as error:
            self._unread.add(self._arm, key, error)
            return None

    def _renew(self) -> None:
        if self._reopen is None:
            return
        with contextlib.suppress(zenoh.ZError):  # if that fails, the old session stays
            self._session = self._reopen()
            self._opened.append(self._session)
            for move in self._on_renewal:
                move()


def answer_timeout(payload: Mapping[str, Any]) -> float:
    """Returns how long to wait for an answer [s]: a goal that moves the arm later must not count as unanswered."""
    deadline, begin_within = (
        value if isinstance(value := payload.get(name), int | float) else None for name in ("deadline", "begin_within")
    )
    return ANSWER_TIMEOUT + (deadline or 0.0) if begin_within is None else begin_within + REPLY

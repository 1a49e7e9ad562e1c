"""The other side of the interface: what the commands and the demo say to a daemon."""

import json
import queue
import time
import uuid
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import zenoh

Message = dict[str, Any]


class Unanswered(RuntimeError):
    """No daemon answered in time."""


class Client:
    """Talks to the daemon of one arm.

    Args:
        session: open session, a client of the daemon's.
        arm: its name.
    """

    def __init__(self, session: zenoh.Session, arm: str) -> None:
        self._session = session
        self._arm = arm
        self._prefix = f"hyperbit/{arm}"

    def request(self, key: str, payload: Mapping[str, Any] | None = None, timeout: float = 10.0) -> Message:
        """Returns the daemon's answer on `key`: goal, cancel, stop, reset, degrade, obstacles, plan or arm.

        Raises:
            Unanswered: none came within `timeout` seconds, or the daemon lets this client not ask.
        """
        data = msgspec.json.encode(payload or {})
        replies = self._session.get(
            f"{self._prefix}/{key}", payload=data, encoding=zenoh.Encoding.APPLICATION_JSON, timeout=timeout
        )
        for reply in replies:
            if reply.ok is not None:
                return decoded(reply.ok)
        if self.alive():
            raise Unanswered(f"the daemon of arm {self._arm!r} took no {key} of ours: not allowed, or sent too often")
        raise Unanswered(f"no daemon for arm {self._arm!r} answered on {self._prefix}/{key} within {timeout:g} s")

    def subscribe(self, key: str, callback: Callable[[Message], None]) -> zenoh.Subscriber[None]:
        """Calls `callback` with each message on `key`: state, feedback, result or diagnostics."""
        return self._session.declare_subscriber(f"{self._prefix}/{key}", lambda sample: callback(decoded(sample)))

    def alive(self, timeout: float = 1.0) -> bool:
        """Returns whether the daemon's liveliness token is there."""
        return any(reply.ok for reply in self._session.liveliness().get(f"{self._prefix}/alive", timeout=timeout))

    def run(
        self,
        goal: Mapping[str, Any],
        on_feedback: Callable[[Message], None] = lambda message: None,
        silence: float = 10.0,
    ) -> Message:
        """Sends a goal and returns its result, or the daemon's answer if it was refused.

        Args:
            goal: its payload; an id is added where there is none.
            on_feedback: called with each feedback of it, and with the daemon's answer first.
            silence: longest time [s] without any word of the goal while waiting.

        Raises:
            Unanswered: the daemon did not answer, or fell silent.
        """
        goal = {"id": uuid.uuid4().hex[:12], **goal}
        news: queue.SimpleQueue[tuple[str, Message]] = queue.SimpleQueue()

        def hand_over(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr).rpartition("/")[2]
            if key in ("feedback", "result", "state"):
                news.put((key, decoded(sample)))

        # One subscriber for all: only within one do messages keep their order, the last feedback before the result.
        subscriber = self._session.declare_subscriber(f"{self._prefix}/*", hand_over)
        try:
            answer = self.request("goal", goal)
            on_feedback(answer)
            if not answer["accepted"]:
                return answer
            until = time.monotonic() + silence
            while True:
                key, message = news.get(timeout=max(until - time.monotonic(), 0.0))
                if goal["id"] not in (message.get("id"), message.get("goal")):
                    continue  # of another goal; a daemon that was started anew knows nothing of this one
                until = time.monotonic() + silence
                if key == "result":
                    return message
                if key == "feedback":
                    on_feedback(message)
        except queue.Empty:
            raise Unanswered(f"no word of goal {goal['id']} from arm {self._arm!r} for {silence:g} s") from None
        finally:
            subscriber.undeclare()  # type: ignore[no-untyped-call]


def decoded(sample: zenoh.Sample) -> Message:
    """Returns a sample's JSON object."""
    message: Message = json.loads(sample.payload.to_bytes())
    return message

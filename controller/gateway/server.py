"""Receives requests over Zenoh, and hands each to the planner once. All answers go through the outbox."""

import logging
import os
import socket
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Union

import msgspec
import zenoh

from controller.gateway.arrivals import BRIEFLY, FloodBrake, Rate, RepeatedGoals, Reply
from controller.gateway.outbox import Outbox
from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.goal import GoalMessage
from controller.planning.core.events import CancelMessage, Key, Message, Payload, refused
from controller.planning.planner import Planner

log = logging.getLogger(__name__)

MOST_SAMPLES = 64  # of a mailbox; a full one drops its oldest
MOST_UNANSWERED = 100  # requests on one key; a planner refuses more than 16 goals by itself, if it is not too slow
MOST_REFUSALS = 50  # refusals of puts published in one second
MOST_NOTES = 50  # notes in one second on refused requests
MOST_TEXT = 500  # characters of a payload that is no JSON, in a note

# Who receives a request: the arm that is named in full, also each arm that a wildcard matches, or whoever is meant by
# an expression that may not even name the key, as `hyperbit/**`.
Reach = Literal["named", "each arm", "all"]
Declared = Union[zenoh.Queryable[None], zenoh.Subscriber[None], "Mailbox", zenoh.LivelinessToken]


class Server:
    """Declares the keys under "hyperbit/<arm>".

    Requests that can move an arm, or change its limits, must name it in full. `stop` and `cancel` also reach each arm
    that a wildcard matches, as in `hyperbit/*/stop`. Queries that change nothing accept any wildcard.

    Args:
        session: open session.
        arm: name of the arm.
        planner: receives the requests.
        outbox: sends the answers.
        goals: recognizes repeated goals.
        tracker: whether measured tips are accepted.
    """

    def __init__(
        self, session: zenoh.Session, arm: str, planner: Planner, outbox: Outbox, goals: RepeatedGoals, *, tracker: bool
    ) -> None:
        self._session, self._prefix = session, f"hyperbit/{arm}"
        self._planner, self._outbox, self._goals = planner, outbox, goals
        self._declared: list[Declared] = []
        self._put_refusals = PutRefusals(outbox)
        self._command("stop", "each arm")
        self._command("cancel", "each arm")
        self._command("reset")
        self._command("goal")
        self._command("jog")
        self._command("degrade")
        self._command("obstacles")
        self._query("plan", Way)
        self._query("arm", Description)
        planner.read_setpoints(self._mailbox("setpoint"))
        if tracker:
            planner.read_measured_tips(self._mailbox("measured_tip"))
        self._declared.append(session.liveliness().declare_token(f"{self._prefix}/alive"))

    def close(self) -> None:
        """Undeclares all keys, the liveliness token first."""
        while self._declared:
            self._declared.pop().undeclare()

    def _command(self, key: Key, reach: Reach = "named") -> None:
        """Accepts commands on `key`, by query and by put."""
        way = Way(self._prefix, key, reach, self._planner, self._outbox, self._goals)
        put = partial(way.on_put, publish_refusal=self._put_refusals.publish)
        self._declared.append(self._session.declare_queryable(way.name, way.on_query))
        self._declared.append(self._session.declare_subscriber(way.name, put))

    def _query(self, key: Key, kind: "type[Way]") -> None:
        """Answers queries on `key`."""
        way = kind(self._prefix, key, "all", self._planner, self._outbox, self._goals)
        self._declared.append(self._session.declare_queryable(way.name, way.on_query))

    def _mailbox(self, key: str) -> Callable[[], bytes | None]:
        """Declares the mailbox of a key and returns its `receive`."""
        mailbox = Mailbox(self._session, f"{self._prefix}/{key}")
        self._declared.append(mailbox)
        return mailbox.receive


@dataclass(eq=False, frozen=True)
class Arrival:
    """A request that has arrived.

    Attributes:
        name: key expression by which it came.
        payload: as it came.
        number: that the client attached; empty if none.
        deliver: sends the answer.
        stamp: time of arrival [UNIX s].
        noted: whether a recorder listens.
    """

    name: str
    payload: bytes
    number: bytes
    deliver: Reply
    stamp: float
    noted: bool


class Way:
    """The way of requests on one key to the planner, and of their answers back. For any thread.

    A request is named, counted, decoded, and given to the planner, or refused on the way. Each is answered once.

    Attributes:
        name: the key in full, "hyperbit/<arm>/<key>".

    Args:
        prefix: of all keys, "hyperbit/<arm>".
        key: of the requests.
        reach: who receives a request.
        planner: receives the requests.
        outbox: sends answers and notes.
        goals: recognizes repeated goals.
    """

    is_noted = True  # for recorders

    def __init__(
        self, prefix: str, key: Key, reach: Reach, planner: Planner, outbox: Outbox, goals: RepeatedGoals
    ) -> None:
        self.name, self._key, self._reach = f"{prefix}/{key}", key, reach
        self._planner, self._outbox, self._goals = planner, outbox, goals
        self._brake, self._notes = FloodBrake(), Rate(MOST_NOTES)
        self._unanswered = set[Arrival]()  # an arrival is removed once, atomically

    def on_query(self, query: zenoh.Query) -> None:
        """Receives a query; its answer ends it."""
        deliver = partial(self._outbox.answer, query, self._key)
        self._receive(query.key_expr, query.payload, query.attachment, deliver)

    def on_put(self, sample: zenoh.Sample, publish_refusal: Reply) -> None:
        """Receives a put; only its refusal is published."""
        self._receive(sample.key_expr, sample.payload, sample.attachment, publish_refusal)

    def _receive(
        self, name: zenoh.KeyExpr, payload: zenoh.ZBytes | None, number: zenoh.ZBytes | None, deliver: Reply
    ) -> None:
        noted = self.is_noted and self._outbox.recorded()
        arrival = Arrival(str(name), content(payload), content(number), deliver, time.time(), noted)
        self._unanswered.add(arrival)
        try:
            self._submit(arrival)
        except Refusal as refusal:
            self._answer(arrival, refused(refusal.code, str(refusal), refusal.goal))
        except Exception:
            log.exception("a request on %s failed", self._key)
            self._answer(arrival, refused(INVALID_GOAL, "internal error, see the journal"))
        self._brake.slow_down()

    def _submit(self, arrival: Arrival) -> None:
        """Gives a request to the planner.

        Raises:
            Refusal: the request does not name the arm, is malformed, or too many wait.
        """
        self._check_named(arrival.name, named=self._reach == "named")
        if self._reach != "each arm" and len(self._unanswered) > MOST_UNANSWERED:
            raise Refusal(INVALID_GOAL, f"busy: {MOST_UNANSWERED} requests on {self._key} are waiting already")
        message = self._decode(arrival.payload)
        if isinstance(message, CancelMessage) and message.goal is not None:
            self._check_named(arrival.name, named=True)
        reply = partial(self._answer, arrival)
        if self._key == "goal" and isinstance(message, GoalMessage):
            identified = arrival.payload if message.id else None
            request = partial(self._planner.request, self._key, message)
            self._goals.submit(identified, arrival.number, reply, request)
        else:
            self._planner.request(self._key, message, reply)

    def _decode(self, payload: bytes) -> Message:
        """Returns the content of a request.

        Raises:
            Refusal: the payload is invalid; while many are, no reason is looked for.
        """
        try:
            return self._planner.decode(self._key, payload)
        except Refusal as refusal:
            if self._brake.explains():
                raise
            raise Refusal(refusal.code, BRIEFLY, refusal.goal) from None

    def _check_named(self, name: str, *, named: bool) -> None:
        """Checks the key expression of a request.

        Raises:
            Refusal: it does not name the key, or not in full though it must be `named`.
        """
        if name == self.name or self._reach == "all" or (not named and name.rpartition("/")[2] == self._key):
            return
        needed = f"{self._key} must be named, as in {self.name}"
        raise Refusal(INVALID_GOAL, f"{needed}; {name[:200]} does not name it")

    def _answer(self, arrival: Arrival, answer: Payload) -> None:
        """Answers a request that has no answer yet, and notes it."""
        try:
            self._unanswered.remove(arrival)
        except KeyError:
            return
        arrival.deliver(answer)
        accepted = answer.get("accepted") is not False
        if not accepted:
            self._brake.count_refusal()
        if arrival.noted and (accepted or self._notes.admits()):
            stamped = {"stamp": arrival.stamp, "key": self._key}
            self._outbox.publish_note({**stamped, **noted_content(arrival.payload), "answer": answer})


class Description(Way):
    """The way of queries on `arm`. The parts that do not change are not the business of the planner's core."""

    is_noted = False

    def _submit(self, arrival: Arrival) -> None:
        parts = wanted(arrival.payload)
        static = self._planner.description(parts)
        self._planner.request("arm", None, partial(self._describe, arrival, static, "running" in parts))

    def _describe(self, arrival: Arrival, static: Payload, running: bool, live: Payload) -> None:
        daemon = {"host": socket.gethostname(), "pid": os.getpid()}
        parts = {name: value for name, value in live.items() if running or name != "running"}
        self._answer(arrival, {**static, **parts, "daemon": daemon})


class PutRefusals:
    """Publishes the refusals of puts, which have no answer, on `result`.

    Args:
        outbox: sends them.
    """

    def __init__(self, outbox: Outbox) -> None:
        self._outbox, self._published, self._logged = outbox, Rate(MOST_REFUSALS), Rate(1)

    def publish(self, answer: Payload) -> None:
        """Publishes an answer that is a refusal, at most MOST_REFUSALS in a second."""
        if answer["accepted"]:
            return
        if self._published.admits():
            self._outbox.publish_refusal({"id": None, "status": "refused", **answer})
        elif self._logged.admits():
            log.warning("more than %d puts in a second are refused: %s", MOST_REFUSALS, answer["message"])


class Mailbox:
    """Keeps the samples put on a key until they are read. A put by a wildcard displaces no sample that names the key.

    Args:
        session: open session.
        key: in full.
    """

    def __init__(self, session: zenoh.Session, key: str) -> None:
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(MOST_SAMPLES)
        self._key, self._subscriber = key, session.declare_subscriber(key, ring)

    def receive(self) -> bytes | None:
        """Returns the latest sample put on the key itself; None if there is no new one. Never waits."""
        latest = None
        try:
            while (sample := self._subscriber.try_recv()) is not None:
                if str(sample.key_expr) == self._key:
                    latest = content(sample.payload)
        except zenoh.ZError:  # undeclared: the keys are closed before their readers
            return None
        return latest

    def undeclare(self) -> None:
        """Closes the mailbox."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]


def content(payload: zenoh.ZBytes | None) -> bytes:
    """Returns the bytes of a payload."""
    return b"" if payload is None else payload.to_bytes()


def wanted(payload: bytes) -> Collection[str]:
    """Returns the parts that a query of `arm` asks for, as in {"with": ["drawing"]}; empty in any other form."""
    try:
        return msgspec.json.decode(payload, type=dict[str, list[str]]).get("with", [])
    except (msgspec.MsgspecError, RecursionError, UnicodeError):
        return []


def noted_content(payload: bytes) -> dict[str, Any]:
    """Returns `payload` as it came, null if it is empty; for a payload that is no JSON also its `text`."""
    if not payload:
        return {"payload": None}
    try:
        msgspec.json.decode(payload)
    except (msgspec.MsgspecError, RecursionError, UnicodeError):
        return {"payload": None, "text": payload[:MOST_TEXT].decode(errors="replace")}
    return {"payload": msgspec.Raw(payload)}

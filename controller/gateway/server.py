"""Receives requests over Zenoh. Callbacks only submit them; all answers go through the outbox."""

import logging
import os
import socket
import time
from collections.abc import Callable, Collection
from typing import Protocol, Union

import msgspec
import zenoh

from controller.gateway.encoding import content
from controller.gateway.floods import FloodBrake
from controller.gateway.outbox import Outbox
from controller.gateway.repeated_goals import RepeatedGoals
from controller.gateway.request_notes import RequestNotes
from controller.motion import codes
from controller.planning.messages import Payload, Reply, refused

log = logging.getLogger(__name__)

MOST_REFUSALS = 50  # refusals of puts published in one second
MOST_SAMPLES = 64  # of a mailbox; a full one drops its oldest

Take = Callable[[bytes, Reply], None]
Receive = Callable[[], bytes | None]
Declared = Union[zenoh.Queryable[None], zenoh.Subscriber[None], "Mailbox", zenoh.LivelinessToken]


class Requests(Protocol):
    """Carries out requests. For any thread; no method waits."""

    def goal(self, payload: bytes, reply: Reply) -> None:
        """Runs a goal."""

    def plan(self, payload: bytes, reply: Reply) -> None:
        """Plans a goal without running it."""

    def jog(self, payload: bytes, reply: Reply) -> None:
        """Switches single actuators."""

    def cancel(self, reply: Reply) -> None:
        """Ends the running goal or stream."""

    def stop(self, reply: Reply) -> None:
        """Stops the arm until a reset."""

    def reset(self, reply: Reply) -> None:
        """Leaves a stop or a fault."""

    def degrade(self, payload: bytes, reply: Reply) -> None:
        """Locks an actuator, or unlocks it."""

    def obstacles(self, payload: bytes, reply: Reply) -> None:
        """Replaces the obstacles that were sent before."""

    def setpoints(self, receive: Receive) -> None:
        """Sets the function that returns the latest set-point."""

    def measured_tips(self, receive: Receive) -> None:
        """Sets the function that returns the latest measured tip."""

    def description(self, wanted: Collection[str] = ()) -> Payload:
        """Returns the payload of `arm` with the wanted parts, see Planning.description."""


class Server:
    """Declares the keys under "hyperbit/<arm>".

    Requests that can move an arm, or change its limits, must name it in full. `stop` and `cancel` also reach each arm
    that a wildcard matches, as in `hyperbit/*/stop`. Queries that change nothing accept any wildcard.

    A put has no reply. Its refusal is published on `result`, at most MOST_REFUSALS in a second.

    Args:
        session: open session.
        arm: name of the arm.
        requests: carries out the requests.
        outbox: sends the answers.
        goals: recognizes repeated goals.
        tracker: whether measured tips are accepted.
    """

    def __init__(
        self,
        session: zenoh.Session,
        arm: str,
        requests: Requests,
        outbox: Outbox,
        goals: RepeatedGoals,
        *,
        tracker: bool,
    ) -> None:
        self._session, self._outbox, self._goals = session, outbox, goals
        self._prefix = f"hyperbit/{arm}"
        self._second, self._refusals, self._brake = 0, 0, FloodBrake()
        self._notes = RequestNotes(lambda: outbox.has_subscriber("@request"), outbox.publish)
        self._declared: list[Declared] = []
        daemon = {"host": socket.gethostname(), "pid": os.getpid()}
        self._command("stop", lambda _, reply: requests.stop(reply), everywhere=True)
        self._command("cancel", lambda _, reply: requests.cancel(reply), everywhere=True)
        self._command("reset", lambda _, reply: requests.reset(reply))
        self._command("goal", requests.goal)
        self._command("jog", requests.jog)
        self._command("degrade", requests.degrade)
        self._command("obstacles", requests.obstacles)
        self._query("plan", self._noted("plan", self._well_formed(requests.plan)))
        self._query("arm", lambda data, reply: reply({**requests.description(wanted(data)), "daemon": daemon}))
        requests.setpoints(self._latest("setpoint"))
        if tracker:
            requests.measured_tips(self._latest("measured_tip"))
        self._declared.append(session.liveliness().declare_token(f"{self._prefix}/alive"))

    def close(self) -> None:
        """Undeclares all keys, the liveliness token first."""
        while self._declared:
            self._declared.pop().undeclare()

    def _command(self, key: str, take: Take, *, everywhere: bool = False) -> None:
        """Accepts commands on `key`, by query and by put; `everywhere`: also through a wildcard that matches it."""

        def on_query(query: zenoh.Query) -> None:
            reply = self._outbox.answer(query, key)
            self._braked(reply, lambda reply: received(query.key_expr, query.payload, query.attachment, reply))

        def on_put(sample: zenoh.Sample) -> None:
            reply = self._publish_refusal
            self._braked(reply, lambda reply: received(sample.key_expr, sample.payload, sample.attachment, reply))

        def received(
            expression: zenoh.KeyExpr, payload: zenoh.ZBytes | None, attached: zenoh.ZBytes | None, reply: Reply
        ) -> None:
            name, data = str(expression), content(payload)
            if name != f"{self._prefix}/{key}" and not (everywhere and name.rpartition("/")[2] == key):
                needed = f"{key} must be named, as in {self._prefix}/{key}"
                reply(refused(codes.INVALID_GOAL, f"{needed}; {name[:200]} does not name it"))
            elif key == "goal":
                self._take_goal(take, data, content(attached), self._notes.noting(key, data, reply))
            else:
                carry_out(take, data, self._notes.noting(key, data, reply))

        self._declared.append(self._session.declare_queryable(f"{self._prefix}/{key}", on_query))
        self._declared.append(self._session.declare_subscriber(f"{self._prefix}/{key}", on_put))

    def _take_goal(self, take: Take, payload: bytes, request: bytes, reply: Reply) -> None:
        """Submits a goal that is well-formed and new; others are answered here and enter no queue."""

        def take_once(payload: bytes, reply: Reply) -> None:
            self._goals.take(payload, request, reply, lambda *goal: carry_out(take, *goal))

        self._well_formed(take_once)(payload, reply)

    def _well_formed(self, take: Take) -> Take:
        """Returns a function that submits payloads which decode as goals, and refuses others."""

        def take_well_formed(payload: bytes, reply: Reply) -> None:
            refusal = self._brake.refusal(payload)
            if refusal is None:
                take(payload, reply)
            else:
                reply(refusal)

        return take_well_formed

    def _noted(self, key: str, take: Take) -> Take:
        """Returns a function that submits requests and publishes notes on their answers."""
        return lambda payload, reply: take(payload, self._notes.noting(key, payload, reply))

    def _query(self, key: str, take: Take) -> None:
        """Answers queries on `key`."""

        def on_query(query: zenoh.Query) -> None:
            self._braked(self._outbox.answer(query, key), lambda reply: carry_out(take, content(query.payload), reply))

        self._declared.append(self._session.declare_queryable(f"{self._prefix}/{key}", on_query))

    def _braked(self, reply: Reply, act: Callable[[Reply], None]) -> None:
        """Acts on a request. If many are refused at once, the callback pauses, which slows their sender."""
        refused_at_once = False

        def note(answer: Payload) -> None:
            nonlocal refused_at_once
            refused_at_once |= answer.get("accepted") is False
            reply(answer)

        act(note)
        if refused_at_once:
            self._brake.slow_down()

    def _latest(self, key: str) -> Receive:
        """Declares the mailbox of a key and returns its `receive`."""
        mailbox = Mailbox(self._session, f"{self._prefix}/{key}")
        self._declared.append(mailbox)
        return mailbox.receive

    def _publish_refusal(self, answer: Payload) -> None:
        """Publishes the refusal of a put on `result`."""
        if answer["accepted"]:
            return
        second = int(time.monotonic())
        self._refusals = 1 if second != self._second else self._refusals + 1
        self._second = second
        if self._refusals <= MOST_REFUSALS:
            self._outbox.publish("result", {"id": None, "status": "refused", **answer})
        elif self._refusals == MOST_REFUSALS + 1:
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


def carry_out(take: Take, payload: bytes, reply: Reply) -> None:
    """Submits a request; an exception becomes an answer."""
    try:
        take(payload, reply)
    except Exception:
        log.exception("a request failed")
        reply(refused(codes.INVALID_GOAL, "internal error, see the journal"))


def wanted(payload: bytes) -> Collection[str]:
    """Returns the parts that a query of `arm` asks for, as in {"with": ["drawing"]}; empty in any other form."""
    try:
        return msgspec.json.decode(payload, type=dict[str, list[str]]).get("with", [])
    except (msgspec.MsgspecError, RecursionError):
        return []

"""Receives requests over Zenoh, and hands each to the planner once. All answers go through the outbox."""

import json
import logging
import os
import socket
import sqlite3
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple, get_args

import msgspec
import zenoh
from msgspec import structs
from zenoh.handlers import Callback

from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.gateway.arrivals import Clocks, FloodBrake, Rate, RepeatedGoals, keys_of
from hyperbit.controller.gateway.outbox import Outbox
from hyperbit.controller.gateway.poses import Poses, decode_poses
from hyperbit.controller.messages.arm import Daemon, Description
from hyperbit.controller.messages.goals import Answer, GoalEnd, LedgerAnswer, Note, internal_error, refused
from hyperbit.controller.motion.decoding.goal import GoalMessage, Undecodable
from hyperbit.controller.motion.decoding.payloads import parse
from hyperbit.controller.planning.core import events
from hyperbit.controller.planning.core.events import LiveArm
from hyperbit.controller.planning.loop import Mailbox
from hyperbit.controller.planning.planner import Planner
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

log = logging.getLogger(__name__)

MOST_SENDER = 64  # bytes of an attachment that identify its sender
MOST_UNANSWERED = 100  # requests on one key; a planner refuses more than 16 goals by itself, if it is not too slow
MOST_REFUSALS = 50  # refusals of puts published in one second
MOST_NOTES = 50  # notes in one second on refused requests
MOST_QUERY = 1_000  # bytes of a query on `result`
LEDGER_FIELDS = ("status", "code", "message", "switches")  # of a result, in the answer to a query on `result`
MOST_TEXT = 500  # characters of a payload that is no JSON, in a note

# Who receives a request: the arm that is named in full, also each arm that a wildcard matches, or whoever is meant by
# an expression that may not even name the key, as `hyperbit/**`.
Reach = Literal["named", "each arm", "all"]
Command = Literal["stop", "cancel", "reset", "goal", "jog", "degrade", "obstacles", "fault", "poses"]
ServedKey = Command | Literal["plan", "arm", "result"]


Deliver = Callable[[Answer | Description], None]  # must not wait


class GatewayParts(NamedTuple):  # parts that answer the requests of one arm
    planner: Planner
    outbox: Outbox
    goals: RepeatedGoals
    poses: Poses
    find: Callable[[str], Mapping[str, Any] | None]  # returns the ledger's row of a goal; raises sqlite3.Error
    clocks: Clocks = Clocks()


class Server:
    """Declares the keys under "hyperbit/<arm>".

    Requests that can move an arm, or change its limits, must name it in full. `stop` and `cancel` also reach each arm
    that a wildcard matches, as in `hyperbit/*/stop`. Queries that change nothing accept any wildcard.

    Commands are received in Zenoh's own thread, because threads for each key would change their order.
    """

    def __init__(self, session: zenoh.Session, arm: str, parts: GatewayParts) -> None:
        self._session, self._prefix, self._parts = session, f"hyperbit/{arm}", parts
        self._outbox, planner = parts.outbox, parts.planner
        self._declared = ExitStack()
        clock = parts.clocks.monotonic
        self._refusals, self._logged_refusals = Rate(MOST_REFUSALS, clock), Rate(1, clock)  # of puts
        for key in get_args(Command):
            way = self._query(key, "each arm" if key in ("stop", "cancel") else "named", ordered=True)
            self._subscribe(way.name, partial(way.receive, deliver=self._publish_refusal))
        self._query("plan", "all", ordered=True)
        self._query("arm", "all", ordered=False)
        self._query("result", "all", ordered=False)
        self._mailbox("setpoint", planner.loop.setpoints)
        if planner.decoder.tracker:
            self._mailbox("measured_tip", planner.loop.tips)
        self._declared.callback(session.liveliness().declare_token(f"{self._prefix}/alive").undeclare)

    def close(self) -> None:
        self._declared.close()

    def _subscribe(self, name: str, on_put: Callable[[zenoh.Sample], None]) -> None:
        subscriber = self._session.declare_subscriber(name, Callback(on_put, indirect=False))
        self._declared.callback(subscriber.undeclare)

    def _query(self, key: ServedKey, reach: Reach, *, ordered: bool) -> "Way":
        """Answers queries on `key`; `ordered` if they have a place among the commands."""
        way = Way(self._prefix, key, reach, self._parts)

        def on_query(query: zenoh.Query) -> None:
            way.receive(query, partial(self._outbox.answer, query, key))

        callback = Callback(on_query, indirect=not ordered)
        self._declared.callback(self._session.declare_queryable(way.name, callback).undeclare)
        return way

    def _mailbox(self, key: str, mailbox: Mailbox) -> None:
        name, loop = f"{self._prefix}/{key}", self._parts.planner.loop

        def put(sample: zenoh.Sample) -> None:
            if str(sample.key_expr) == name:
                sender = content(sample.attachment)[:MOST_SENDER].decode("ascii", "backslashreplace")
                mailbox.put(content(sample.payload), loop.arrive(), sender)

        self._subscribe(name, put)

    def _publish_refusal(self, answer: Answer | Description) -> None:
        """Publishes the answer to a put on `result` if it is a refusal, at most MOST_REFUSALS in a second."""
        if isinstance(answer, Description) or answer.accepted:
            return
        if self._refusals.admits():
            fields = {name: value for name, value in structs.asdict(answer).items() if name != "homing"}
            self._outbox.publish("result", GoalEnd(status="refused", **{"id": None, **fields}))
        elif self._logged_refusals.admits():
            log.warning("more than %d puts in a second are refused: %s", MOST_REFUSALS, answer.message)


class ResultQuery(msgspec.Struct, forbid_unknown_fields=True):
    id: Annotated[str, msgspec.Meta(min_length=1, max_length=128)]  # of the goal


@dataclass(eq=False, frozen=True)
class Received:
    name: str  # its key expression
    arrival: events.Arrival
    payload: bytes
    number: bytes  # that the client attached; empty if none
    deliver: Deliver  # sends the answer
    stamp: float  # [UNIX s]


class Way:
    """Passes requests on one key to the planner, and each answer back, once. Thread-safe."""

    def __init__(self, prefix: str, key: ServedKey, reach: Reach, parts: GatewayParts) -> None:
        self.name, self._reach = f"{prefix}/{key}", reach  # name: the key in full
        self._key = key
        self._planner, self._outbox, self._goals, self._poses, self._find, self._clocks = parts
        clock, _, pause = parts.clocks
        self._brake, self._notes = FloodBrake(clock, pause), Rate(MOST_NOTES, clock)
        self._unanswered = set[Received]()  # a request is removed once, atomically

    def receive(self, it: zenoh.Query | zenoh.Sample, deliver: Deliver) -> None:
        place = self._planner.loop.arrive()
        payload, attachment, stamp = content(it.payload), content(it.attachment), self._clocks.wall()
        received = Received(str(it.key_expr), place, payload, attachment, deliver, stamp)
        self._unanswered.add(received)
        try:
            self._request(received)
        except Refusal as refusal:
            self._answer(received, refused(refusal))
        except Exception:
            log.exception("a request on %s failed", self._key)
            self._answer(received, internal_error())
        self._brake.slow_down()

    def _request(self, received: Received) -> None:
        """Queues a request for the planner. Raises Refusal if it is malformed, names no arm, or too many wait."""
        match self._key:
            case "arm":
                self._describe(received)
            case "poses":
                self._check_named(received.name, named=True)
                message = decode_poses(received.payload)
                if message.goal is not None:
                    self._planner.decoder.decode(
                        "goal", json.dumps(message.goal).encode()
                    )  # writes also what JSON lacks
                answer = self._poses.change(message)
                self._outbox.count_poses_change()
                self._answer(received, answer)
            case "result":
                self._find_result(received)
            case key:
                self._give_to_planner(received, key)

    def _give_to_planner(self, received: Received, key: events.Key) -> None:
        self._check_named(received.name, named=self._reach == "named")
        if self._reach != "each arm" and len(self._unanswered) > MOST_UNANSWERED:
            raise Refusal(Reason.BUSY, most=MOST_UNANSWERED, what=f"requests on {key}")
        try:
            message = self._planner.decoder.decode(key, received.payload)
        except Undecodable as refusal:
            if self._brake.explained.admits():
                raise
            raise Refusal(Reason.NOT_EXPLAINED, refusal.goal) from None  # in a flood: finding the reason takes long
        if isinstance(message, events.CancelMessage) and message.goal is not None:
            self._check_named(received.name, named=True)
        unread = message.unread if isinstance(message, events.CancelMessage) else ""

        def reply(answer: Answer) -> None:
            note = f"; everything was to be canceled, because the payload cannot be read: {unread}" if unread else ""
            self._answer(received, structs.replace(answer, message=f"{answer.message}{note}") if note else answer)

        request = self._planner.loop.request
        if key == "goal" and isinstance(message, GoalMessage):
            keys = keys_of(received.payload, received.number, has_id=message.id is not None)
            self._goals.receive_goal(keys, reply, partial(request, received.arrival, key, message))
        else:
            request(received.arrival, key, message, reply)

    def _describe(self, received: Received) -> None:
        """Answers a query on `arm`; adds the parts that the planner's core does not know."""
        try:  # the parts asked for, as in {"with": ["drawing"]}; none for another form
            parts = decode(received.payload, dict[str, list[str]]).get("with", [])
        except Unreadable:
            parts = []
        static = self._planner.description(parts)

        def answer(live: Answer | LiveArm) -> None:
            if isinstance(live, Answer):  # a refusal
                self._answer(received, live)
                return
            fields = {name: value for name, value in live._asdict().items() if name != "running" or name in parts}
            daemon = Daemon(socket.gethostname(), os.getpid())
            self._answer(received, structs.replace(static, **fields, poses=self._poses.listed(), daemon=daemon))

        self._planner.loop.request(received.arrival, "arm", None, answer)

    def _find_result(self, received: Received) -> None:
        """Answers from the ledger, which has the results of ended goals, also for a client that was away."""
        goal = parse(received.payload, ResultQuery, "result", MOST_QUERY).id
        try:
            row = self._find(goal)
        except sqlite3.Error as error:
            raise Refusal(Reason.LEDGER_UNREADABLE, why=str(error)) from None
        if row is None:
            raise Refusal(Reason.UNKNOWN_GOAL, goal=goal)
        ended = row["ended"] is not None
        result = GoalEnd(id=goal, **{name: row[name] for name in LEDGER_FIELDS}) if ended else None
        message = "the goal has ended" if ended else "the goal has no result yet"
        self._answer(received, LedgerAnswer(accepted=True, message=message, result=result))

    def _check_named(self, name: str, *, named: bool) -> None:
        """Raises Refusal if a key expression does not match the key, or is a wildcard though `named` forbids it."""
        if name == self.name or self._reach == "all" or (not named and name.rpartition("/")[2] == self._key):
            return
        raise Refusal(Reason.NOT_NAMED, key=self._key, name=self.name, given=name[:200])

    def _answer(self, received: Received, answer: Answer | Description) -> None:
        """Answers a request that has no answer yet, and publishes a note for a listening recorder."""
        try:
            self._unanswered.remove(received)
        except KeyError:
            return
        received.deliver(answer)
        if isinstance(answer, Description):
            return
        if not answer.accepted:
            self._brake.refused.add()
        if self._key != "arm" and self._outbox.recorded() and (answer.accepted or self._notes.admits()):
            self._outbox.publish("@request", noted(received.stamp, self._key, received.payload, answer))


def content(payload: zenoh.ZBytes | None) -> bytes:
    return b"" if payload is None else payload.to_bytes()


def noted(stamp: float, key: str, payload: bytes, answer: Answer) -> Note:
    """Returns the note on a request with its unchanged payload, None if it is empty; or the text that is no JSON."""
    note = Note(stamp=stamp, key=key, answer=answer)
    if not payload:
        return note
    try:
        decode(payload)
    except Unreadable:
        return structs.replace(note, text=payload[:MOST_TEXT].decode(errors="replace"))
    return structs.replace(note, payload=msgspec.Raw(payload))

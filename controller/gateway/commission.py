"""Serves a commission over Zenoh, in the place of the daemon: its questions in `state`, their answers, and stops."""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, NamedTuple

import msgspec
import zenoh
from msgspec.structs import astuple, replace

from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.commission.driver import Commissioner, NoDriver
from hyperbit.controller.commission.questions import Questions, late_answer
from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.gateway.claim import Claim
from hyperbit.controller.messages.arm import Daemon, WiredArm
from hyperbit.controller.messages.goals import Answer, done, refused
from hyperbit.controller.messages.state import Fault, State
from hyperbit.controller.program import unpack
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

log = logging.getLogger(__name__)

STATE_EVERY = 0.25  # [s]
MOST_BYTES = 1_000  # of an answer
ENDING = ("stop", "cancel")  # they also reach each arm that a wildcard matches
REFUSED = ("goal", "jog", "reset", "degrade", "obstacles", "fault", "poses", "plan")
JSON = zenoh.Encoding.APPLICATION_JSON


class AnswerMessage(msgspec.Struct, forbid_unknown_fields=True):
    """An answer: the number of its question, its key, and the `stamp` of the state that its sender has seen."""

    question: Annotated[int, msgspec.Meta(ge=0, le=2**53)]
    answer: Annotated[str, msgspec.Meta(max_length=100)]
    stamp: float


class Served(NamedTuple):
    """A commission: the arm, who drives it, and what it asks."""

    settings: ArmSettings
    labels: Sequence[str]
    driver: Commissioner
    questions: Questions


@contextlib.contextmanager
def serving(session: zenoh.Session, it: Served) -> Iterator[None]:
    """Serves a commission while the context lasts. Raises AlreadyRunning if a daemon of the arm is in the network."""
    prefix, ended = f"hyperbit/{it.settings.name}", threading.Event()
    with contextlib.ExitStack() as closing:
        claim = Claim(session, it.settings.name, simulated=it.driver.simulated)
        closing.callback(claim.close)
        claim.confirm()
        for key in ("arm", "answer", *ENDING, *REFUSED):
            on_query = functools.partial(answer_query, it, prefix, key)
            closing.callback(session.declare_queryable(f"{prefix}/{key}", on_query).undeclare)
            if key in ENDING:  # a put has no answer
                on_put = functools.partial(hear_put, it, key)
                closing.callback(session.declare_subscriber(f"{prefix}/{key}", on_put).undeclare)
        closing.callback(session.liveliness().declare_token(f"{prefix}/alive").undeclare)
        publish = functools.partial(session.put, f"{prefix}/state", encoding=JSON)
        thread = threading.Thread(target=publish_states, args=(it, publish, ended), name="states")
        thread.start()
        closing.callback(thread.join)
        closing.callback(ended.set)
        yield


def publish_states(it: Served, publish: Callable[[bytes], None], ended: threading.Event) -> None:
    while not ended.is_set():
        it.questions.changed.wait(STATE_EVERY)
        it.questions.changed.clear()
        publish(msgspec.json.encode(state(it)))
    publish(msgspec.json.encode(replace(state(it), mode="unknown", reason="the commission has ended")))


def state(it: Served) -> State:
    """Returns `state`. No position is told: nobody has seen yet which output moves what."""
    at, count = it.driver.snapshot, len(it.labels)
    told = State(
        stamp=time.time(),
        mode="starting",
        reason="waits for the executor",
        simulated=it.driver.simulated,
        commission=it.questions.payload(),
    )
    if at is None:
        return told
    bits = unpack(at.outputs)
    return replace(
        told,
        mode=at.mode,
        reason=at.reason,
        measured=[None] * count,
        commanded=[bits >> k & 1 for k in range(count)],
        faults=[Fault(*astuple(fault)) for fault in at.faults],
    )


def answer_query(it: Served, prefix: str, key: str, query: zenoh.Query) -> None:
    """Answers a query on a key. Called by a thread of this key alone, so that a stop waits for no other request."""
    with query:
        given = str(query.key_expr)
        if given != f"{prefix}/{key}" and key != "arm" and not (key in ENDING and given.endswith(f"/{key}")):
            answer: Answer | WiredArm = refused(
                Refusal(Reason.NOT_NAMED, key=key, name=f"{prefix}/{key}", given=given[:200])
            )
        elif key == "arm":
            answer = description(it)
        elif key == "answer":
            answer = take_answer(it.questions, query)
        elif key in ENDING:
            answer = end_motion(it, key)
        else:
            answer = refused(Refusal(Reason.COMMISSIONING, key=key))
        query.reply(f"{prefix}/{key}", msgspec.json.encode(answer), encoding=JSON)


def take_answer(questions: Questions, query: zenoh.Query) -> Answer:
    data, request = ((part.to_bytes() if part is not None else b"") for part in (query.payload, query.attachment))
    try:
        if len(data) > MOST_BYTES:
            raise Refusal(Reason.TOO_LARGE, what="answer", size=len(data), most=MOST_BYTES)
        message = decode(data, AnswerMessage)
        if (late := late_answer(message.stamp)) is not None:
            raise late
        questions.answer(message.question, message.answer, request)
    except Unreadable as error:
        return refused(Refusal(Reason.INVALID_FIELDS, faults=str(error)))
    except Refusal as refusal:
        return refused(refusal)
    return done("answered")


def hear_put(it: Served, key: str, sample: zenoh.Sample) -> None:
    end_motion(it, key)


def end_motion(it: Served, key: str) -> Answer:
    """Stops the arm, or ends its trial; the answer comes when nothing switches any more."""
    try:
        answer = it.driver.stop() if key == "stop" else it.driver.cancel("canceled")
    except NoDriver as error:
        return refused(Refusal(Reason.EXECUTOR_LOST, why=str(error)))
    return done(answer.message) if answer.refused is None else refused(answer.refused.refusal)


def description(it: Served) -> WiredArm:
    """Returns the answer to `arm`, as far as the wiring tells."""
    return WiredArm(
        name=it.settings.name,
        unit=it.settings.unit,
        actuators=list(it.labels),
        simulated=it.driver.simulated,
        daemon=Daemon(socket.gethostname(), os.getpid()),
    )

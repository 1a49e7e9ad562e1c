"""Requests over Zenoh. Callbacks only hand over; every answer leaves through the outbox."""

import itertools
import time
from collections.abc import Callable

import msgspec
import zenoh

from controller.config import Arm
from controller.daemon.events import Cancel, Payload, Reply, Reset, Stop
from controller.daemon.loop import ControlLoop
from controller.daemon.outbox import Outbox
from controller.daemon.planner import Planner, Request
from controller.manipulator.notation import format_configuration


class Server:
    """Declares the keys under "hyperbit/<arm>"; undeclared with the session.

    A request that comes as a plain put has nobody to answer: a refused goal is then told on `result`.
    """

    def __init__(self, session: zenoh.Session, arm: Arm, loop: ControlLoop, planner: Planner, outbox: Outbox) -> None:
        """Declares queryables, subscribers and the liveliness token."""
        self._outbox, self._planner, self._inbox = outbox, planner, loop.inbox
        self._arrivals = itertools.count(1)
        self._declared: list[object] = []
        prefix = f"hyperbit/{arm.settings.name}"
        self._declare(session, f"{prefix}/goal", lambda payload, reply: self._goal(payload, reply, run=True))
        self._declare(session, f"{prefix}/cancel", lambda _, reply: self._inbox.put(Cancel(self._arrival(), reply)))
        self._declare(session, f"{prefix}/stop", lambda _, reply: self._inbox.put(Stop(self._arrival(), reply)))
        self._declare(session, f"{prefix}/reset", lambda _, reply: self._inbox.put(Reset(self._arrival(), reply)))
        described = description(arm)
        answering = [
            (f"{prefix}/plan", lambda payload, reply: self._goal(payload, reply, run=False)),
            (f"{prefix}/arm", lambda _, reply: reply(described)),
        ]
        self._declared += [session.declare_queryable(key, self._answering(take)) for key, take in answering]
        self._token = session.liveliness().declare_token(f"{prefix}/alive")

    def _declare(self, session: zenoh.Session, key: str, take: Callable[[bytes, Reply], None]) -> None:
        """Takes requests on `key`, by query and by put."""

        def on_put(sample: zenoh.Sample) -> None:
            take(sample.payload.to_bytes(), self._tell)

        self._declared += [
            session.declare_queryable(key, self._answering(take)),
            session.declare_subscriber(key, on_put),
        ]

    def _answering(self, take: Callable[[bytes, Reply], None]) -> Callable[[zenoh.Query], None]:
        def on_query(query: zenoh.Query) -> None:
            payload = query.payload
            take(payload.to_bytes() if payload is not None else b"", self._outbox.answer(query))

        return on_query

    def _tell(self, answer: Payload) -> None:
        """Tells a refusal on `result`, where there is nobody to answer."""
        if not answer["accepted"]:
            self._outbox.publish("result", {"id": None, "status": "refused", **answer})

    def _goal(self, payload: bytes, reply: Reply, *, run: bool) -> None:
        self._planner.submit(Request(payload, self._arrival(), time.time(), run, reply))

    def _arrival(self) -> int:
        return next(self._arrivals)


def description(arm: Arm) -> Payload:
    """Returns the payload of `arm`."""
    manipulator = arm.manipulator
    return {
        "name": arm.settings.name,
        "dimension": manipulator.dimension,
        "length": manipulator.length,
        "states": manipulator.states.tolist(),
        "frames": [module.frames.tolist() for module in manipulator.modules],
        "base": manipulator.base.tolist(),
        "actuators": list(manipulator.actuators),
        "contracted": format_configuration(manipulator, [0] * len(manipulator.modules)),
        "tolerance": {"position": arm.tolerance},
        "travel_time": arm.settings.travel_time,
        "method": arm.settings.method,
        "boards": [msgspec.to_builtins(entry) for entry in arm.wiring],
    }

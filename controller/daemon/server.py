"""Requests over Zenoh. Callbacks only hand over; every answer leaves through the outbox."""

import time
from collections.abc import Callable

import msgspec
import zenoh

from controller.config import Arm
from controller.daemon.arrivals import Arrivals
from controller.daemon.avoidance import keeping
from controller.daemon.events import Cancel, Degrade, KeepOut, Payload, Reply, Reset, Stop
from controller.daemon.loop import ControlLoop
from controller.daemon.messages import refused
from controller.daemon.outbox import Outbox
from controller.daemon.planner import Planner, Question
from controller.manipulator.notation import format_configuration
from controller.motion import codes, degrade, obstacles
from controller.motion.codes import Refusal

Take = Callable[[bytes, Reply], None]
Declared = zenoh.Queryable[None] | zenoh.Subscriber[None] | zenoh.LivelinessToken


class Server:
    """Declares the keys under "hyperbit/<arm>".

    A request that comes as a plain put has nobody to answer: a refused one is then told on `result`. Wildcards find the
    keys that only tell something; those that act must be named, so that a look around (`hyperbit/**`) resets no arm.
    """

    def __init__(
        self,
        session: zenoh.Session,
        arm: Arm,
        loop: ControlLoop,
        planner: Planner,
        outbox: Outbox,
        arrivals: Arrivals,
    ) -> None:
        """Declares queryables, subscribers and the liveliness token."""
        self._session, self._planner, self._outbox = session, planner, outbox
        self._prefix = f"hyperbit/{arm.settings.name}"
        self._arrivals = arrivals
        described = description(arm)
        self._declared: list[Declared] = []
        self._act("goal", lambda payload, reply: self._question(payload, reply, run=True))
        self._act("cancel", lambda _, reply: loop.inbox.hand_over(Cancel(arrivals.request(), reply)))
        self._act("stop", lambda _, reply: loop.inbox.hand_over(Stop(arrivals.request(), reply)))
        self._act("reset", lambda _, reply: loop.inbox.hand_over(Reset(arrivals.request(), reply)))
        self._act("degrade", lambda payload, reply: self._degrade(payload, reply, loop))
        self._act("obstacles", lambda payload, reply: self._keep_out(payload, reply, loop, arm))
        self._answer("plan", lambda payload, reply: self._question(payload, reply, run=False))
        self._answer("arm", lambda _, reply: reply(described))
        self._declared.append(session.liveliness().declare_token(f"{self._prefix}/alive"))

    def close(self) -> None:
        """Takes no more requests; the liveliness token goes."""
        for declared in reversed(self._declared):
            declared.undeclare()  # type: ignore[no-untyped-call]

    def _act(self, key: str, take: Take) -> None:
        """Takes requests on `key`, by query and by put."""

        def on_query(query: zenoh.Query) -> None:
            only_named(query.key_expr, content(query.payload), self._outbox.answer(query, key))

        def on_put(sample: zenoh.Sample) -> None:
            only_named(sample.key_expr, content(sample.payload), self._tell)

        def only_named(expression: zenoh.KeyExpr, payload: bytes, reply: Reply) -> None:
            if str(expression).rpartition("/")[2] == key:
                take(payload, reply)
            else:
                reply(refused(codes.INVALID_GOAL, f"{key} must be named; {expression} does not name it"))

        self._declared.append(self._session.declare_queryable(f"{self._prefix}/{key}", on_query))
        self._declared.append(self._session.declare_subscriber(f"{self._prefix}/{key}", on_put))

    def _answer(self, key: str, take: Take) -> None:
        """Answers queries on `key`."""

        def on_query(query: zenoh.Query) -> None:
            take(content(query.payload), self._outbox.answer(query, key))

        self._declared.append(self._session.declare_queryable(f"{self._prefix}/{key}", on_query))

    def _tell(self, answer: Payload) -> None:
        """Tells a refusal on `result`, where there is nobody to answer."""
        if not answer["accepted"]:
            self._outbox.publish("result", {"id": None, "status": "refused", **answer})

    def _question(self, payload: bytes, reply: Reply, *, run: bool) -> None:
        self._planner.submit(Question(self._arrivals.request(), reply, payload, time.time(), run))

    def _degrade(self, payload: bytes, reply: Reply, loop: ControlLoop) -> None:
        try:
            loop.inbox.hand_over(Degrade(self._arrivals.request(), reply, degrade.decode(payload)))
        except Refusal as error:
            reply(refused(error.code, str(error)))

    def _keep_out(self, payload: bytes, reply: Reply, loop: ControlLoop, arm: Arm) -> None:
        try:
            kept = keeping(arm, obstacles.decode(payload, arm.manipulator.dimension))
            loop.inbox.hand_over(KeepOut(self._arrivals.request(), reply, kept))
        except Refusal as error:
            reply(refused(error.code, str(error)))


def content(payload: zenoh.ZBytes | None) -> bytes:
    """Returns the bytes of a payload."""
    return b"" if payload is None else payload.to_bytes()


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
        "tolerance": {"position": arm.tolerance, "orientation": arm.turn},
        "travel_time": arm.settings.travel_time,
        "inrush": arm.settings.inrush,
        "rest_time": arm.settings.rest_time,
        "method": arm.settings.method,
        "obstacles": [msgspec.to_builtins(entry) for entry in arm.settings.obstacles],
        "body_radius": arm.settings.body_radius,
        "self_collision": arm.settings.self_collision,
        "boards": [msgspec.to_builtins(entry) for entry in arm.wiring],
    }

"""Kills processes when the planner's loop reaches a chosen step. Runs in the planner's process, for tests only.

A test sends an order through a socket in the folder of the arm, and gets a line when the order is in force. The nursery
of such planners: python -m tests.system.kills.trigger SOCKET planner ARM.yaml
"""

import json
import os
import signal
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

from hyperbit.controller.gateway import outbox
from hyperbit.controller.gateway.outbox import Outbox
from hyperbit.controller.host.process import Quit
from hyperbit.controller.planning.core.events import (
    Action,
    Event,
    FromExecutor,
    Published,
    PublishResult,
    Start,
    ToExecutor,
)
from hyperbit.controller.planning.core.tasks import BuildScene
from hyperbit.controller.planning.ledger import PublishedResults
from hyperbit.controller.planning.loop import Loop
from hyperbit.controller.program import Accepted, Acknowledge, Ended, Lock, Program, Replacement, Setpoint, Settled
from tests.system.stack import nursery

SOCKET, MARK = "kills.sock", "KILLS"
RECONNECTED = 0.5  # [s] instead of 5: the clients of these tests are connected before the planner starts

SENT = {
    Program: "offered",
    Replacement: "replaced",
    Acknowledge: "acknowledged",
    Setpoint: "following",
    Lock: "locking",
}
HEARD = {Accepted: "accepted", Settled: "settled", Ended: "ended"}


class Order(NamedTuple):
    """What to kill, and when.

    Attributes:
        step: "before", "within" or "after"; within a step of the core means after one of its actions. Of a result
            also "unmarked", "marked" and "put".
        count: number of times that this step is reached.
        delay: time from then on [s].
        pids: processes to kill, in order; the planner's own is the last one.
    """

    moment: str
    step: str
    count: int
    delay: float
    pids: list[int]


class Trigger:
    """Carries out one order at a time. The order is set by its own thread; any thread reaches steps."""

    def __init__(self) -> None:
        self._order: Order | None = None
        self._reached = 0

    def listen(self, path: Path) -> None:
        path.unlink(missing_ok=True)
        server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        server.bind(str(path))
        server.listen()
        threading.Thread(target=self._serve, args=(server,), name="kills", daemon=True).start()

    def reach(self, moment: str | None, step: str) -> None:
        order = self._order
        if order is None or (order.moment, order.step) != (moment, step):
            return
        self._reached += 1
        if self._reached < order.count:
            return
        self._order = None
        if order.delay > 0:
            timer = threading.Timer(order.delay, self._kill, (order,))
            timer.daemon = True
            timer.start()
        else:
            self._kill(order)

    def _kill(self, order: Order) -> None:
        os.write(2, f"{MARK} at {time.monotonic()}\n".encode())
        for pid in order.pids:
            os.kill(pid, signal.SIGKILL)

    def _serve(self, server: socket.socket) -> None:
        while True:
            connection = server.accept()[0]
            with connection:
                self._reached = 0
                self._order = Order(*json.loads(connection.recv(1 << 16)))
                connection.send(b"in force")


def install(folder: Path) -> None:
    trigger = Trigger()
    trigger.listen(folder / SOCKET)
    outbox.RECONNECTED = RECONNECTED
    step, act, send, add = Loop._step, Loop._act, Outbox._send, PublishedResults.add
    within: list[str | None] = [None]  # moment of the event that the loop handles

    def stepping(self: Loop, event: Event) -> None:
        within[0] = moment = moment_of_event(event)
        trigger.reach(moment, "before")
        step(self, event)
        trigger.reach(moment, "after")

    def acting(self: Loop, action: Action) -> None:
        moment = moment_of_action(action)
        trigger.reach(moment, "before")
        act(self, action)
        trigger.reach(moment, "after")
        trigger.reach(within[0], "within")

    def sending(self: Outbox, target: Any, key: str, payload: Any) -> None:
        if isinstance(target, PublishResult):
            trigger.reach("published", "unmarked")
        send(self, target, key, payload)
        if isinstance(target, PublishResult):
            trigger.reach("published", "put")

    def adding(self: PublishedResults, *result: Any) -> None:
        add(self, *result)
        trigger.reach("published", "marked")

    Loop._step, Loop._act, Outbox._send, PublishedResults.add = stepping, acting, sending, adding  # type: ignore


def moment_of_event(event: Event) -> str | None:
    if isinstance(event, FromExecutor):
        return HEARD.get(type(event.message))
    return {Published: "published", Quit: "shutdown"}.get(type(event))


def moment_of_action(action: Action) -> str | None:
    if isinstance(action, ToExecutor):
        return SENT.get(type(action.message))
    return "obstacles" if isinstance(action, Start) and isinstance(action.task, BuildScene) else None


def run(arguments: list[str]) -> int:
    """The process of `hyperbit run`, with a trigger."""
    install(Path(os.environ["STATE_DIRECTORY"]))
    return nursery.run(arguments)


if __name__ == "__main__":
    nursery.COMMANDS["planner"] = run
    nursery.main(*sys.argv[1:])

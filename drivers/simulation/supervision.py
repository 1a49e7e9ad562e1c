"""Heartbeats and node guarding of a simulated board (CiA 301, 7.2.8.3.2)."""

from __future__ import annotations

import math
from collections.abc import Callable

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import State
from hyperbit.drivers.simulation.objects import Objects

_GUARD_TIME, _LIFE_FACTOR, _CONSUMER, _PRODUCER = 0x100C, 0x100D, 0x1016, 0x1017


class Supervision:
    """Sends the board's heartbeat, answers node guarding, and finds the loss of the master.

    A producer time, 1017h, other than 0 ends node guarding: a node uses only one of them. `objects` has 1016h and
    1017h, or 100Ch and 100Dh, or all four. `lose` is called when the master is lost, `recover` at each sign of its
    life.
    """

    def __init__(
        self,
        node: int,
        objects: Objects,
        send: Callable[[int, bytes], None],
        lose: Callable[[], None],
        recover: Callable[[], None],
    ) -> None:
        self._cob_id = cia301.HEARTBEAT + node
        self._objects = objects
        self._send, self._lose, self._recover = send, lose, recover
        self._guards = objects.has(_GUARD_TIME)
        self.reset()

    def reset(self) -> None:
        """Resets all timers, as after a boot-up."""
        self._heartbeat_due = self._heard_until = self._guarded_until = math.inf
        self._toggle = 0

    def begin(self, now: float) -> None:
        """Starts to send heartbeats, if a producer time is stored in 1017h."""
        self._set_producer(now)

    @property
    def due(self) -> float:
        """Time when `step` must be called [s]."""
        return min(self._heartbeat_due, self._heard_until, self._guarded_until)

    def step(self, now: float, state: State) -> None:
        """Sends a due heartbeat, and reports the loss of the master."""
        if now >= self._heartbeat_due:
            self._send(self._cob_id, bytes([state]))
            self._heartbeat_due = now + (self._objects.number(_PRODUCER) / 1000 or math.inf)
        if now >= min(self._heard_until, self._guarded_until):
            self._heard_until = self._guarded_until = math.inf
            self._lose()

    def hear(self, cob_id: int, data: bytes, now: float, state: State) -> None:
        """Takes the heartbeat of a consumed node, 1016h, or the remote frame of node guarding."""
        if cob_id == cia301.REMOTE | self._cob_id:
            self._answer(now, state)
        elif len(data) == 1:
            for sub in self._objects.subs(_CONSUMER):
                consumed = self._objects.number(_CONSUMER, sub)
                node, period = consumed >> 16 & 0x7F, (consumed & 0xFFFF) / 1000
                if period and node and cob_id == cia301.HEARTBEAT + node:
                    self._heard_until = now + period
                    self._recover()

    def written(self, index: int, now: float) -> None:
        """Call after an SDO write."""
        if index == _PRODUCER:
            self._set_producer(now)
        elif index == _CONSUMER:
            self._heard_until = math.inf  # supervision begins with the next heartbeat
        elif index in (_GUARD_TIME, _LIFE_FACTOR):
            self._guarded_until = math.inf  # supervision begins with the next remote frame

    def _set_producer(self, now: float) -> None:
        period = self._objects.number(_PRODUCER) / 1000
        self._heartbeat_due = now + period if period else math.inf
        if period:
            self._guarded_until = math.inf

    def _answer(self, now: float, state: State) -> None:
        if not self._guards or self._heartbeat_due < math.inf:
            return
        self._send(self._cob_id, bytes([self._toggle << 7 | state]))
        self._toggle ^= 1
        life = self._objects.number(_GUARD_TIME) * self._objects.number(_LIFE_FACTOR) / 1000
        self._guarded_until = now + life if life else math.inf
        self._recover()

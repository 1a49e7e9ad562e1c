"""The commissioner's connection to an executor: one trial at a time, and the end of it at any moment."""

from __future__ import annotations

import contextlib
import itertools
import socket
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from hyperbit.controller.program import (
    ALIVE_EVERY,
    MOST_BYTES,
    VERSION,
    Accepted,
    Acknowledge,
    Alive,
    Answer,
    Cancel,
    Declined,
    Down,
    Ended,
    Goodbye,
    Hello,
    Malformed,
    Reset,
    Snapshot,
    Stop,
    Trial,
    Up,
    Welcome,
    decode_up,
    encode,
)

T = TypeVar("T")

ANSWER_WITHIN = 5.0  # [s]
BEGIN_WITHIN = 2.0  # [s] after a key press; a later begin would surprise the person
ENDED_WITHIN = 10.0  # [s] for the end of a trial, beside the time for which it watches


class NoDriver(Exception):
    """The executor does not serve this commissioner, or is gone; the text says why."""


class Commissioner:
    """Drives an arm by trials. A thread receives and tells that this process is alive."""

    def __init__(self, path: Path, arm: str, digest: str) -> None:
        self._welcome: Welcome | None = None
        self.snapshot: Snapshot | None = None
        self._gone = ""
        self._heard: list[Up] = []
        self._changed = threading.Condition()
        self._program, self._requests = 0, itertools.count(1)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._socket.settimeout(ANSWER_WITHIN)
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise NoDriver(f"no executor answers at {path}: {error.strerror or error}") from None
        self._send(Hello(VERSION, "commissioner", arm))
        threading.Thread(target=self._receive, name="executor", daemon=True).start()
        try:
            welcome = self._wait(lambda: self._welcome, ANSWER_WITHIN, "the executor does not answer")
            if welcome.digest != digest:
                raise NoDriver("the executor was started with another version of the arm's file: restart it")
        except NoDriver:
            self.close()
            raise
        self._program = welcome.program

    @property
    def simulated(self) -> bool:
        return self._welcome is not None and self._welcome.simulation is not None

    def check(self) -> None:
        """Raises NoDriver if the executor is gone."""
        if self._gone:
            raise NoDriver(self._gone)

    def ready(self, timeout: float) -> Snapshot:
        """Waits until the arm is at rest, in fault or stopped; returns its state."""
        return self._wait(self._at_rest, timeout, "the arm does not come to rest")

    def is_ready(self, epoch: int) -> bool:
        """Returns whether the arm is ready, and nothing has changed its epoch."""
        return self.snapshot is not None and (self.snapshot.mode, self.snapshot.epoch) == ("ready", epoch)

    def reset(self) -> Answer:
        epoch = self._wait(lambda: self.snapshot, ANSWER_WITHIN, "the executor tells no state").epoch
        answer = self._request(lambda number: Reset(number, epoch))
        before = self.snapshot
        self._wait(lambda: self.snapshot if self.snapshot is not before else None, ANSWER_WITHIN, "no state comes")
        return answer

    def stop(self) -> Answer:
        """Stops the arm until a reset. For any thread."""
        return self._request(Stop)

    def cancel(self, reason: str = "left by the commissioner") -> Answer:
        """Ends a trial; the arm holds. For any thread."""
        return self._request(lambda number: Cancel(number, None, reason))

    def _request(self, make: Callable[[int], Down]) -> Answer:
        number = next(self._requests)
        self._send(make(number))
        mine = partial(self._of, Answer, lambda one: one.request == number)
        answer: Answer = self._wait(mine, ANSWER_WITHIN, "the executor does not answer")
        return answer

    def run(self, actuator: int, state: int, watch: float, epoch: int, until: float) -> Ended | str:
        """Tries one actuator; returns the result, or why nothing began.

        Args:
            epoch: of the state in which a person was asked: what has changed it since, as a stop, bars the trial.
            until: latest begin [s]. An interrupt cancels the trial.
        """
        self._program += 1
        number = self._program
        try:
            self._send(Trial(number, epoch, actuator, state, watch, until))
            begun: Accepted | Declined = self._wait(
                lambda: self._of(Accepted | Declined, lambda one: one.program == number), ANSWER_WITHIN, "no answer"
            )
            if isinstance(begun, Declined):
                return str(begun.refused.refusal)
            ended: Ended = self._wait(
                lambda: self._of(Ended, lambda one: one.program == number), watch + ENDED_WITHIN, "no result"
            )
        except BaseException:
            with contextlib.suppress(NoDriver):
                self._send(Cancel(next(self._requests), None, "left by the commissioner"))
            raise
        self._send(Acknowledge(ended.result))
        return ended

    def _at_rest(self) -> Snapshot | None:
        """Returns the state of an arm in which nothing runs and all travels are over; None before."""
        at = self.snapshot
        moves = at is None or at.mode in ("starting", "executing") or (at.mode == "ready" and at.moving)
        return None if moves or at is None or (at.mode == "ready" and at.free_at > time.monotonic()) else at

    def close(self) -> None:
        self._gone = self._gone or "closed"
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _of(self, kind: Any, fits: Callable[[Any], bool]) -> Any:
        return next((one for one in self._heard if isinstance(one, kind) and fits(one)), None)

    def _send(self, message: Down) -> None:
        try:
            self._socket.send(encode(message), socket.MSG_NOSIGNAL)
        except OSError as error:
            raise NoDriver(self._gone or f"the connection to the executor is broken: {error}") from None

    def _wait(self, find: Callable[[], T | None], timeout: float, why: str) -> T:
        until = time.monotonic() + timeout
        with self._changed:
            while (found := find()) is None:
                if self._gone:
                    raise NoDriver(self._gone)
                if (left := until - time.monotonic()) <= 0:
                    raise NoDriver(f"{why} within {timeout:g} s")
                self._changed.wait(left)
            return found

    def _receive(self) -> None:
        alive_at = 0.0
        self._socket.settimeout(ALIVE_EVERY / 2)
        while not self._gone:
            try:
                if time.monotonic() >= alive_at and self._welcome is not None:
                    alive_at = time.monotonic() + ALIVE_EVERY
                    self._send(Alive())
                data = self._socket.recv(MOST_BYTES + 1)
                message = decode_up(data) if data else Goodbye("the executor closed the connection")
            except TimeoutError:
                continue
            except (OSError, NoDriver, Malformed) as error:
                message = Goodbye(f"the connection to the executor is broken: {error}")
            with self._changed:
                match message:
                    case Goodbye():
                        self._gone = self._gone or message.reason
                    case Welcome():
                        self._welcome = message
                    case Snapshot():
                        self.snapshot = message
                    case Accepted() | Declined() | Ended() | Answer():
                        self._heard = [*self._heard[-20:], message]
                self._changed.notify_all()

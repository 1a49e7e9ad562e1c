"""Procedures with one board: sequences of SDO transfers, NMT commands and waits, driven by frames and time."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.sdo.client import SdoClient, SdoOutcome, Transfer
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command
from hyperbit.drivers.canopen.wire.link import Link, Outgoing

_ORDER_TIMEOUT = 1.0  # [s] until the command must have been sent


@dataclass(frozen=True, slots=True)
class Order:
    """An NMT command to the board; the step ends when its frame was sent."""

    command: Command


@dataclass(frozen=True, slots=True)
class Wait:
    """Waits for a condition, at most `timeout` [s]; checks it after each frame of the board and at each tick."""

    until: Callable[[], bool]
    timeout: float


@dataclass(frozen=True, slots=True)
class Ask:
    """A transfer that ends early if the condition becomes true."""

    transfer: Transfer
    unless: Callable[[], bool]


Step = Transfer | Ask | Order | Wait
Procedure = Generator[Step, SdoOutcome, None]

DONE = SdoOutcome(data=b"")


class BoardError(Exception):
    """A procedure cannot continue; `fault` says why."""

    def __init__(self, fault: ArmFault) -> None:
        super().__init__(fault.message)
        self.fault = fault


class Runner:
    """Runs one procedure at a time with one board."""

    def __init__(self, node: int, link: Link) -> None:
        self._node, self._link = node, link
        self._sdo = SdoClient(node, link)
        self._procedure: Procedure | None = None
        self._ended: Callable[[ArmFault | None, float], None] | None = None
        self._step: Step | None = None
        self._outgoing: Outgoing | None = None  # frame of an NMT command
        self._since = 0.0  # start of the step [s]
        self._yields = False

    @property
    def running(self) -> bool:
        return self._procedure is not None

    @property
    def busy(self) -> bool:
        """Whether a procedure runs that does not yield to another one."""
        return self.running and not self._yields

    @property
    def answered_twice(self) -> bool:
        """Whether two boards answer; see `SdoClient.twice`."""
        return self._sdo.twice

    def start(
        self,
        procedure: Procedure,
        ended: Callable[[ArmFault | None, float], None] | None,
        now: float,
        yields: bool = False,
    ) -> None:
        """Replaces the running procedure; `ended` takes the fault of the new one, or None, and the time."""
        self.cancel()
        self._procedure, self._ended, self._yields = procedure, ended, yields
        self._resume(None, now)

    def cancel(self) -> None:
        """Cancels the procedure; its `ended` is not called."""
        if self._procedure is not None:
            self._procedure.close()
        self._procedure = self._step = self._ended = None
        self._sdo.cancel()
        if self._outgoing is not None:
            self._outgoing.cancelled = True
            self._outgoing = None

    def receive_sdo(self, data: bytes, now: float) -> None:
        """Takes an SDO answer of 8 bytes. Call `check` afterwards."""
        self._sdo.receive_answer(data, now)

    def tick(self, now: float) -> None:
        """Call every period: handles timeouts."""
        if self._procedure is not None:
            self._sdo.tick(now)
            self.check(now)

    def check(self, now: float) -> None:
        """Continues if the step has ended. Call after each frame of the board."""
        if self._procedure is not None and (outcome := self._outcome(now)) is not None:
            self._resume(outcome, now)

    def _resume(self, outcome: SdoOutcome | None, now: float) -> None:
        """Continues until a step must wait."""
        procedure, fault = self._procedure, None
        assert procedure is not None
        try:
            while True:
                step = next(procedure) if outcome is None else procedure.send(outcome)
                self._begin(step, now)
                if (outcome := self._outcome(now)) is None:
                    return
        except StopIteration:
            pass
        except BoardError as error:
            fault = error.fault
        self._procedure = self._step = None
        ended, self._ended = self._ended, None
        if ended is not None:
            ended(fault, now)

    def _begin(self, step: Step, now: float) -> None:
        self._step, self._since = step, now
        if isinstance(step, Transfer):
            self._sdo.begin(step, now)
        elif isinstance(step, Ask):
            self._sdo.begin(step.transfer, now)
        elif isinstance(step, Order):
            self._outgoing = Outgoing(cia301.command(step.command, self._node))
            self._link.queue(self._outgoing, now)

    def _outcome(self, now: float) -> SdoOutcome | None:
        """Returns the outcome of the step; None while it runs."""
        step = self._step
        if isinstance(step, Transfer):
            return self._sdo.outcome
        if isinstance(step, Ask):
            if self._sdo.outcome is None and step.unless():
                self._sdo.cancel()
                return SdoOutcome(silence="cancelled")
            return self._sdo.outcome
        if isinstance(step, Wait):
            if step.until():
                return DONE
            return SdoOutcome(silence="timed out") if now - self._since >= step.timeout else None
        if self._outgoing is None or self._outgoing.sent:
            return DONE
        if now - self._since < _ORDER_TIMEOUT:
            return None
        self._outgoing.cancelled = True
        return SdoOutcome(silence="the bus takes no frames")

"""Statements on clients of the executor: whom it hears, and which locks and resets it carries out."""

from __future__ import annotations

import math

from hyperbit.controller.executor.core.events import ClientId, Event, FromClient
from hyperbit.controller.program import (
    VERSION,
    Answer,
    Goodbye,
    Hello,
    Lock,
    Reset,
    Stop,
    Up,
)
from tests.simulation.statements.account import Account
from tests.simulation.statements.statement import Statement

NOTICED = 0.1  # [s] until a reading is noticed


class OnlyTheWelcomeAct(Statement):
    """Only clients of this version are welcome; an operator may do no more than stop the arm."""

    number = 11

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._away: ClientId | None = None  # who must be sent away in this step

    def told(self, event: Event) -> None:
        account = self.account
        if self._away is not None:
            client, self._away = self._away, None
            self.require(False, f"{client} is not sent away")
        if not isinstance(event, FromClient):
            return
        known, message = event.client in account.roles, event.message
        if isinstance(message, Hello):
            welcome = not known and message.version == VERSION
        else:
            operator = account.roles.get(event.client) == "operator"
            welcome = known and (not operator or isinstance(message, Stop))
        self._away = None if welcome else event.client

    def killed(self) -> None:
        self._away = None

    def tells(self, client: ClientId, message: Up) -> None:
        self.armed += client == self._away
        if isinstance(message, Goodbye) and client == self._away:
            self._away = None


class LocksAndResetsAreSound(Statement):
    """A lock names the state that the end-stops read; a reset is of the present epoch, with all doors closed."""

    number = 11

    def tells(self, client: ClientId, message: Up) -> None:
        account, asked = self.account, self.account.message
        if not isinstance(message, Answer) or not message.accepted or client != account.planner:
            return
        if isinstance(asked, Lock) and asked.request == message.request and asked.state >= 0 and account.clear:
            k, pins = asked.actuator, account.pins.now
            still = account.now > account.pins.changed_at[k] + NOTICED and account.known >> k & 1
            if k < account.arm.count and account.arm.definite(pins.extended, pins.contracted) >> k & 1 and still:
                read = account.arm.measured(pins.extended, pins.contracted, 0) >> k & 1
                self.require(read == asked.state, f"actuator {k} is locked in {asked.state}, and reads {read}")
        elif isinstance(asked, Reset) and asked.request == message.request and "resetting" in message.message:
            self.require(asked.epoch >= account.epoch, f"a reset of epoch {asked.epoch} in epoch {account.epoch}")
            self.require(account.doors.known_at == math.inf, "a reset is carried out while a door is open")

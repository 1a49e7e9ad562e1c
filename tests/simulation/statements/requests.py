"""Statements on clients of the executor: whom it hears, and which locks and resets it carries out."""

from __future__ import annotations

import math

from hyperbit.controller.executor.core.events import ClientId, Event, FromClient
from hyperbit.controller.program import (
    VERSION,
    Accepted,
    Acknowledge,
    Alive,
    Answer,
    Cancel,
    Counts,
    Goodbye,
    Hello,
    Lock,
    PlayFault,
    Reset,
    Stop,
    Trial,
    Up,
)
from tests.simulation.statements.account import Account
from tests.simulation.statements.motions import Energised, Switch, Sync
from tests.simulation.statements.statement import Statement

NOTICED = 0.1  # [s] until a reading is noticed
TRYING = Trial, Cancel, Stop, Reset, PlayFault, Alive, Acknowledge, Counts
MAY: dict[str | None, tuple[type, ...]] = {"operator": (Stop,), "commissioner": TRYING}


class OnlyTheWelcomeAct(Statement):
    """Only the welcome act: of this version, and an operator may stop the arm, a commissioner may try actuators."""

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
            role = account.roles.get(event.client)
            welcome = known and (role not in MAY or isinstance(message, MAY[role]))
            welcome = welcome and (role != "planner" or not isinstance(message, Trial))
        self._away = None if welcome else event.client

    def killed(self) -> None:
        self._away = None

    def tells(self, client: ClientId, message: Up) -> None:
        self.armed += client == self._away
        if isinstance(message, Goodbye) and client in self.account.roles:
            self.require(client == self._away, f"{client} is sent away: {message.reason}")
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


class TrialsMoveOneActuator(Statement):
    """While an arm is commissioned, a SYNC moves what one trial names, once, to the state that it names."""

    number = 1

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._moved: dict[int, float] = {}  # time of the SYNC that moved the actuator of a trial, by number [s]

    def started(self) -> None:
        self._moved = {}

    def says(self, message: Up) -> None:
        account, trial = self.account, self.account.message
        if isinstance(message, Accepted) and isinstance(trial, Trial):
            fits = account.commissioned and trial.epoch >= account.epoch and account.now <= trial.until
            free = account.running is None and trial.program not in account.programs
            locked = account.locked >> trial.actuator & 1
            self.require(fits and free and not locked and account.mode == "ready", f"{trial} is accepted")
            self.require(account.doors.known_at == math.inf, f"{trial} is accepted beside an open door")

    def switches(self, switch: Switch) -> None:
        if switch.cause == "SYNC":
            self._judge(switch.mask, switch.sync, f"{switch.mask:b} switched to {switch.after:b}")

    def energises(self, coils: Energised) -> None:
        if coils.cause == "SYNC" and coils.came:
            self._judge(coils.came, coils.sync, f"coils of {coils.came:b} came on")

    def _judge(self, mask: int, sync: Sync | None, text: str) -> None:
        account = self.account
        asked = [] if sync is None else [motion for motion, _ in sync.asked]
        trials = [motion for motion in asked if motion.tried is not None]
        if not (trials or account.commissioned):
            return
        self.require(trials or not asked, f"{text} for {asked[0].number if asked else 0}, which is no trial")
        unsure = account.pins.missed | account.homing  # a board that missed a frame takes it with the next SYNC
        for trial in trials:
            self.require(not mask & ~(trial.tried or 0) & ~unsure, f"{text} in the trial {trial.number}")
            if sync is not None and mask & (trial.tried or 0) & ~account.pins.missed:
                self.require(self._moved.setdefault(trial.number, sync.at) == sync.at, f"{text} again")

"""Takes the messages between the executor and its clients, and hands each one to the parts of the judge."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperbit.controller.program import (
    Accepted,
    Acknowledge,
    Answer,
    Begun,
    Cancel,
    Clearance,
    Counted,
    Declined,
    Diagnostics,
    Ended,
    Program,
    Question,
    Replaced,
    Replacement,
    Setpoint,
    Settled,
    Snapshot,
    Stop,
    Welcome,
)
from hyperbit.controller.program import Counts as LedgerCounts
from tests.simulation.judge.clients import Client
from tests.simulation.judge.verdict import require

if TYPE_CHECKING:
    from tests.simulation.judge.judge import Judge


class Messages:
    """The messages of one executor and its clients."""

    def __init__(self, judge: Judge) -> None:
        self._judge = judge

    def loses(self, client: Client) -> None:
        judge = self._judge
        judge.close_step()
        judge.clients.loses(client.number)
        if client.planner:
            judge.silence.gone()
            judge.requests.loses_planner()
            judge.snapshots.epoch_causes += 1
            self.lose_planner()

    def lose_planner(self) -> None:
        """The planner is gone or silent: what it asked for ends."""
        judge = self._judge
        if not judge.account.quitting:
            judge.commands.hold()
        judge.reasons.holds("the planner is")
        judge.programs.end("planner", "aborted")
        judge.account.stream = None

    def hears(self, client: Client, message: object) -> None:
        judge = self._judge
        judge.close_step()
        judge.clients.hears(client.number, message)
        if not judge.clients.may_ask(client.number, message):
            return
        judge.requests.receive(client, message)
        if client.planner:
            judge.silence.hears()
        match message:
            case Program() | Replacement() if client.planner:
                judge.programs.receive(message)
            case Setpoint() if client.planner:
                judge.commands.receive(message)
                if judge.streams.receive(message):
                    judge.reasons.follows(message)
            case Clearance() if client.planner:
                run = judge.account.run
                if run is not None and run.question == message.question:
                    run.question, run.touched = None, message.touched is not None
                    run.held_at = judge.account.now
            case Acknowledge() if client.planner:
                judge.programs.unacknowledged.pop(message.result, None)
            case LedgerCounts() if client.planner:
                judge.counts.raised(message.counts)
            case Cancel() if client.planner:
                self._cancel(message)
            case Stop():
                judge.endings.interferes()
                judge.commands.hold()
                judge.snapshots.epoch_causes += 1
                judge.reasons.enters("a stop was requested")
                judge.programs.end("stop", "aborted")
                judge.account.stream = None

    def _cancel(self, message: Cancel) -> None:
        judge, run = self._judge, self._judge.account.run
        if message.program is None or (run is not None and message.program == run.number):
            judge.commands.hold()
        if message.program is None:
            judge.endings.interferes()
            judge.snapshots.epoch_causes += 1
            judge.reasons.holds("canceled", "following" if run is None else run.message.name)
            judge.account.stream = None
        if run is not None and message.program in (None, run.number):
            judge.reasons.holds("canceled", run.message.name)
            judge.programs.end("cancel", "canceled", message.reason or "canceled; the arm holds")

    def tells(self, message: object) -> None:
        judge = self._judge
        match message:
            case Welcome():
                judge.requests.welcome(message)
                judge.counts.told(message.counts)
            case Accepted():
                judge.programs.accepted(message)
                judge.commands.begins()
                judge.requests.answered()
            case Declined():
                judge.programs.declined(message)
                judge.requests.answered()
            case Replaced():
                judge.programs.replaced(message)
                judge.requests.answered()
            case Begun():
                judge.programs.begun(message)
            case Settled():
                judge.programs.settled(message)
            case Ended():
                judge.programs.ended(message, late=judge.requests.tells_again)
                counted = judge.requests.tells_again or judge.counts.counted_now
                require(counted, f"the counts are not told before {message}")
                judge.requests.result(message)
            case Question():
                judge.requests.question(message)
            case Answer():
                judge.requests.answer(message)
            case Counted(counts):
                judge.counts.counted(counts)
            case Diagnostics():
                judge.counts.diagnosed(message)
            case Snapshot():
                self._shows(message)

    def _shows(self, message: Snapshot) -> None:
        judge, last = self._judge, self._judge.account.shown
        judge.log.shows(last, message)
        judge.streams.shown(message)
        judge.snapshots.show(message)
        judge.reasons.shows(last, message)
        judge.pulses.shows(message)
        judge.commands.shows(message)
        if message.mode not in ("ready", "executing"):
            judge.programs.end("fault", "aborted")
            judge.account.stream = None

"""Statements on programs: which run, how each ends, and what a result means."""

from __future__ import annotations

import math

from hyperbit.controller.executor.core.events import Event, ExecutorTick, FromClient
from hyperbit.controller.program import (
    TICK,
    Accepted,
    Acknowledge,
    Clearance,
    Declined,
    Ended,
    Program,
    Question,
    Replaced,
    Settled,
    Up,
    Welcome,
    unpack,
)
from hyperbit.drivers.canopen.wire.events import FrameReceived
from tests.simulation.statements.account import Account
from tests.simulation.statements.arm import bits_of, merged
from tests.simulation.statements.motions import EPSILON, Energised, Motion, Switch
from tests.simulation.statements.statement import Statement

NOTICED = 0.1  # [s] until a silence is noticed
PROMPT = 0.1  # [s] in which nothing stands in the way of a stage or mark, until it begins or settles
UNFED = 10.0  # [s] for which a program waits for its next stages


class AcceptedProgramsFit(Statement):
    """An accepted program begins where the pins are, in the present epoch, in time, and fits the arm."""

    number = 2

    def says(self, message: Up) -> None:
        account, program = self.account, self.account.message
        if not isinstance(message, Accepted) or not isinstance(program, Program):
            return
        text = f"program {program.program} is accepted"
        self.require(program.epoch >= account.epoch, f"{text} of epoch {program.epoch} in epoch {account.epoch}")
        self.require(account.now <= program.until + EPSILON, f"{text}, too late by {account.now - program.until:g} s")
        self.require(program.program not in account.programs, f"{text} again")
        unsure = account.pins.missed | account.homing | account.locked | account.pins.fallen
        differ = account.pins.elsewhere(unpack(program.start)) & ~unsure
        self.require(not differ, f"{text} from other states of {differ:b}")
        before, earliest = unpack(program.start), -math.inf
        for stage in program.stages:
            states = unpack(stage.states)
            most, locked = (states ^ before).bit_count() <= account.arm.most, (states ^ before) & account.locked
            self.require(most and not locked and stage.at >= earliest, f"{text}, and does not fit the arm")
            before, earliest = states, stage.at


class ValidProgramsRun(Statement):
    """In calm, programs that fit are not declined one after another, strict or not."""

    number = 11

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._declined = {True: 0, False: 0}

    def says(self, message: Up) -> None:
        account, program = self.account, self.account.message
        if not isinstance(program, Program) or not isinstance(message, Accepted | Declined):
            return
        strict, accepted = program.strict, isinstance(message, Accepted)
        correct = account.world.daemon is None and account.world.planner.calm and account.clear
        if accepted or (correct and account.mode == "ready"):
            count = self._declined[strict] = 0 if accepted else self._declined[strict] + 1
            self.require(count < 4, f"{count} programs in a row are declined, strict: {strict}: {message}")


class OneResultEach(Statement):
    """Each accepted program has exactly one result; a new planner gets those that no planner has acknowledged."""

    number = 3

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._again: set[int] = set()  # results that the new planner must get in this step
        self._acknowledged: set[int] = set()

    def started(self) -> None:
        self._again, self._acknowledged = set(), set()

    def told(self, event: Event) -> None:
        self._judge_again()
        match event:
            case FromClient(client, Acknowledge(result)) if client == self.account.planner:
                self._acknowledged.add(result)

    def killed(self) -> None:
        self._again = set()
        if self.account.ordered_end and self.account.planner is not None:  # else nobody hears of a result
            for number, motion in self.account.programs.items():
                self.require(motion.ended is not None, f"program {number} has no result at the end of the executor")

    def says(self, message: Up) -> None:
        account = self.account
        if isinstance(message, Welcome) and account.greets_planner:
            self._again = set(account.owed)
        elif isinstance(message, Ended):
            self._again.discard(message.result)
            self.require(message.program in account.programs, f"{message} of no accepted program")
            before = account.programs[message.program].ended
            self.require(before is None or before == message, f"{before} and {message} end one program")
            self.require(message.result not in self._acknowledged, f"{message} is acknowledged, and comes again")

    def rests(self) -> None:
        for number, motion in self.account.programs.items():
            self.require(motion.ended is not None, f"program {number} has no result")

    def _judge_again(self) -> None:
        if self._again:
            again, self._again = self._again, set()
            self.require(False, f"the new planner does not get the results {again}")


class DoneIsProven(Statement):
    """A settled mark, and `done`: the pins are its states; each switch was measured, or read back since."""

    number = 4

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._channels = account.world.arm.wiring.channels
        self._objects = {(n.bus, n.node): n.object for n in account.world.arm.wiring.nodes}
        self._unread = 0  # mask of the switched actuators whose outputs nobody has read since
        self._moved = 0  # mask of the actuators that were switched since the acceptance

    def started(self) -> None:
        self._unread = self._moved = 0

    def switches(self, switch: Switch) -> None:
        if switch.cause == "SYNC":
            self._unread |= switch.mask
            self._moved |= switch.mask

    def energises(self, coils: Energised) -> None:
        if coils.cause == "SYNC":
            self._unread |= coils.came
            self._moved |= coils.came

    def told(self, event: Event) -> None:
        if not self._unread or not isinstance(event, FrameReceived) or event.frame.id & 0x780 != 0x580:
            return
        data, node = event.frame.data, event.frame.id & 0x7F
        if len(data) != 8 or data[0] & 0xE3 != 0x43:
            return
        if int.from_bytes(data[1:3], "little") == self._objects.get((event.bus, node), 0x6200):
            self._read(event.bus, node, data[3], data[4])

    def _read(self, bus: str, node: int, sub: int, byte: int) -> None:
        """Takes a byte of outputs that was read back."""
        for k in bits_of(self._unread):
            channel, state = self._channels[k], self.account.pins.now.states >> k & 1
            second = channel.output_off is not None and not state
            bit, name = (channel.output_off, "output_off") if second else (channel.output, "output")
            on = (state if channel.output_off is None else 1) != (name in channel.inverted)
            if (channel.bus, channel.node, 1 + bit // 8) == (bus, node, sub) and byte >> bit % 8 & 1 == on:
                self._unread &= ~(1 << k)

    def says(self, message: Up) -> None:
        account, arm = self.account, self.account.arm
        if isinstance(message, Accepted):
            self._moved = 0
        done = isinstance(message, Ended) and message.status == "done" and message.result not in account.owed
        if not (isinstance(message, Settled) or done) or (motion := account.programs.get(message.program)) is None:
            return
        unread = self._unread & self._moved & ~arm.sensed & ~arm.forgone
        self.require(not unread, f"{type(message).__name__}, and nobody has read back the outputs of {unread:b}")
        if done and motion.stages:
            self.require(motion.final, f"program {message.program} is done, and further stages may come")
            unsure = account.pins.missed | account.pins.fallen | account.locked | account.homing
            wrong = account.pins.elsewhere(motion.stages[-1].states) & ~unsure
            self.require(not wrong, f"program {message.program} is done, and {wrong:b} are not where it wants them")
            if account.clear:
                unknown = account.homing & ~account.locked & motion.homes
                self.require(not unknown, f"program {message.program} is done, and has not homed {unknown:b}")
        if isinstance(message, Ended):
            told = message.verified or (self._moved | account.pins.missed) & arm.forgone
            self.require(told, f"program {message.program} is not verified, {self._moved:b} have moved")


class StrictStagesWait(Statement):
    """A stage of a strict program begins when nothing moves, and after the answer to an open question.

    A question is void once the arm is no longer where it begins.
    """

    number = 14

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._question: Question | None = None
        self._asked_at = 0.0

    def started(self) -> None:
        self._question = None

    def says(self, message: Up) -> None:
        if isinstance(message, Question):
            self._question, self._asked_at = message, self.account.now
        elif isinstance(message, Accepted | Ended) or (isinstance(message, Replaced) and message.accepted):
            self._question = None

    def told(self, event: Event) -> None:
        if isinstance(event, FromClient) and isinstance(event.message, Clearance):
            asked, answer = self._question, event.message
            mine = asked is not None and event.client == self.account.planner and answer.question == asked.question
            if mine and answer.touched is None:
                self._question = None

    def switches(self, switch: Switch) -> None:
        account, sync = self.account, switch.sync
        if switch.cause != "SYNC" or sync is None or sync.program is None:
            return
        motion, mask = account.programs.get(sync.program), switch.mask & ~account.locked & ~account.homing
        if not mask or motion is None or not sync.strict:
            return
        if self._void():
            self._question = None
        answered = self._question is None or sync.commanded_at < self._asked_at
        self.require(answered, lambda: f"{mask:b} switch while {self._question} is open")
        if not account.clear:
            return
        travels = [
            k
            for k in range(account.arm.count)
            if account.pins.switched_at[k] < sync.commanded_at < account.pins.due(k) - TICK
            and not account.pins.arrived >> k & 1
        ]
        self.require(not travels, f"a strict stage switches {mask:b} while {travels} travel")

    def _void(self) -> bool:
        pins, asked = self.account.pins.now, self._question
        if asked is None:
            return False
        read, stage = self.account.arm.measured(pins.extended, pins.contracted, pins.states), unpack(asked.stage)
        return merged(read ^ stage, read, pins.states) != unpack(asked.start)


class StagesBeginInTime(Statement):
    """In calm a stage begins, a mark settles, and a program ends as soon as nothing stands in its way."""

    number = 10

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._since: dict[str, float] = {}
        self._begin = 0.0  # earliest zero of the program's times: what is homed before its first stage delays them all

    def steps(self) -> None:
        account, motion = self.account, self.account.running
        rests = (
            motion is not None
            and motion.barred_at == math.inf
            and account.clear
            and not account.homing
            and not account.questioned
        )
        if rests:
            arm, shown = account.arm, account.shown
            quiet = max(account.pins.due(k) + arm.margin[k] for k in range(arm.count)) + arm.rest
            rests = shown is not None and not shown.moving and not unpack(shown.unread)
            rests = rests and account.now > max(quiet, shown.free_at + arm.rest)
        if not rests and (motion is None or motion.taken < 0):
            self._begin = account.now
        due, settles, ends = self._open(motion) if rests and motion is not None else (False, False, False)
        self._wait("its next stage does not begin", due, PROMPT)
        self._wait("its mark does not settle", settles, PROMPT)
        self._wait("it does not end", ends, UNFED + PROMPT)

    def _open(self, motion: Motion) -> tuple[bool, bool, bool]:
        passed, following = self.account.now - max(motion.begin, self._begin), motion.taken + 1
        settles = motion.unsettled and passed >= motion.stages[motion.taken].settled
        if following < len(motion.stages):
            at = motion.stages[following].at
            return passed >= at, settles and passed < at - PROMPT, False
        return False, settles, not motion.unsettled

    def _wait(self, text: str, waits: bool, longest: float) -> None:
        if not waits:
            self._since.pop(text, None)
            return
        since = self._since.setdefault(text, self.account.now)
        running = self.account.running
        number = -1 if running is None else running.number
        self.require(self.account.now - since <= longest, f"program {number}: {text}, for {longest:g} s")


class NothingRunsWithoutItsPlanner(Statement):
    """Nothing runs after the planner has been silent for longer than its time-out."""

    number = 2

    def __init__(self, account: Account) -> None:
        super().__init__(account)
        self._silence, self._ticked = 0.0, 0.0

    def told(self, event: Event) -> None:
        account = self.account
        if isinstance(event, FromClient) and event.client == account.planner:
            self._silence = 0.0
        elif isinstance(event, ExecutorTick):
            self._silence += min(account.now - self._ticked, 2 * TICK)
            self._ticked = account.now
            if account.planner is None or account.running is None:
                self._silence = 0.0
            else:
                longest = account.world.arm.planner_timeout + NOTICED
                self.require(self._silence <= longest, f"a program runs, the planner is silent for {longest:g} s")

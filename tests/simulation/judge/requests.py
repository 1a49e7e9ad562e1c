"""Requests: each one is answered once, in time, as the contract says, and in the order of arrival."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperbit.controller.program import (
    Alive,
    Answer,
    Cancel,
    Ended,
    Hello,
    Lock,
    Program,
    Question,
    Replacement,
    Reset,
    Setpoint,
    Stop,
    Welcome,
    unpack,
)
from tests.simulation.judge.account import Account, Commit
from tests.simulation.judge.arm import bits_of, mask_of, merged
from tests.simulation.judge.programs import Programs
from tests.simulation.judge.reasons import HELD, Reasons
from tests.simulation.judge.silence import Silence
from tests.simulation.judge.snapshots import SEEN_WITHIN, Snapshots
from tests.simulation.judge.verdict import require
from tests.simulation.judge.waits import READ_BACK, TICK

if TYPE_CHECKING:
    from tests.simulation.judge.clients import Client


class Waiting:
    """A stop or cancel that was heard and not answered."""

    def __init__(self, message: Stop | Cancel, at: float, running: bool, leaves: Commit | None) -> None:
        self.message, self.at, self.running = message, at, running
        self.leaves = leaves  # the commit of which a SYNC was handed out, and was not heard to have left
        self.buses: set[str] = set() if leaves is None else set(leaves.awaited)  # with such a SYNC


class Requests:
    """Judges the answers of one executor.

    Attributes:
        asked: number of its questions to the planner.
    """

    def __init__(
        self, account: Account, programs: Programs, snapshots: Snapshots, silence: Silence, reasons: Reasons
    ) -> None:
        self._a, self._programs, self._snapshots, self._silence = account, programs, snapshots, silence
        self._reasons = reasons
        self.asked = 0
        self.begin()

    def begin(self) -> None:
        self._due: object = None  # the message that must be answered in this step
        self._again: set[int] | None = None  # results that the new planner must get in this step
        self._held: list[Waiting] = []
        self._lock_moving = False  # an actuator may be moving at the request
        self._lock_moves = 0  # mask of the actuators that move then, as the executor knows
        self._question = 0
        self._way: tuple[bytes, bytes] | None = None  # of the open question of a stream that goes on

    def receive(self, client: Client, message: object) -> None:
        a = self._a
        self._due = None
        followed = isinstance(message, Setpoint) and a.stream is not None and message.stages
        if not (isinstance(message, Alive) or (followed and message.start == a.stream.message.start)):  # type: ignore
            self._way = None
        if isinstance(message, Hello):
            self._due = message
        elif isinstance(message, Stop) or (isinstance(message, Cancel) and client.planner):
            if isinstance(message, Cancel) and message.program is not None:
                self._due = message if a.run is None or a.run.number != message.program else None
            if self._due is None and client.planner:
                contracts = a.quitting and a.arm.contracts_at_end and a.mode == "executing"
                running = a.run is not None or a.stream is not None or contracts
                leaves = a.commit if a.commit is not None and a.commit.awaited else None
                self._held.append(Waiting(message, a.now, running, leaves))
        elif client.planner and isinstance(message, Program | Replacement | Reset | Lock):
            self._due = message
            self._lock_moving = not a.ground.surely_at_rest(a.now, SEEN_WITHIN + TICK)
            self._lock_moves = a.ground.surely_moving(a.now) & a.ground.switched_since(a.ready_at)

    def answered(self) -> None:
        """Records the answer of a program or a replacement."""
        self._due = None

    def close_step(self) -> None:
        """Requires that what must be answered at once was answered."""
        due, self._due = self._due, None
        require(due is None, f"{due} was not answered at once")
        again, self._again = self._again, None
        require(not again, f"results {again} were not told to the new planner")

    def welcome(self, message: Welcome) -> None:
        self._due = None
        a = self._a
        require(message.instance == a.instance, f"instance {message.instance} is told, it is {a.instance}")
        if a.clear:
            require(message.program == a.greatest, f"number {message.program} is told, the greatest is {a.greatest}")

    @property
    def tells_again(self) -> bool:
        """Whether a new planner gets results in this step."""
        return self._again is not None

    def new_planner(self) -> None:
        """Requires that a new planner gets all results that were not acknowledged."""
        self._again = set(self._programs.unacknowledged)
        self._silence.connected = True
        self._silence.hears()
        self._due = None

    def loses_planner(self) -> None:
        """The planner is gone: nobody hears the answers that are due to it."""
        self._held.clear()

    def result(self, message: Ended) -> None:
        """Records a result that was told."""
        if self._again is not None:
            self._again.discard(message.result)

    def question(self, message: Question) -> None:
        """Judges a question about the next stage of a strict program."""
        a, run = self._a, self._a.run
        self.asked += 1
        require(message.question > self._question, f"question {message.question} comes after {self._question}")
        self._question = message.question
        way = message.start, message.stage
        require(way != self._way, f"{message} asks again, and the last question has no answer")
        self._way = None if a.stream is None else way
        if run is None:
            require(a.stream is not None or not a.clear, f"{message}, and nothing runs")
            return
        run.question = message.question
        if not a.clear or run.homes:
            return
        require(run.strict, f"{message} of program {run.number}, which is not strict")
        following = run.taken + 1
        require(following < len(run.stages), f"{message}, and program {run.number} has no further stage")
        stage = run.stages[following].states
        require(unpack(message.stage) == stage, f"{message}, the next stage is {stage:b}")
        require(unpack(message.start) not in (run.state(run.taken), stage), f"{message} is of a planned stage")

    def answer(self, message: Answer) -> None:
        """Judges the answer to a reset, lock, stop or cancel."""
        a, due = self._a, self._due
        if isinstance(due, Reset | Lock | Cancel) and due.request == message.request:
            self._due = None
            if isinstance(due, Reset):
                self._judge_reset(due, message)
            elif isinstance(due, Lock):
                self._judge_lock(due, message)
            else:
                require(not a.clear or "not running" in message.message, f"{due} is answered by {message}")
            return
        held = next((held for held in self._held if held.message.request == message.request), None)
        if held is None:
            return  # to an operator, or to a request of the process before
        self._held.remove(held)
        require(message.refused is None, f"{held.message} is refused: {message}")
        if not a.clear:
            return
        self._judge_under_way(held, message)
        if isinstance(held.message, Stop):
            require("stopped" in message.message and "until reset" in message.message, f"a stop is told as {message}")
        elif held.running or (isinstance(held.message, Cancel) and held.message.program is not None):
            require(message.message.startswith("canceled"), f"{held.message} is answered by {message}")
        else:
            require("no goal" in message.message, f"{held.message} is answered by {message}, and nothing ran")

    def _judge_under_way(self, held: Waiting, message: Answer) -> None:
        """Judges how many switches the answer to a stop or cancel tells: those of a SYNC that was handed out."""
        leaves, count = held.leaves, 0
        if leaves is not None:
            if leaves.homing or leaves.open:
                return
            here = mask_of(k for k, bus in enumerate(self._a.arm.bus_of) if bus in held.buses)
            count = (leaves.switched & here).bit_count()
        words = "1 switch was under way" if count == 1 else f"{count} switches were under way" if count else ""
        right = words in message.message if count else "under way" not in message.message
        require(right, f"{held.message} is answered by {message}; {count} switches were under way")

    def ends(self) -> None:
        """The process has ended in order: each stop and cancel has its answer."""
        require(
            not self._held, f"the executor has ended in order, and has not answered {[vars(h) for h in self._held]}"
        )

    def _judge_reset(self, asked: Reset, message: Answer) -> None:
        a, mode = self._a, self._a.mode
        if message.refused is None and message.message.startswith("resetting"):
            self._snapshots.epoch_causes += 1
            require(not a.clear or mode in ("fault", "stopped"), f"the arm is reset in mode {mode}")
            shown = 0 if a.shown is None else a.shown.epoch
            require(asked.epoch >= shown, f"a reset of epoch {asked.epoch} is carried out in epoch {shown}")
        elif message.refused is not None and message.refused.reason.value == "overtaken":
            self._snapshots.expect_changed(asked.epoch, f"{asked} is refused as overtaken")
        else:
            if a.clear and mode in ("fault", "stopped"):
                self._snapshots.expect_mode(("starting", "ready", "executing"), f"a reset is answered by {message}")

    def _judge_lock(self, asked: Lock, message: Answer) -> None:
        a = self._a
        bit = 1 << asked.actuator
        if message.refused is None:
            self._snapshots.epoch_causes += 1
            self._snapshots.locks_asked += 1
            a.asked_states = merged(bit, -1 if asked.state > 0 else 0, a.asked_states)
            if a.mode == "ready":
                self._reasons.enters(HELD)
        if not a.clear:
            return
        reading = a.ground.readings[-1]
        tells = a.arm.definite(reading.extended, reading.contracted) & bit
        level = a.arm.measured(reading.extended, reading.contracted, 0) >> asked.actuator & 1
        reasons = set[str]()
        if asked.actuator >= a.arm.count:
            reasons.add("no-such-actuator")
        over = a.commit is not None and a.commit.given_up and not a.commit.awaited  # its SYNC may not follow any more
        if a.mode == "executing" or (a.committing and not over) or self._lock_moves:
            reasons.add("lock-while-moving")
        elif asked.state >= 0 and tells and level != asked.state and not self._lock_moving and a.mode == "ready":
            reasons.add("end-stop-contradicts")
        if message.refused is None:
            unlocks = asked.state < 0 and reasons == {"lock-while-moving"}  # a boot may have ended the motion
            require(not reasons or unlocks, f"{asked} is carried out, but {sorted(reasons)}")
            self._expect_lock(asked)
            return
        reason = message.refused.reason.value
        recent = self._lock_moving or (a.commit is not None and a.now < a.commit.at + READ_BACK)
        if recent or a.now < a.adopted_until + 2 * TICK:
            reasons |= {"lock-while-moving", "end-stop-contradicts"}
        require(reason in reasons or a.mode not in ("ready", "executing"), f"{asked} is refused as {reason}")

    def _expect_lock(self, asked: Lock) -> None:
        a = self._a
        bit = 1 << asked.actuator
        expected = a.locked | bit if asked.state >= 0 else a.locked & ~bit

        def holds(snapshot: object) -> None:
            told = unpack(snapshot.locked)  # type: ignore[attr-defined]
            require(told == expected or not a.clear, f"after {asked} locked are {bits_of(told)}")

        self._snapshots.claims.append(holds)

    def tick(self) -> None:
        """Finds stops and cancels without an answer."""
        a = self._a
        if a.stream is None or a.now > a.stream.until or a.mode != "executing":
            self._way = None
        longest = a.arm.timing.heartbeat_timeout / 2 + 2 * TICK
        for held in self._held:
            if a.clear and held.at >= a.clear_since:
                require(a.now - held.at <= longest, f"{held.message} has no answer after {a.now - held.at:g} s")

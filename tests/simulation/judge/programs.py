"""Programs: accepted exactly if the contract allows it, begun when due, settled and ended once, with true numbers."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.controller.program import (
    Accepted,
    Begun,
    Declined,
    Ended,
    Program,
    Replaced,
    Replacement,
    Settled,
    unpack,
)
from tests.simulation.judge.acceptance import MODE_REASONS, misfits, must_decline
from tests.simulation.judge.account import EPSILON, Account, Run
from tests.simulation.judge.owed import WORDS, Ending
from tests.simulation.judge.proofs import Proofs
from tests.simulation.judge.reasons import Reasons
from tests.simulation.judge.silence import Silence
from tests.simulation.judge.snapshots import Snapshots
from tests.simulation.judge.travels import Travels
from tests.simulation.judge.verdict import require
from tests.simulation.judge.waits import PROMPT, READ_BACK, STARVES_AFTER, TICK, Waits, best_stage

ENDED_WITHIN = 1.0 + PROMPT  # [s] from its cause to a result: the running commit ends first, and is read back


class Programs:
    """Judges the programs of one executor.

    Attributes:
        count: takes the mask of the actuators that a SYNC has switched.
        switches_for: program for which the last RPDOs were handed out.
    """

    def __init__(
        self,
        account: Account,
        snapshots: Snapshots,
        silence: Silence,
        travels: Travels,
        reasons: Reasons,
        proofs: Proofs,
    ) -> None:
        self._proofs = proofs
        self._a, self._snapshots, self._silence = account, snapshots, silence
        self._travels, self._reasons = travels, reasons
        self.count: Callable[[int], None] = lambda mask: None
        self.waits = Waits(account)
        self.begin()

    def begin(self) -> None:
        self._message: Program | Replacement | None = None
        self._endings: dict[int, Ending] = {}
        self.unacknowledged: dict[int, Ended] = {}
        self.switches_for: Run | None = None
        self.waits.begin()

    def receive(self, message: Program | Replacement) -> None:
        """Records a request that must be answered in this step."""
        self._message = message

    def declined(self, message: Declined) -> None:
        asked, self._message = self._message, None
        require(isinstance(asked, Program) and asked.program == message.program, f"{message} was not asked for")
        assert isinstance(asked, Program)
        a, reason = self._a, str(message.refused.reason.value)
        if not a.clear:
            return
        may = must_decline(self._a, asked)
        if a.commit is not None and a.now < a.commit.at + READ_BACK:
            may.add("switch-not-confirmed")  # nobody outside sees whether the boards were read back
        if reason in may:
            return
        changed = {*MODE_REASONS.values(), "overtaken"}
        require(reason in changed, f"program {asked.program} is declined as {reason}; what holds is {sorted(may)}")
        self._snapshots.expect_changed(asked.epoch, f"program {asked.program} is declined as {reason}")

    def accepted(self, message: Accepted) -> None:
        """Judges an acceptance, and begins the account of the program."""
        asked, self._message, a = self._message, None, self._a
        require(isinstance(asked, Program) and asked.program == message.program, f"{message} was not asked for")
        assert isinstance(asked, Program)
        self._silence.accepted(asked)
        lasting = misfits(a, asked.stages, asked.start, -1e12)
        require(not lasting, f"program {asked.program} is accepted, but {sorted(lasting)}")
        require(asked.program > a.program_number, f"program {asked.program} is accepted after {a.program_number}")
        if a.clear:
            reasons = must_decline(self._a, asked)
            require(not reasons, f"program {asked.program} is accepted, but {sorted(reasons)}")
        begin = asked.begin or a.now
        require(abs(message.begin - begin) < EPSILON, f"program {asked.program} begins at {message.begin:g}")
        self.end("replaced", "replaced")
        a.run = Run(asked, message, a.locked, a.locked_states, a.homing)
        a.run.held_at = a.run.taken_at = a.run.accepted_at = a.now
        a.run.delayed = bool(a.run.homes) or a.now < a.homed_at + READ_BACK
        a.stream = None
        a.program_number = asked.program
        a.greatest = max(a.greatest, asked.program)

    def replaced(self, message: Replaced) -> None:
        asked, self._message, a = self._message, None, self._a
        require(isinstance(asked, Replacement), f"{message} was not asked for")
        assert isinstance(asked, Replacement)
        require((message.program, message.generation) == (asked.program, asked.generation), f"{message} is of another")
        run = a.run if a.run is not None and a.run.number == asked.program else None
        if a.clear:
            fits = run is not None and self._may_replace(run, asked)
            commit = a.commit
            begun = run is not None and commit is not None and commit.at >= run.taken_at
            begun = begun and a.now < commit.at + READ_BACK and asked.first == run.taken + 1  # type: ignore[union-attr]
            require(message.accepted == fits or (fits and begun), f"{asked} is answered by {message.accepted}")
        if message.accepted and run is not None:
            run.replace(asked, a.now)
            run.generation = asked.generation
            run.held_at = a.now
            run.question = None
            if asked.stages:
                self.waits.unfed = 0.0

    def _may_replace(self, run: Run, asked: Replacement) -> bool:
        a = self._a
        if asked.generation <= run.generation or not run.begun < asked.first <= len(run.stages):
            return False
        earliest = run.stages[asked.first - 1].at if asked.first else -1e12
        if misfits(a, asked.stages, asked.start, earliest):
            return False
        return run.aligned(unpack(asked.start)) == run.state(asked.first - 1)

    def begun(self, message: Begun) -> None:
        a, run = self._a, self._a.run
        require(run is not None and run.number == message.program, f"{message}, but this program does not run")
        assert run is not None
        k = message.stage
        require(run.taken < k < len(run.stages), f"stage {k} of program {run.number} comes after {run.taken}")
        commit = a.mover if a.mover is not None and a.mover.at >= run.taken_at else None
        if commit is not None and not commit.switched & ~commit.locked:
            commit = None  # it has set locked actuators to their states, before any stage
        at, before = (a.now, a.believed) if commit is None else (commit.at, commit.before)
        states = run.stages[k].states
        if a.clear and not run.delayed:
            self._judge_begun(run, k, at, before)
        if commit is not None and run.strict_from <= at:
            text = f"stage {k} of program {run.number} is strict"
            require(not commit.unread, f"{text}, and began before {commit.unread:b} were read back")
        if a.clear:
            self._judge_switches(run, message.switches, f"stage {k} of program {run.number}")
        skipped = range(run.taken + 1, k)
        if run.taken >= 0 and run.stages[run.taken].mark >= 0:
            run.counted, run.planned = 0, True
        as_planned = before == run.state(run.taken) and all(run.stages[i].states == before for i in skipped)
        run.planned = run.planned and as_planned
        run.counted += before != states
        if run.delayed and run.taken < 0:
            run.begins_by = max(run.begin, a.now)
        run.taken, run.taken_at, run.begun = k, a.now, max(k, run.begun)
        run.held_at = a.now
        if run.stages[k].mark >= 0:
            run.mark, run.open_mark = run.stages[k].mark, True
        else:
            run.open_mark = False
        run.question, self.waits.unfed_since = None, None

    def _judge_begun(self, run: Run, k: int, at: float, before: int) -> None:
        a, stage = self._a, run.stages[k]
        text = f"stage {k} of program {run.number}"
        early = run.begin + stage.at - at
        require(early <= EPSILON, f"{text} began {early:g} s early")
        away = (a.ground.states ^ stage.states) & ~a.homing
        require(not away, f"{text} is told as begun, and the boards drive {a.ground.states:b}, not {stage.states:b}")
        following, best = run.taken + 1, best_stage(a.arm, run, at, before)
        if run.strict_from <= at:
            require(k == following, f"{text} is strict and comes after {run.taken}")
        due = run.begin + stage.at <= at + EPSILON
        require(k == following or due, f"{text} skips stages, and is not due")
        surely = best == following or best > k  # times that are equal but for rounding decide nothing
        require(not (surely and k < best), f"{text} began although stage {best} was due at {at:.6f}")

    def settled(self, message: Settled) -> None:
        a, run = self._a, self._a.run
        require(run is not None and run.number == message.program, f"{message}, but this program does not run")
        assert run is not None
        text = f"mark {message.mark} of program {run.number}"
        require(run.open_mark and run.mark == message.mark, f"{text} is told after stage {run.taken}")
        run.open_mark, run.settled, run.held_at = False, run.taken, a.now
        if not a.clear:
            return
        early = run.begin + run.stages[run.taken].settled - a.now
        require(early <= EPSILON or run.delayed, f"{text} settled {early:g} s early")
        moving = a.ground.surely_moving(a.now)
        require(not moving, f"{text} settled while {moving:b} travel")
        self._snapshots.judge_states(message.measured, message.known, text)
        self._judge_switches(run, message.switches, text)
        if not run.homes:
            require(message.stages == run.counted, f"{text} tells {message.stages} stages, {run.counted} switched")
            require(message.planned == run.planned, f"{text} tells planned as {message.planned}")

    def _judge_switches(self, run: Run, told: int, text: str) -> None:
        require(told == run.switches, f"{text} tells {told} switches, the bus had {run.switches}")

    def switched(self, mask: int) -> None:
        if self.switches_for is not None:
            self.switches_for.switches += mask.bit_count()
        self.count(mask)

    def end(self, cause: str, status: str, words: str = "") -> None:
        """Records that something ends the running program; its result is owed from now on."""
        a, run = self._a, self._a.run
        a.run = None
        if run is not None:
            ending = self._endings.setdefault(run.number, Ending(run, a.now))
            ending.causes[cause] = status
            ending.words[cause] = words

    def ended(self, message: Ended, late: bool) -> None:
        """Judges a result; `late`: it has waited for the planner."""
        a = self._a
        if (known := self.unacknowledged.get(message.result)) is not None:
            require(known == message, f"result {message.result} is told again, and differs")
            return
        self.unacknowledged[message.result] = message
        ending = self._endings.pop(message.program, None)
        run = a.run if a.run is not None and a.run.number == message.program else None
        if ending is not None:
            run, causes, sayings, ended_at = ending.run, ending.causes, ending.words, ending.at
        elif run is not None:
            causes, sayings, ended_at = self._own_end(run), {"done": "all stages have settled"}, a.now
            if isinstance(self._message, Program):  # its acceptance follows
                causes["replaced"] = "replaced"
                sayings["replaced"] = f"replaced by {self._message.name}"
            elif "planner" in causes:
                self._reasons.enters("the planner is" if message.status == "aborted" else "")
            else:
                self._reasons.enters(run.message.name, "done" if message.status == "done" else "")
            a.run = None
        else:
            require(False, f"{message} is of no running program")
            return
        text = f"result {message.result} of program {run.number}"
        if message.status == "done":
            self._proofs.done(run, message.verified, text)
        require(message.context == run.message.context, f"{text} has another context")
        require(message.mark == run.mark, f"{text} tells mark {message.mark}, not {run.mark}")
        early = WORDS["starved"] in message.message and self.waits.unfed < STARVES_AFTER - 2 * TICK
        require(not early, f"{text} says {message.message!r} after {self.waits.unfed:g} s")
        if not a.clear:
            return
        fits = [cause for cause, status in causes.items() if status == message.status]
        require(fits, f"{text} is {message.status}: {message.message}; causes are {causes}")
        words = [WORDS[cause] for cause in fits if cause in WORDS]
        told = len(words) < len(fits) or any(word in message.message for word in words)
        require(told, f"{text} says {message.message!r}; causes are {causes}")
        right = any(sayings.get(cause, "") in ("", message.message) for cause in fits)
        require(right, f"{text} says {message.message!r}; {sayings} are due")
        if message.status == "done":
            moving = a.ground.surely_moving(a.now)
            require(not moving, f"{text} is done while {moving:b} travel")
        self._snapshots.judge_states(message.measured, message.known, text, ended_at if late else None)
        self._judge_switches(run, message.switches, text)
        self._travels.ended(run, ended_at, message.travels, text)

    def _own_end(self, run: Run) -> dict[str, str]:
        """Returns the causes for which a program may end by itself now."""
        a, causes = self._a, dict[str, str]()
        done = run.final and run.taken == len(run.stages) - 1 and not run.open_mark
        if done:
            causes["done"] = "done"
        if run.touched:
            causes["touched"] = "aborted"
        following = run.taken + 1
        if following < len(run.stages):
            away = run.stages[following].states ^ a.ground.states
            if away.bit_count() > a.arm.most:
                causes["far"] = "aborted"
        if self.waits.unfed_since is not None and a.now - self.waits.unfed_since > STARVES_AFTER - PROMPT:
            causes["starved"] = "aborted"
        if self._silence.due:
            causes["planner"] = "aborted"
        return causes

    def ends(self) -> None:
        """The process has ended in order: each program has its result."""
        without = [*self._endings, *([] if self._a.run is None else [self._a.run.number])]
        require(not without, f"the executor has ended in order, and programs {without} have no result")

    def tick(self) -> None:
        """Finds stages, marks and results that do not come although nothing keeps them."""
        a = self._a
        for number, ending in self._endings.items():
            if a.clear and a.clear_since <= ending.at:
                require(a.now - ending.at < ENDED_WITHIN, f"program {number} has no result {ending.causes}")
        if a.run is not None:
            self.waits.tick(a.run)

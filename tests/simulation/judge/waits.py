"""Waits: what may keep the next stage, mark or result of a running program from coming."""

from __future__ import annotations

from tests.simulation.judge.account import EPSILON, Account, Run
from tests.simulation.judge.arm import JudgedArm
from tests.simulation.judge.verdict import require

TICK = 0.01  # [s], period of the executor's loop
PROMPT = 6 * TICK  # [s] from the moment at which nothing stands in its way to a stage, mark or result
READ_BACK = 1.0  # [s] within which boards without end-stops are read back after a switch, see the drivers' page
SETTLED_WITHIN = 3.0  # [s], longest time in which the last stage of a program settles, or is a fault
STARVES_AFTER = 10.0  # [s] without further stages, after which a program is aborted


def best_stage(arm: JudgedArm, run: Run, at: float, before: int) -> int:
    """Returns the stage that is to begin: the last one that is due and near enough, else the next one."""
    return max(best_stages(arm, run, at, before, run.begin))


def best_stages(arm: JudgedArm, run: Run, at: float, before: int, latest: float) -> set[int]:
    """Returns the stages that may be to begin: one for each zero of time from that of the program to a latest one."""
    following = run.taken + 1
    if run.strict_from <= at:
        return {following}
    near = [i for i in range(following, len(run.stages)) if (run.stages[i].states ^ before).bit_count() <= arm.most]
    surely, perhaps = ([i for i in near if zero + run.stages[i].at <= at - EPSILON] for zero in (latest, run.begin))
    return {max(surely, default=following), *(i for i in perhaps if i not in surely)}


class Waits:
    """Judges the waits of the running program.

    Attributes:
        unfed_since: time since when it waits for further stages [s]; None if it does not.
        unfed: awake time without further stages [s].
    """

    def __init__(self, account: Account) -> None:
        self._a = account
        self.begin()

    def begin(self) -> None:
        self.unfed_since: float | None = None
        self.unfed, self._ticked = 0.0, self._a.now

    def tick(self, run: Run) -> None:
        """Finds stages, marks and results that do not come although nothing keeps them."""
        a = self._a
        idle = run.taken == len(run.stages) - 1 and not run.final and not run.open_mark
        self.unfed_since = (self.unfed_since or a.now) if idle else None
        self._judge_starving(run)
        if not a.clear or self._kept(run):
            run.held_at = a.now
            return
        late = a.now - run.held_at
        require(late <= PROMPT, f"program {run.number}: nothing keeps stage {run.taken + 1}, its mark or its end")

    def _judge_starving(self, run: Run) -> None:
        """Finds a program that waits for stages for ever; a stall of the executor is no delay of the planner."""
        a = self._a
        passed, self._ticked = min(a.now - self._ticked, 2 * TICK), a.now
        starves = run.taken == len(run.stages) - 1 and not run.final
        self.unfed = self.unfed + passed if starves else 0.0
        settles = max(map(max, a.arm.travel)) + max(a.arm.margin) + PROMPT if a.clear and not run.open_mark else None
        longest = STARVES_AFTER + (SETTLED_WITHIN if settles is None else settles)
        require(self.unfed < longest, f"program {run.number} waits for stages for {self.unfed:g} s")

    def _kept(self, run: Run) -> bool:
        """Returns whether something keeps the next stage, mark or result of a program from coming."""
        a, now = self._a, self._a.now
        ground, mover = a.ground, a.mover
        if a.mode != "executing" or run.question is not None:
            return True
        if a.committing or (mover is not None and mover.at >= run.taken_at and now < mover.at + READ_BACK):
            return True
        if now < a.adopted_until or not ground.surely_at_rest(now, 2 * TICK):
            if run.delayed and run.taken < 0:
                run.begins_by = max(run.begins_by, now)
            return True
        following = run.taken + 1
        if run.taken < 0 and (run.delayed or (a.locked and ground.states != run.start)):
            return now < run.taken_at + READ_BACK
        if following < len(run.stages):
            stage = run.stages[following]
            if now < run.begins_by + stage.at:
                return not run.open_mark or now < run.begins_by + run.stages[run.taken].settled
            rests = sum(1 << k for k in range(a.arm.count) if now < ground.due(k) + a.arm.rest)
            best = best_stages(a.arm, run, now, ground.states, run.begins_by)
            return any((ground.states ^ run.stages[i].states) & rests for i in best)
        if run.open_mark:
            return now < run.begins_by + run.stages[run.taken].settled
        return not run.final

"""Programs as the executor gets them: of which request, from where, among what, when, and until when."""

from __future__ import annotations

import math

from hyperbit.controller.program import Program, Stage, unpack
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.asked import patience, wanted
from tests.simulation.judge.interface.facts import Request
from tests.simulation.judge.interface.modules import Cube
from tests.simulation.judge.interface.tasks import start_of
from tests.simulation.judge.verdict import require

EXACT = 1e-6  # [s]
EPOCHS = ("stop", "cancel", "reset", "degrade")
MADE_WITHIN = 0.01  # [s] from the making of a program to the executor


class Offers:
    """Judges programs."""

    def __init__(self, account: InterfaceAccount) -> None:
        self._a = account

    def gets(self, program: Program) -> None:
        a = self._a
        kind, _, goal = program.name.partition(" ")
        text = f"the program of {program.name}"
        require(kind in ("goal", "jog"), f"{text} has another name")
        mine = [r for r in a.requests if r.key == kind and r.at <= a.now and (r.goal == goal or r.goal is None)]
        if not mine and a.had("planner ended", a.now - 30.0):
            return  # of an earlier process
        require(mine, f"{text}, for which nobody asked")
        self._judge_until(program, mine, text)
        self._judge_start(program, text)
        self._judge_epoch(program, [r for r in mine if abs(program.until - r.at - patience(r)) < EXACT], text)
        self._judge_clear(program, text)
        if kind == "jog":
            self._judge_jog(program, mine, text)
        else:
            require(unpack(program.homed) == 0, f"{text} homes {program.homed.hex()}")
            named = [r for r in mine if r.goal == goal]
            if len(named) == 1:
                self._judge_times(program, named[0], text)
                self._judge_places(program, named[0], text)

    def _judge_until(self, program: Program, mine: list[Request], text: str) -> None:
        a = self._a
        ends = [r.at + patience(r) for r in mine]
        stood = a.had("still", a.now - 20.0) and any(program.until <= end + EXACT for end in ends)
        known = any(abs(program.until - end) < EXACT for end in ends)
        require(known or stood, f"{text} may begin until {program.until}, its request until {ends}")

    def _judge_start(self, program: Program, text: str) -> None:
        a = self._a
        calm = a.clear() and not a.slow and not a.lately("still", 0.5)
        snapshots = [h.snapshot for h in a.truths(0.02) if h.snapshot is not None]
        if not calm or not snapshots:
            return
        require(any(program.start == s.outputs for s in snapshots), f"{text} starts from {program.start.hex()}")
        epochs = {s.epoch for s in snapshots}
        require(program.epoch in epochs or a.had("epoch", a.now - 0.2), f"{text} has epoch {program.epoch}: {epochs}")
        among = {bool(cubes) for cubes in a.in_force()} | {program.strict for _ in range(a.had("cubes", a.now - 0.1))}
        unknown = {False} if program.name.startswith("jog") and not self._sure(snapshots) else set[bool]()
        require(program.strict in among | unknown, f"{text} is strict: {program.strict}; obstacles: {among}")
        locked, start = unpack(snapshots[0].locked), unpack(program.start)
        moved = [stage.states.hex() for stage in program.stages if (unpack(stage.states) ^ start) & locked]
        require(not moved or len({s.locked for s in snapshots}) > 1, f"{text} switches locked actuators: {moved}")

    def _judge_epoch(self, program: Program, mine: list[Request], text: str) -> None:
        """The epoch is that of the request's arrival, so that a fault or a stop after it bars it."""
        a = self._a
        if len(mine) != 1 or a.slow or a.had("still", mine[0].at - 5.0):
            return
        at = mine[0].at
        changing = any(r.key in EPOCHS and r.at <= at and r.answered_at > at - 0.3 for r in a.requests)
        before = [h for h in a.heard if h.at <= at]
        if before and before[-1].snapshot is None:  # the epoch of the next executor
            later = [h.snapshot.epoch for h in a.heard if h.at > at and h.snapshot is not None]
            require(program.epoch in later[:1] or changing, f"{text} has epoch {program.epoch}, not {later[:1]}")
            return
        near = [h for h in a.heard if abs(h.at - at) < 0.1 or h.at <= at]
        epochs = {h.snapshot.epoch for h in near[-8:] if h.snapshot is not None and h.at > at - 0.2}
        if len(epochs) == 1 and not changing:
            (epoch,) = epochs
            require(program.epoch == epoch, f"{text} has epoch {program.epoch}; it was {epoch} when it was asked for")

    def _judge_clear(self, program: Program, text: str) -> None:
        """No stage touches an obstacle that was surely in force as it was sent, from where the outputs have the arm."""
        a, made = self._a, self._a.made.get(program.program)
        snapshot, cubes = (None, set[Cube]()) if made is None else (made.snapshot, made.cubes)
        if snapshot is None or not self._sure([snapshot]):
            return
        locked, before = unpack(snapshot.locked), unpack(start_of(snapshot, len(a.modules.labels))[1])
        for stage in program.stages if cubes else ():
            after = unpack(stage.states) & ~locked | before & locked
            touched = [cube for cube in cubes if cube.touched(before, after)]
            require(not touched, f"{text} goes from {before:b} to {after:b}, which touches {touched}")
            before = after

    def _sure(self, snapshots: list[object]) -> bool:
        """Returns whether the planner knows the configuration of the arm."""
        everything = (1 << len(self._a.modules.labels)) - 1
        return all(
            unpack(s.known) == everything and not unpack(s.homing) and unpack(s.measured) in self._a.modules.tips  # type: ignore[attr-defined]
            for s in snapshots
        )

    def _judge_jog(self, program: Program, mine: list[Request], text: str) -> None:
        labels = self._a.modules.labels
        homed = unpack(program.homed)
        masks = [
            sum(1 << labels.index(label) for label in r.body["actuators"] if label in labels)
            for r in mine
            if isinstance(r.body.get("actuators"), dict)
        ]
        require(homed in masks, f"{text} homes {homed:b}, asked for are {masks}")
        require(program.begin == 0.0, f"{text} begins at {program.begin}")
        marks = [stage.mark for stage in program.stages]
        require(marks == [-1] * (len(marks) - 1) + [0], f"{text} has the marks {marks}")

    def _judge_times(self, program: Program, request: Request, text: str) -> None:
        """Compares begin and waypoints with the times of the request, shifted by the time of the first stages."""
        a, body = self._a, request.body
        times = [float(waypoint.get("t", 0.0)) for waypoint in body["waypoints"]]
        stamp = float(body.get("stamp") or 0.0)
        settled = [(stage.mark, stage.settled) for stage in program.stages if stage.mark >= 0]
        lined = bool(body.get("path_tolerance"))
        require(lined or all(mark < len(times) for mark, _ in settled), f"{text} has the marks {settled}, of {times}")
        if stamp:
            begin = stamp - (a.wall() - a.now)
            require(abs(program.begin - begin) < EXACT or a.had("clock", a.now - 5.0), f"{text} begins at {begin}")
        else:
            require(program.begin == 0.0, f"{text} begins at {program.begin}")
        if lined or not settled:
            return
        delays = [at - times[mark] for mark, at in settled]
        require(max(delays) - min(delays) < EXACT, f"{text} shifts its waypoints by {delays}")
        require(delays[0] >= -EXACT and (not stamp or delays[0] < EXACT), f"{text} comes {delays[0]:g} s later")
        count = next(k for k, stage in enumerate(program.stages) if stage.mark >= 0) + 1
        waits = max(self._ready(program) - a.now, 0.0)
        wanted_delay = 0.0 if stamp else max(count * a.lead + waits - times[0], 0.0)
        calm = a.clear() and not a.slow and not a.lately("still", 0.5) and not a.had("link", a.now - 5.0)
        made = a.made.get(program.program)
        calm &= made is None or made.snapshot is None or made.snapshot.outputs == program.start  # else: an older one
        exact = abs(delays[0] - wanted_delay) < MADE_WITHIN or not calm
        require(exact, f"{text} is {delays[0]:g} s late, not {wanted_delay:g} s")
        self._judge_stages(program.stages, text)

    def _ready(self, program: Program) -> float:
        """Returns when the first stage may begin: the one before has ended, and its actuators have rested [s]."""
        a, made = self._a, self._a.made.get(program.program)
        if made is None or made.snapshot is None:
            return -math.inf
        snapshot, switched_at = made.snapshot, made.switched_at
        commanded = unpack(start_of(snapshot, len(a.modules.labels))[1])
        differ = (commanded ^ unpack(program.stages[0].states)) & ~unpack(snapshot.locked)
        ready = -math.inf
        if differ and (a.inrush or program.strict):
            ready = max(switched_at) + a.travel
        if differ and a.rest > 0:
            mine = [at for k, at in enumerate(switched_at) if differ >> k & 1]
            ready = max(ready, max(mine) + a.travel + a.rest)
        return ready

    def _judge_stages(self, stages: tuple[Stage, ...], text: str) -> None:
        """Stages to a waypoint begin one lead apart, the last one a lead before it, and none before an earlier one."""
        lead, ends, group = self._a.lead, -1e12, list[Stage]()
        for stage in stages:
            group.append(stage)
            if stage.mark < 0:
                continue
            for j, other in enumerate(group):
                at = max(stage.settled - lead * (len(group) - j), ends)
                require(abs(other.at - at) < EXACT, f"{text} begins a stage at {other.at:g}, not {at:g}")
            ends, group = group[-1].at, []

    def _judge_places(self, program: Program, request: Request, text: str) -> None:
        """Each waypoint is a configuration that serves it, unless the search erred."""
        a = self._a
        if a.had("search errs", a.now - 10.0) or a.building:
            return
        known_bias, stages = a.bias, program.stages
        sets = wanted(a, request) if not request.body.get("path_tolerance") else []
        locked = 0 if a.snapshot is None else unpack(a.snapshot.locked)
        held = 0 if a.snapshot is None else unpack(a.snapshot.measured) & locked
        for stage in stages:
            if 0 <= stage.mark < len(sets) and not (known_bias and math.hypot(*known_bias)):
                code = unpack(stage.states) & ~locked | held
                require(code in sets[stage.mark], f"{text} brings the arm to {code:b} at waypoint {stage.mark}")

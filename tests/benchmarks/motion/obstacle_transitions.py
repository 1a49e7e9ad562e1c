"""Transitions among obstacles: python -m tests.benchmarks.motion.obstacle_transitions [--busy] [--only NAME]

Arms of different kinds go from goal to goal, each the tip of a random collision-free configuration. Obstacles are drawn
anew for every 20 goals. An independent model in plain NumPy (tests.obstacles.moving) executes each planned transition
several times: the actuators of a stage begin and end in any order, and at random moments all modules are sampled along
their lines. Some goals are also planned without obstacles, from the same configurations.

On small arms, exhaustive search over configurations and orders of single actuators tells which goals can be reached.
With --busy times and deadlines are those of the thread on its processor.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from hyperbit.controller.manipulator.frames import spatial
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.motion.plans.point_by_point import PointByPoint
from hyperbit.controller.motion.plans.transitions import TransitionPlanner
from hyperbit.controller.motion.stages.pacing import Pace
from hyperbit.controller.motion.trajectory import through
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from hyperbit.controller.search.method import Method
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration
from tests.benchmarks.harness import CommandLine, joined, show, write_figures
from tests.manipulator.test_platform import hexapod as joints
from tests.obstacles.dense import Box, Disc, Shape, obstacles_of
from tests.obstacles.moving import Part, arm, hexapod, hinge, motion, pair, room, truss

LEAD, RADIUS = 0.06, 0.02
EACH = 20  # goals among the same regions
MOTIONS, SAMPLES, POINTS = 3, 5, 20  # of a stage, of a motion, along a line
NEAR = 0.03  # room that is looked at more closely
COMPARED = 5  # one in so many is planned without regions, too

TRUSS = [truss("BC", 0.2, 0.2, 0.25), truss("AD", 0.2, 0.2, 0.25)]
BENDS = [
    pair(spatial((0, 0, 0.2), (x, y, 0, 1)), spatial((0, 0, 0.2), (-x, -y, 0, 1))) for x, y in ((0.2, 0), (0, 0.2))
]


@dataclass(frozen=True, eq=False)
class Run:
    name: str
    parts: Sequence[Part]
    tolerance: float
    method: Method
    inrush: int | None
    share: float  # of all transitions
    pairs: bool = False


RUNS = [
    Run("planar16", TRUSS * 8, 0.002, "minimum-switch", None, 0.03),
    Run("planar16-inrush", TRUSS * 8, 0.002, "minimum-switch", 4, 0.03),
    Run("planar16-ipop", TRUSS * 8, 0.005, "ipop-fewest-switches", None, 0.03),
    Run("planar6", TRUSS * 3, 0.01, "minimum-switch", None, 0.3),
    Run("planar6-inrush", TRUSS * 3, 0.01, "minimum-switch", 3, 0.25),
    Run("planar6-self", TRUSS * 3, 0.01, "ipop-fewest-switches", None, 0.1, True),
    Run("hinges12", [hinge(-0.4, 0.4, 0.15)] * 12, 0.01, "minimum-switch", None, 0.03),
    Run("platform4", [hexapod(*joints(), 0.18, 0.22)] * 4, 0.01, "minimum-switch", None, 0.03),
    Run("spatial12", BENDS * 6, 0.03, "minimum-switch", 3, 0.2),
]


@dataclass
class Tally:
    goals: int = 0
    transitions: int = 0
    barred: int = 0  # a configuration was found, but no way there
    switches: int = 0
    stages: int = 0
    staged: int = 0  # that took more stages than without regions
    violations: int = 0
    least: float = np.inf  # room beyond what is asked for
    among: list[float] = field(default_factory=list)
    alone: list[float] = field(default_factory=list)


def scene(manipulator: Manipulator, rng: np.random.Generator) -> list[Shape]:
    tips = manipulator.tips(rng.integers(0, manipulator.states, (4, len(manipulator.states))))
    size, length = manipulator.dimension, manipulator.length
    middles = tips[:, :size, 3] * rng.uniform(0.5, 1.1, (4, 1))
    found: list[Shape] = [Disc(tuple(m), length * rng.uniform(0.02, 0.07)) for m in middles[:2]]
    for tip, middle in zip(tips[2:], middles[2:], strict=True):
        tip[:size, 3] = middle
        found.append(Box(tip, tuple(length * rng.uniform(0.03, 0.14, size))))
    return found


def measured(run: Run, count: int, minutes: float) -> Tally:
    manipulator, rng, tally = arm(run.parts), np.random.default_rng(1), Tally()
    solver = Solver(manipulator, map_densities(manipulator, manipulator.length / 200, 20_000))
    pace, size = Pace(LEAD, run.inrush), manipulator.dimension
    until = time.monotonic() + 60 * minutes
    while tally.transitions < count and time.monotonic() < until:
        around = scene(manipulator, rng)
        clearance = BodyClearance(manipulator, obstacles_of(around), RADIUS, self_collision=run.pairs)
        drawn = rng.integers(0, manipulator.states, (100 * EACH, len(manipulator.states)))
        chosen = drawn[~clearance.blocked(drawn)][: EACH + 1]
        if len(chosen) <= EACH:
            continue
        own, previous, barred = solver.avoiding(clearance), chosen[0], tally.barred
        for goal in manipulator.tips(chosen[1:])[:, :size, 3]:
            if tally.barred >= barred + 2:  # it may be shut in: on among others
                break
            tally.goals += 1
            trajectory = through(np.zeros(1), goal[None], run.tolerance)
            began = time.thread_time()
            try:
                found = PointByPoint(TransitionPlanner(own, trajectory, pace), run.method).plan(previous)
            except Refusal as refusal:
                tally.barred += refusal.reason is Reason.NO_CLEAR_PATH
                continue
            if tally.goals % COMPARED == 0:
                tally.among.append(time.thread_time() - began)
                began = time.thread_time()
                PointByPoint(TransitionPlanner(solver.avoiding(None), trajectory, pace), run.method).plan(previous)
                tally.alone.append(time.thread_time() - began)
            before, stages = manipulator.actuator_states(previous), found.transitions[0].stages
            previous = found.solutions[0].configuration
            if found.switches == 0:
                continue
            tally.transitions += 1
            tally.switches += found.switches
            tally.stages += len(stages)
            tally.staged += len(stages) > (1 if run.inrush is None else -(-found.switches // run.inrush))
            rows = [before, *stages]
            displacements = np.concatenate(
                [motion(rng, a, b, SAMPLES) for a, b in pairwise(rows) for _ in range(MOTIONS)]
            )
            displacements = np.concatenate([displacements, stages])
            away, apart = room(run.parts, np.eye(4), around, displacements, POINTS, run.pairs)
            least = min(away - RADIUS, apart - 2 * RADIUS)
            tally.violations += least < 0
            tally.least = min(tally.least, least)
    return tally


def edges(parts: Sequence[Part], around: list[Shape], codes: np.ndarray) -> np.ndarray:
    """Which single actuators switch clear of all from each of all actuator states (2^A, A), shape (2^A, A)."""
    clear = np.zeros(codes.shape, dtype=bool)

    def least(code: np.ndarray, a: int, displacements: int, points: int) -> float:
        sampled = np.tile(code.astype(float), (displacements, 1))
        sampled[:, a] = np.linspace(0, 1, displacements)
        return room(parts, np.eye(4), around, sampled, points, False)[0] - RADIUS

    for n, code in enumerate(codes):
        for a in np.flatnonzero(code == 0):
            away = least(code, a, 9, 10)
            if 0 < away < NEAR:
                away = least(code, a, 129, 300)
            clear[n, a] = clear[n | 1 << a, a] = away > 0
    return clear


def compared_with_all_orders(name: str, parts: Sequence[Part], scenes: int, each: int, tolerance: float) -> list[str]:
    """Counts what is found of goals to which there is a way, by trying all configurations and orders."""
    manipulator, rng = arm(parts), np.random.default_rng(2)
    solver, every = Solver(manipulator, map_densities(manipulator, 0.02, 20_000)), every_configuration(manipulator)
    count = len(manipulator.actuators)
    codes = np.arange(1 << count)[:, None] >> np.arange(count) & 1
    tips = np.array([manipulator.tip(manipulator.configuration(code))[: manipulator.dimension, 3] for code in codes])
    asked = solvable = roundabout = found = wrong = 0
    for _ in range(scenes):
        around = scene(manipulator, rng)
        clearance = BodyClearance(manipulator, obstacles_of(around), RADIUS)
        free, own = every[~clearance.blocked(every)], solver.avoiding(clearance)
        if len(free) == 0:
            continue
        clear, previous = edges(parts, around, codes), free[rng.integers(len(free))]
        for goal in manipulator.tips(free[rng.integers(0, len(free), each)])[:, : manipulator.dimension, 3]:
            start = int(manipulator.actuator_states(previous) @ (1 << np.arange(count)))
            near = np.linalg.norm(tips - goal, axis=1) <= tolerance * (1 - 1e-9)
            once, ever = reached(clear, start), linked(clear, start)
            asked += 1
            solvable += (ways := bool((near & once).any()))
            roundabout += bool((near & ever).any())
            try:
                planned = PointByPoint(
                    TransitionPlanner(own, through(np.zeros(1), goal[None], tolerance), Pace(LEAD)), "minimum-switch"
                ).plan(previous)
            except Refusal:
                continue
            found += ways
            wrong += not ways
            previous = planned.solutions[0].configuration
    return [name, str(asked), str(solvable), f"{found} ({found / max(solvable, 1):.1%})", str(wrong), str(roundabout)]


def reached(clear: np.ndarray, start: int) -> np.ndarray:
    """Which actuator states (2^A,) are reached from some, each actuator switching once at most."""
    size, count = clear.shape
    found = np.zeros(size, dtype=bool)
    found[start] = True
    for mask in range(1, size):  # of those that have switched
        for a in range(count):
            before = start ^ mask ^ 1 << a
            if mask >> a & 1 and found[before] and clear[before, a]:
                found[start ^ mask] = True
                break
    return found


def linked(clear: np.ndarray, start: int) -> np.ndarray:
    """Which actuator states (2^A,) are reached from some, actuators switching to and fro."""
    found, waiting = np.zeros(len(clear), dtype=bool), [start]
    found[start] = True
    while waiting:
        here = waiting.pop()
        for a in np.flatnonzero(clear[here]):
            if not found[here ^ 1 << a]:
                found[here ^ 1 << a] = True
                waiting.append(int(here ^ 1 << a))
    return found


def main() -> None:
    options = {"count": 10_000, "scenes": 30, "minutes": np.inf, "only": ""}
    given, tallies, rows = CommandLine(__doc__, busy=True, **options).parse(), dict[str, Tally](), []
    for run in RUNS:
        if given.only in ("", run.name):
            t = tallies[run.name] = measured(run, round(given.count * run.share), given.minutes)
            means = (f"{t.switches / t.transitions:.2f}", f"{t.stages / t.transitions:.2f}")
            found = (f"{t.staged / t.transitions:.1%}", t.violations, f"{t.least:.5f}")
            times = (joined(t.among, "p50", "p99"), joined(t.alone, "p50", "p99"))
            rows.append((run.name, t.goals, t.transitions, t.barred, *means, *found, *times))
    headers = ("arm", "goals", "planned", "no way", "switches", "stages", "in more", "violations", "least room")
    headers += ("planning, median / 99 % [ms]", "without obstacles")
    show(f"{MOTIONS} motions of each stage, looked at {SAMPLES} times; bodies of radius {RADIUS:g}", headers, rows)
    small = {"trusses": TRUSS + TRUSS[:1], "hinges": [hinge(-0.6, 0.6, 0.2)] * 8}
    headers = ("arm", "goals", "solvable", "found", "found though not", "solvable to and fro")
    chosen = {name: parts for name, parts in small.items() if given.scenes and given.only in ("", name)}
    show(
        f"{given.scenes} scenes of each small arm, against every configuration and every order",
        headers,
        [compared_with_all_orders(name, parts, given.scenes, 10, 0.03) for name, parts in chosen.items()],
    )
    write_figures(given.json, tallies)


if __name__ == "__main__":
    main()

"""Searches among regions: what each method finds, and what it costs: python -m tests.benchmarks.search.obstacles

Goals are tips of random configurations that are clear of the regions, so that each can be reached; each is searched
from the configuration reached for the one before. The same goals, from the same configurations, are searched without
the regions in the same run. On an arm of 18 actuators random regions are drawn again and again, and what is found is
held to what trying every configuration finds. With --busy deadlines and times are those of the thread on its processor.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import load
from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import Obstacles, box, half_space, sphere, together
from hyperbit.controller.search.method import Method
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm
from tests.benchmarks.harness import PAPER_ARM, CommandLine, median_and_99, percentiles, show, write_figures
from tests.benchmarks.solving import WARM, ready_solver

METHODS: tuple[Method, ...] = ("minimum-switch", "ipop-fewest-switches", "pop")
RADIUS = 0.02
POSE = 0.005, 0.03  # tolerances of poses

# A pillar beside the arm, a beam over it, and a wall.
REGIONS = together(
    [
        sphere("disc 'pillar'", (0.55, 1.5), 0.2),
        box("box 'beam'", (-0.6, 2.6), (0.5, 0.2)),
        half_space("half-plane 'wall'", (-1.4, 0.0), (1.0, 0.1)),
    ]
)


@dataclass(frozen=True, eq=False)
class Trace:
    """Solutions, one for each goal, and the configurations that they were searched from."""

    before: list[Configuration]
    found: list[Solution]

    @property
    def within(self) -> float:
        return float(np.mean([f.within_tolerance for f in self.found]))

    @property
    def seconds(self) -> NDArray[np.float64]:
        return np.array([f.seconds for f in self.found])


def drawn(clearance: BodyClearance, number: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], float]:
    arm, found, tried = clearance.manipulator, list[NDArray[np.int64]](), 0
    while sum(map(len, found)) < number:
        some = rng.integers(0, arm.states, (number, len(arm.states)))
        found.append(some[~clearance.blocked(some)])
        tried += number
    every = np.concatenate(found)
    return every[:number], len(every) / tried


def traced(
    solver: Solver,
    method: Method,
    goals: NDArray[np.float64],
    tolerance: float,
    turn: float,
    before: list[Configuration],
) -> Trace:
    before = list(before)
    for goal in goals[:WARM]:
        solver.solve(solver.target(goal, tolerance, turn), before[0], method)
    found = list[Solution]()
    for k, goal in enumerate(goals):
        solution = solver.solve(solver.target(goal, tolerance, turn), before[k], method)
        if (
            solution.within_tolerance
            and solver.clearance is not None
            and solver.clearance.where(solution.configuration)
        ):
            raise AssertionError(f"{method}: {solver.clearance.where(solution.configuration)}")
        found.append(solution)
        if k + 1 == len(before):
            before.append(solution.configuration if solution.within_tolerance else before[k])
    return Trace(before[: len(goals)], found)


def measured(
    solver: Solver, clearance: BodyClearance, number: int, tolerance: float, turn: float
) -> dict[str, dict[str, float]]:
    arm = solver.manipulator
    chosen, share = drawn(clearance, number + 1, np.random.default_rng(1))
    tips, home = arm.tips(chosen[1:]), chosen[0]
    goals = tips if turn < math.inf else tips[:, : arm.dimension, 3]
    figures, rows = {}, []
    for method in METHODS:
        among = traced(solver.avoiding(clearance), method, goals, tolerance, turn, [home])
        plain = traced(solver.avoiding(None), method, goals, tolerance, turn, among.before)
        switches = (f"{np.mean([f.switches for f in t.found if f.within_tolerance]):.2f}" for t in (among, plain))
        proven = (
            f"{np.mean([f.certificate == 'optimal' for f in among.found]):.0%}" if method == "minimum-switch" else ""
        )
        ratio = float(np.median(among.seconds) / np.median(plain.seconds))
        times = median_and_99(among.seconds), f"{ratio:.2f}"
        rows.append((method, f"{among.within:.1%}", f"{plain.within:.1%}", *switches, proven, *times))
        figures[method] = {"within": among.within, "without regions": plain.within, "ratio of times": ratio}
        figures[method] |= percentiles(among.seconds)
    title = f"{number} goals, tolerance {tolerance:g}, {turn:.3g} rad; {share:.0%} of configurations are clear"
    headers = ("method", "within", "without", "switches", "without", "proven", "median / 99 % [ms]")
    show(title, (*headers, "time, ratio of medians"), rows)
    return figures


def scene(arm: Manipulator, rng: np.random.Generator) -> Obstacles:
    tips = arm.tips(rng.integers(0, arm.states, (2, len(arm.states))))[:, :2, 3] * rng.uniform(0.3, 1.1, (2, 1))
    turn = rng.uniform(-np.pi, np.pi)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    size = arm.length * rng.uniform(0.05, 0.3, 2)
    return together(
        [sphere("disc", tips[0], arm.length * rng.uniform(0.03, 0.12)), box("box", tips[1], size, rotation)]
    )


def held_to_brute_force(scenes: int, each: int, tolerance: float, turn: float) -> None:
    """Counts what is found of goals that can be reached, by trying all configurations of 18 actuators."""
    arm, rng = paper_arm(6), np.random.default_rng(2)
    solver, every = Solver(arm, map_densities(arm, 0.02, 20_000)), every_configuration(arm)
    tips = arm.tips(every)
    counts = {method: np.zeros(3, dtype=int) for method in METHODS}
    solvable = asked = 0
    for _ in range(scenes):
        clearance = BodyClearance(arm, scene(arm, rng), RADIUS, self_collision=True)
        own, previous = solver.avoiding(clearance), rng.integers(0, arm.states)
        for tip in arm.tips(rng.integers(0, arm.states, (each, len(arm.states)))):
            goal = tip if turn < math.inf else tip[:2, 3]
            there = np.linalg.norm(tips[:, :2, 3] - tip[:2, 3], axis=1) <= tolerance * (1 - 1e-9)
            near = every[there][[turn == math.inf or angle_between(t, tip) <= turn * (1 - 1e-9) for t in tips[there]]]
            clear = near[~clearance.blocked(near)]
            asked, solvable = asked + 1, solvable + (len(clear) > 0)
            fewest = min((arm.switches(c, previous) for c in clear), default=-1)
            for method, count in counts.items():
                found = own.solve(own.target(goal, tolerance, turn), previous, method)
                if found.within_tolerance and clearance.where(found.configuration):
                    raise AssertionError(f"{method}: {clearance.where(found.configuration)}")
                count += (
                    found.within_tolerance,
                    found.optimal is True,
                    found.optimal is True and found.switches != fewest,
                )
            previous = clear[0] if len(clear) else previous
    title = f"18 actuators, {scenes} times a disc and a box, tolerance {tolerance:g}, {turn:.3g} rad:"
    title += f" {solvable} of {asked} goals can be reached clear of them"
    rows = []
    for method, (within, optimal, wrong) in counts.items():
        proofs = (optimal, wrong) if method == "minimum-switch" else ("", "")
        rows.append((method, f"{within / solvable:.1%}", *proofs))
    show(title, ("method", "found", "proven", "proven wrongly"), rows)


def main() -> None:
    parser = CommandLine(__doc__, goals=500, busy=True)
    parser.add_argument("--scenes", type=int, default=100)
    given = parser.parse()
    held_to_brute_force(given.scenes, 5, 0.005, math.inf)
    held_to_brute_force(given.scenes, 5, *POSE)
    arm = load(PAPER_ARM)
    solver = ready_solver(arm)
    clearance = BodyClearance(arm.manipulator, REGIONS, RADIUS)
    positions = measured(solver, clearance, given.goals, arm.tolerance, math.inf)
    poses = measured(solver, clearance, max(given.goals // 5, 1), *POSE)
    write_figures(given.json, {"positions": positions, "poses": poses})


if __name__ == "__main__":
    main()

"""Searches among obstacles: what each method finds, and what it costs: python -m tests.benchmarks.search.obstacles

Goals are tips of random collision-free configurations, so that each can be reached. The same goals, from the same
configurations, are searched without obstacles in the same run. On an arm of 18 actuators random obstacles are drawn
again and again, and what is found is compared with trying every configuration. With --busy deadlines and times are
those of the thread on its processor.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import load
from hyperbit.controller.manipulator.frame_kernels import angle_between
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import Obstacles, box, half_space, sphere, together
from hyperbit.controller.search.solution import Solution
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import every_configuration, paper_arm
from tests.benchmarks.harness import PAPER_ARM, CommandLine, show, write_figures
from tests.benchmarks.solving import METHODS, POSE, by, compared, ready_solver, traced

RADIUS = 0.02
GOALS = 5  # in each scene
REGIONS = together(  # a pillar beside the arm, a beam over it, and a wall
    [
        sphere("disc 'pillar'", (0.55, 1.5), 0.2),
        box("box 'beam'", (-0.6, 2.6), (0.5, 0.2)),
        half_space("half-plane 'wall'", (-1.4, 0.0), (1.0, 0.1)),
    ]
)


def drawn(clearance: BodyClearance, number: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], float]:
    """Returns collision-free configurations (number, B), and the share of such."""
    arm, found, tried = clearance.manipulator, list[NDArray[np.int64]](), 0
    while sum(map(len, found)) < number:
        some = rng.integers(0, arm.states, (number, len(arm.states)))
        found.append(some[~clearance.blocked(some)])
        tried += number
    every = np.concatenate(found)
    return every[:number], len(every) / tried


def check_clear(clearance: BodyClearance, found: list[Solution]) -> None:
    for solution in found:
        if solution.within_tolerance and (where := clearance.where(solution.configuration)):
            raise AssertionError(f"a solution collides: {where}")


def measured(solver: Solver, number: int, tolerance: float, turn: float) -> dict[str, dict[str, float]]:
    arm, clearance = solver.manipulator, BodyClearance(solver.manipulator, REGIONS, RADIUS)
    chosen, share = drawn(clearance, number + 1, np.random.default_rng(1))
    tips, traces, among, alone = arm.tips(chosen[1:]), {}, solver.avoiding(clearance), solver.avoiding(None)
    goals = tips if turn < math.inf else tips[:, : arm.dimension, 3]
    for method in METHODS:
        trace = traces[method] = traced(by(among, method, tolerance, turn), goals, chosen[0])
        check_clear(clearance, trace.found)
        without = by(alone, method, tolerance, turn)
        traces[f"{method}, without obstacles"] = traced(without, goals, chosen[0], trace.before)
    title = f"{number} goals, tolerances {tolerance:g} and {turn:.3g} rad; {share:.0%} of configurations are clear"
    return compared(title, traces)


def scene(arm: Manipulator, rng: np.random.Generator) -> Obstacles:
    tips = arm.tips(rng.integers(0, arm.states, (2, len(arm.states))))[:, :2, 3] * rng.uniform(0.3, 1.1, (2, 1))
    turn = rng.uniform(-np.pi, np.pi)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    disc = sphere("disc", tips[0], arm.length * rng.uniform(0.03, 0.12))
    return together([disc, box("box", tips[1], arm.length * rng.uniform(0.05, 0.3, 2), rotation)])


def compared_with_all_configurations(scenes: int, tolerance: float, turn: float) -> None:
    arm, rng = paper_arm(6), np.random.default_rng(2)
    solver, every = Solver(arm, map_densities(arm, 0.02, 20_000)), every_configuration(arm)
    tips, counts = arm.tips(every), {method: np.zeros(3, dtype=int) for method in METHODS}
    solvable = 0
    for _ in range(scenes):
        clearance = BodyClearance(arm, scene(arm, rng), RADIUS, self_collision=True)
        own, previous = solver.avoiding(clearance), rng.integers(0, arm.states)
        for tip in arm.tips(rng.integers(0, arm.states, (GOALS, len(arm.states)))):
            there = np.linalg.norm(tips[:, :2, 3] - tip[:2, 3], axis=1) <= tolerance * (1 - 1e-9)
            near = every[there][[turn == math.inf or angle_between(t, tip) <= turn * (1 - 1e-9) for t in tips[there]]]
            clear = near[~clearance.blocked(near)]
            solvable += len(clear) > 0
            fewest = min((arm.switches(c, previous) for c in clear), default=-1)
            for method, count in counts.items():
                found = by(own, method, tolerance, turn)(tip if turn < math.inf else tip[:2, 3], previous)
                check_clear(clearance, [found])
                optimal = found.certificate == "optimal"
                count += (found.within_tolerance, optimal, optimal and found.switches != fewest)
            previous = clear[0] if len(clear) else previous
    title = f"18 actuators, {scenes} times a disc and a box, tolerances {tolerance:g} and {turn:.3g} rad"
    headers = (f"{solvable} of {scenes * GOALS} goals can be reached", "found", "proven", "proven wrongly")
    show(title, headers, [(method, *count) for method, count in counts.items()])


def main() -> None:
    given = CommandLine(__doc__, goals=500, busy=True, scenes=100).parse()
    compared_with_all_configurations(given.scenes, 0.005, math.inf)
    compared_with_all_configurations(given.scenes, *POSE)
    arm = load(PAPER_ARM)
    solver = ready_solver(arm)
    positions = measured(solver, given.goals, arm.tolerance, math.inf)
    poses = measured(solver, max(given.goals // 5, 1), *POSE)
    write_figures(given.json, {"positions": positions, "poses": poses})


if __name__ == "__main__":
    main()

"""What time saves: fixed deadlines, and searches that end by their gap: python -m tests.benchmarks.search.search_time

Three quarters of the goals are tips of random configurations of the paper's arm, one quarter are tips in sparse places.
Each is searched from the configuration that the last row reached for the goal before, so that no maps are prepared. All
rows search each goal one after the other, so that they share the load of the machine. Their certificates are compared.
"""

import numpy as np

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.settings import PlanningSettings
from hyperbit.controller.search.search_time import TIMEOUT, UNFOUND, SearchTime
from hyperbit.controller.search.solution import Solution
from tests.benchmarks.harness import PAPER_ARM, CommandLine, no_collection, write_figures
from tests.benchmarks.solving import (
    POSE,
    WARM,
    Trace,
    by,
    compared,
    home,
    random_frames,
    random_tips,
    ready_solver,
    sparse_tips,
)

ROWS = {
    "50 ms": SearchTime(TIMEOUT, most=TIMEOUT),
    "50 ms, 1 s without an answer": SearchTime(TIMEOUT, unfound=UNFOUND),
    "by the gap": SearchTime(TIMEOUT, PlanningSettings().seconds_per_switch, UNFOUND),
}


def agree(found: list[Solution]) -> None:
    """Checks that no lower bound exceeds a cost that another search has found."""
    least = min(f.cost if f.within_tolerance else np.inf for f in found)
    if any(f.bound > least + 1e-9 for f in found):
        raise AssertionError(f"costs and bounds contradict: {[(f.cost, f.bound) for f in found]}")


def measured(count: int, poses: bool) -> dict[str, Trace]:
    arm = load(PAPER_ARM)
    m, solver = arm.manipulator, ready_solver(arm)
    sparse = count // 4
    places = np.concatenate([random_tips(m, count - sparse), sparse_tips(m, solver.densities, arm.tolerance, sparse)])
    goals = list(random_frames(m, count, seed=7) if poses else np.random.default_rng(7).permutation(places))
    tolerances = POSE if poses else (arm.tolerance, np.inf)
    solves = [by(solver.another(), "minimum-switch", *tolerances, timeout=timeout) for timeout in ROWS.values()]
    previous, traces = home(m), {name: Trace() for name in ROWS}
    with no_collection():
        for n, goal in enumerate([*goals[:WARM], *goals]):
            answers = [solve(goal, previous) for solve in solves]
            agree(answers)
            if n >= WARM:
                for trace, answer in zip(traces.values(), answers, strict=True):
                    trace.found.append(answer)
                previous = answers[-1].configuration if answers[-1].within_tolerance else previous
    return traces


def main() -> None:
    given = CommandLine(__doc__, goals=2_000, busy=True).parse()
    figures = {}
    for kind, count in (("positions", given.goals), ("poses", max(given.goals // 5, 1))):
        figures[kind] = compared(f"{count} {kind}", measured(count, kind == "poses"))
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()

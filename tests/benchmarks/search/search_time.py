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
from tests.benchmarks.harness import PAPER_ARM, CommandLine, no_collection, percentiles, show, write_figures
from tests.benchmarks.search.goals import boundary, random
from tests.benchmarks.solving import WARM, home, ready_solver

POSE = 0.005, 0.03  # tolerances of poses
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


def measured(count: int, poses: bool) -> dict[str, list[Solution]]:
    arm = load(PAPER_ARM)
    m, solver = arm.manipulator, ready_solver(arm)
    sparse, known = count // 4, (m, solver.densities, arm.tolerance)
    goals = np.concatenate([random(*known, count - sparse), boundary(*known, sparse)])
    frames = m.tips(np.random.default_rng(7).integers(0, m.states, (count, len(m.states))))
    asked = list(frames) if poses else list(np.random.default_rng(7).permutation(goals))
    tolerances = POSE if poses else (arm.tolerance, np.inf)
    solvers = {name: solver.another() for name in ROWS}
    for each in solvers.values():
        each.prepare()
    previous, found = home(m), {name: list[Solution]() for name in ROWS}
    with no_collection():
        for n, goal in enumerate([*asked[:WARM], *asked]):
            answers = [
                s.solve(s.target(goal, *tolerances), previous, timeout=ROWS[name]) for name, s in solvers.items()
            ]
            agree(answers)
            if n >= WARM:
                for name, answer in zip(ROWS, answers, strict=True):
                    found[name].append(answer)
                if answers[-1].within_tolerance:
                    previous = answers[-1].configuration
    return found


def main() -> None:
    given = CommandLine(__doc__, goals=2_000, busy=True).parse()
    figures = {}
    for kind, count in (("positions", given.goals), ("poses", max(given.goals // 5, 1))):
        rows = []
        for name, found in measured(count, kind == "poses").items():
            reached, proven = (sum(getattr(f, x) is True for f in found) for x in ("within_tolerance", "optimal"))
            both = np.mean([f.switches for f in found if f.within_tolerance])
            times = percentiles([f.seconds for f in found], "p50", "p99", "worst")
            rows.append((name, reached, proven, f"{both:.3f}", *(f"{t:.4g}" for t in times.values())))
            figures[f"{kind}, {name}"] = {"reached": reached, "proven": proven, "switches": float(both)} | times
        headers = ("time", "reached", "proven", "switches, mean", "p50 [ms]", "p99 [ms]", "worst [ms]")
        show(f"{count} {kind}", headers, rows)
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()

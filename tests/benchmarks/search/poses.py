"""Results of each method for poses of random configurations: python -m tests.benchmarks.search.poses

With --busy deadlines and times are those of the thread on its processor, so that other programs do not count.
"""

import math

from hyperbit.controller.arm.arm import load
from tests.benchmarks.harness import DEPLOY, CommandLine, write_figures
from tests.benchmarks.solving import METHODS, POSE, by, compared, home, random_frames, ready_solver, traced

ARMS = {"planar16": (500, *POSE), "platform8": (200, 0.0156, math.radians(3.0))}  # goals at most, and tolerances


def main() -> None:
    given, figures = CommandLine(__doc__, goals=500, busy=True).parse(), {}
    for name, (most, *tolerances) in ARMS.items():
        arm = load(DEPLOY / f"{name}.yaml")
        solver, goals = ready_solver(arm), random_frames(arm.manipulator, min(given.goals, most))
        ways = {method: by(solver, method, *tolerances) for method in METHODS}
        ways["minimum-switch, position only"] = by(solver, "minimum-switch", tolerances[0])
        traces = {way: traced(solve, goals, home(arm.manipulator)) for way, solve in ways.items()}
        title = f"{name}: {len(goals)} poses, tolerances {tolerances[0]:g} and {tolerances[1]:.3g} rad"
        figures[name] = compared(title, traces)
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()

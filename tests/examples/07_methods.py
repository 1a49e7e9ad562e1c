"""Compare the methods on the same goals: switches, misses and time."""

from pathlib import Path

import numpy as np

import hyperbit as hb

PLANAR16 = Path(__file__).parents[2] / "deploy" / "planar16.yaml"
GOALS = 25

arm = hb.load(PLANAR16)
ik = hb.Solver(arm)
goals = arm.frames(arm.sample(GOALS, seed=7))[:, :2, 3]
print(f"{'method':16} {'switches':>8} {'reached':>8} {'ms':>6}")
for method in hb.METHODS:
    start, found = arm.home, []
    for goal in goals:
        found.append(ik.solve(goal, start=start, method=method))
        start = found[-1].configuration
    switches = np.mean([solution.switches for solution in found])
    reached = sum(solution.within_tolerance for solution in found)
    milliseconds = 1e3 * np.median([solution.seconds for solution in found])
    print(f"{method:16} {switches:8.2f} {reached:5d}/{GOALS} {milliseconds:6.2f}")

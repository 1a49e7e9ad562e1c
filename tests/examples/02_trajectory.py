"""Follow a circle: look-ahead switches fewer actuators than a separate search for each point."""

from pathlib import Path

import numpy as np

import hyperbit as hb

PLANAR16 = Path(__file__).parents[2] / "deploy" / "planar16.yaml"

arm = hb.load(PLANAR16)
ik = hb.Solver(arm)
angles = np.linspace(0.0, 2 * np.pi, 13)
circle = np.array([0.4, 2.8]) + 0.1 * np.column_stack((np.cos(angles), np.sin(angles)))
goals = [hb.Goal(position, tolerance=2e-3) for position in circle]

start = ik.solve(goals[0])
path = ik.follow(goals[1:], start=start)

alone, solution = 0, start
for goal in goals[1:]:
    solution = ik.solve(goal, start=solution)
    alone += solution.switches
print(f"{len(path.solutions)} points, {path.switches} switches; point by point {alone}")
print(f"farthest from a goal: {max(solution.error for solution in path.solutions):.5f}")
hb.plot(arm, path, title="A circle").savefig("trajectory.png")

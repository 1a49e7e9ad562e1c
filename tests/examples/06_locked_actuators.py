"""An actuator is stuck: lock it, and continue with the others."""

from pathlib import Path

import numpy as np

import hyperbit as hb

PLANAR16 = Path(__file__).parents[2] / "deploy" / "planar16.yaml"

arm = hb.load(PLANAR16)
worn = arm.lock({"5.left": "extended", "9.diagonal": "contracted"})
goal = hb.Goal((0.55, 2.9), tolerance=2e-3)
for name, one in (("whole", arm), ("with locked actuators", worn)):
    solution = hb.Solver(one).solve(goal)
    states = dict(zip(one.actuators, one.actuator_states(solution.configuration).tolist(), strict=True))
    print(f"{name}: {solution.switches} switches, {solution.certificate}; 5.left is {states['5.left']}")

lost = arm.density().total - worn.density().total
print(f"locked: {worn.locked}; one configuration in {np.exp(lost):.3g} is left")

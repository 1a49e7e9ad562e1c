"""Find the configuration of the paper's arm that reaches a point with the fewest switches."""

from pathlib import Path

import hyperbit as hb

PLANAR16 = Path(__file__).parents[2] / "deploy" / "planar16.yaml"

arm = hb.load(PLANAR16)
ik = hb.Solver(arm)
solution = ik.solve(hb.Goal((0.55, 2.9), tolerance=2e-3), start=arm.home)

print(f"configuration {arm.format(solution.configuration)}, {solution.switches} switches")
print(f"tip {arm.position(solution.configuration).round(4)}, {solution.error:.5f} from the goal")
print(f"certificate: {solution.certificate}; no configuration costs less than {solution.bound:g}")

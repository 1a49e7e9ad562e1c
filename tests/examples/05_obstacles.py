"""Avoid collisions of the whole arm with obstacles, at the goals and between them."""

from pathlib import Path

import hyperbit as hb

PLANAR16 = Path(__file__).parents[2] / "deploy" / "planar16.yaml"

arm = hb.load(PLANAR16)
obstacles = [hb.Disc((1.2, 2.0), 0.3, "crate"), hb.HalfPlane((-0.5, 0.0), (1.0, 0.0), "wall")]
free, careful = hb.Solver(arm), hb.Solver(arm, obstacles=obstacles)

goal = hb.Goal((1.0, 2.5), tolerance=0.01)
careless = free.solve(goal)
solution = careful.solve(goal)
print(f"without obstacles: {careless.switches} switches; {careful.contact(careless.configuration) or 'clear'}")
print(f"with obstacles: {solution.switches} switches; {careful.contact(solution.configuration) or 'clear'}")

path = careful.follow([hb.Goal((1.0, 2.7), tolerance=0.01), goal])
print(f"path of {path.switches} switches")
hb.plot(arm, path, obstacles=obstacles).savefig("obstacles.png")

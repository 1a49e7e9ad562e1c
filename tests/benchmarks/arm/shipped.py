"""Each arm in deploy: time of mapping, and the results of each method for random goals."""

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.mapping import map_densities
from tests.benchmarks.harness import DEPLOY, CommandLine, timed, write_figures
from tests.benchmarks.solving import METHODS, by, compared, home, random_tips, traced


def main() -> None:
    given, figures = CommandLine(__doc__, goals=200).parse(), {}
    for path in sorted(DEPLOY.glob("*.yaml")):
        arm = load(path)
        m = arm.manipulator
        map_densities(m, m.length / 20, 1_000)  # loads the kernels
        densities, seconds = timed(lambda arm=arm, m=m: map_densities(m, arm.pixel, arm.level_pixels))
        solver = Solver(m, densities, weights_of(arm))
        solver.prepare()
        goals = random_tips(m, given.goals)
        traces = {method: traced(by(solver, method, arm.tolerance), goals, home(m)) for method in METHODS}
        title = f"{path.stem}: length {m.length:.3g}, tolerance {arm.tolerance:g}, mapped in {seconds:.2f} s"
        figures[path.stem] = compared(f"{title}, {densities.values.nbytes / 1e6:.1f} MB", traces)
    write_figures(given.json, figures)


if __name__ == "__main__":
    main()

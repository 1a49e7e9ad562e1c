"""The experiment of section 4: three targets in order, from the contracted arm, with each of three methods."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration
from hyperbit.controller.pictures import plots
from hyperbit.controller.search.method import PAPER_METHODS, PaperMethod
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.densities import Densities

TARGETS = ((3.0, 0.7), (0.55, 2.9), (0.4, 2.9))
TITLES: dict[PaperMethod, str] = {
    "pop": "(a) POP",
    "ipop-previous": "(b) IPOP, similar to the previous",
    "ipop-contracted": "(c) IPOP, contracted",
}


@dataclass(frozen=True)
class ExperimentResult:
    method: PaperMethod
    target: tuple[float, float]
    configuration: str  # text form, base first
    x: float
    y: float
    theta: float  # orientation of the tip [rad]
    error: float  # distance of the tip from the target
    switches: int  # actuators that differ from the previous configuration


def experiment(arm: Arm, densities: Densities) -> list[ExperimentResult]:
    """Returns nine rows, in the order of Figure 6."""
    solver, results = Solver(arm.manipulator, densities), []
    for method in PAPER_METHODS:
        previous = np.zeros(len(arm.manipulator.modules), dtype=np.int64)
        for target in TARGETS:
            found = solver.solve(solver.target(target, arm.tolerance), previous, method)
            previous = found.configuration
            results.append(
                ExperimentResult(
                    method=method,
                    target=target,
                    configuration=format_configuration(arm.manipulator, found.configuration),
                    x=float(found.tip[0, 3]),
                    y=float(found.tip[1, 3]),
                    theta=frames.angle(found.tip),
                    error=found.error,
                    switches=found.switches,
                )
            )
    return results


def save(path: Path, arm: Arm, densities: Densities, results: list[ExperimentResult]) -> None:
    """Writes Figure 5 (a) to (c) as three pictures side by side."""
    subplots = []
    for method in PAPER_METHODS:
        own = [result for result in results if result.method == method]
        reached = {f"({result.target[0]:g}, {result.target[1]:g})": result.configuration for result in own}
        configurations = {name: parse_configuration(arm.manipulator, text) for name, text in reached.items()}
        subplots.append(plots.Subplot(TITLES[method], configurations, [result.target for result in own]))
    plots.save(path, arm.manipulator, densities, subplots, arm.settings.unit)

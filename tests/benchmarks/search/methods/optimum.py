"""The proven minimum of switches by tests.benchmarks.proofs.proof, as a reference method."""

import numpy as np

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.obstacles import NONE
from hyperbit.controller.workspace.densities import Densities
from tests.benchmarks.proofs.proof import prove

DEPTHS = (4, 5)  # so that twelve switches can be proven to be the fewest


def prepare(manipulator: Manipulator, densities: Densities | None) -> BodyClearance:
    return BodyClearance(manipulator, NONE)


def solve(problem: BodyClearance, goal: np.ndarray, previous: Configuration, tolerance: float) -> Configuration | None:
    """Returns a configuration of provably fewest switches, or None if the depths do not suffice."""
    frame = np.eye(4)
    frame[: len(goal), 3] = goal
    proof = prove(problem, frame, previous, tolerance, depths=DEPTHS)
    return proof.configuration if proof.proven else None

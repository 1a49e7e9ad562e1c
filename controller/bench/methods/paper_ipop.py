"""IPOP as printed: Ebert-Uphoff and Chirikjian 1996, section 3.2.2, similarity to the previous configuration.

Among the branches whose density exceeds a threshold, one for the whole arm, the descent takes the one most similar to
the previous configuration: the unchanged state of a module, regardless of its actuators. Among changed states it takes
the densest; the paper does not specify this. The paper's weights by module have no effect, because modules are decided
one at a time.

The variant counts actuators instead of modules. The paper does not have it.
"""

import numpy as np

from hyperbit.controller.bench.methods.paper_pop import PopProblem, descent, prepare
from hyperbit.controller.bench.methods.planar import Array
from hyperbit.controller.manipulator.manipulator import Configuration

__all__ = ["prepare", "solve", "solve_by_switches"]

# Points per unit of area; the paper gives no value. Among 1e5 to 1e9, this value gave the least error and the greatest
# share within the tolerance on the paper's arm. A tenth of it saves nearly one switch, but misses more goals.
THRESHOLD = 1e8


def solve(problem: PopProblem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    """Returns a configuration (B,) for a goal (2,), by the criterion as printed."""
    states = np.arange(problem.arm.differing.shape[2])
    changed = np.asarray(states != np.asarray(previous)[:, None], dtype=np.int64)
    return descent(problem, goal, changed, thresholds(problem))


def solve_by_switches(problem: PopProblem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    """Returns a configuration (B,) for a goal (2,), by the variant that counts actuators."""
    return descent(problem, goal, problem.arm.costs(previous), thresholds(problem))


def thresholds(problem: PopProblem) -> Array:
    """Returns the threshold on ln of a pixel's count, for each level, shape (B+1,)."""
    return np.asarray(np.log(np.maximum(THRESHOLD * problem.densities.pixels**2, 1.0)))

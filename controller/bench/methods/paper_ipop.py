"""IPOP as printed: Ebert-Uphoff and Chirikjian 1996, section 3.2.2, similarity to the previous configuration.

Of the branches whose density is above a threshold, one for the whole arm, the one most like before is taken. The paper
counts modules that stay; here actuators are counted, which is the same where a module stays, and where none can it
switches less: on the paper's arm, nearly one actuator a goal. The paper's weights by module change nothing, as modules
are decided one at a time.
"""

import numpy as np

from controller.bench.methods.paper_pop import Problem, descent, prepare
from controller.bench.methods.planar import Array
from controller.manipulator.manipulator import Configuration

__all__ = ["prepare", "solve"]

# Points in each unit of area, of which the paper says nothing. From 1e5 to 1e9, this gave the least error and the
# greatest share within the tolerance on the paper's arm; a tenth of it switches nearly one actuator less, but misses
# more.
THRESHOLD = 1e8


def solve(problem: Problem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    """Returns a configuration (B,) for a goal (2,)."""
    thresholds = np.log(np.maximum(THRESHOLD * problem.densities.pixels**2, 1.0))
    return descent(problem, goal, problem.arm.costs(previous), thresholds)

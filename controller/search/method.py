"""Search methods by name, the cost of a switch, and the secondary criteria of POP and IPOP as stage costs.

The criteria of section 3.2.2 count modules: modules that keep their state, and modules that are fully contracted. Two
variants of hyperbit count actuators: actuators that switch, and extended actuators. The paper gives neither weights nor
a threshold on the density. Here the weights fall from 2 at the base to 1 at the tip; see paths.ENOUGH for thresholds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.armfile.settings import MINIMUM_SWITCH as MINIMUM_SWITCH
from hyperbit.controller.armfile.settings import Method as Method
from hyperbit.controller.armfile.settings import PaperMethod as PaperMethod
from hyperbit.controller.armfile.settings import Variant as Variant

if TYPE_CHECKING:  # importing its kernels is slow, and commands need only the names
    from hyperbit.controller.manipulator.manipulator import Manipulator

PAPER_METHODS: tuple[PaperMethod, ...] = get_args(PaperMethod)
VARIANTS: tuple[Variant, ...] = get_args(Variant)
METHODS: tuple[Method, ...] = (MINIMUM_SWITCH, *PAPER_METHODS, *VARIANTS)

StageCosts = NDArray[np.float64]


def stage_costs(method: PaperMethod | Variant, manipulator: Manipulator, previous: ArrayLike) -> StageCosts:
    """Returns the secondary criterion of a method: the cost of each module's states, shape (B, Kmax).

    POP has no secondary criterion: all costs are 0. Others stay close to the configuration `previous` (B,).
    """
    bits, counts = manipulator.bits, np.zeros(manipulator.bits.shape[:2])
    if method == "ipop-previous":
        counts[:] = np.arange(bits.shape[1]) != np.asarray(previous)[:, None]
    elif method == "ipop-contracted":
        counts[:] = bits.any(axis=2)
    elif method == "ipop-fewest-switches":
        counts = distances(manipulator, previous)
    elif method == "ipop-fewest-extended":
        counts[:] = bits.sum(axis=2)
    return np.linspace(2.0, 1.0, len(counts))[:, None] * counts


def cost_of_switches(switches: ArrayLike, weights: NDArray[np.float64], axis: int | tuple[int, ...] = (-2, -1)) -> Any:
    """Returns the cost of switches (..., B, Amax): the sum of all weights, each times how often its actuator switches.

    The weights have shape (B, Amax), or further axes to match `switches`. The sum is over `axis`.
    """
    return (np.asarray(switches) * weights).sum(axis=axis, dtype=float)


def switch_costs(manipulator: Manipulator, previous: ArrayLike, weights: NDArray[np.float64]) -> StageCosts:
    """Returns the cost of each module's states (B, Kmax): that of the switches from a configuration (B,).

    The weights (B, Amax) are the cost of a switch of each actuator.
    """
    own = manipulator.bits[np.arange(len(manipulator.modules)), np.asarray(previous)]
    return np.asarray(cost_of_switches(manipulator.bits != own[:, None], weights[:, None], axis=2))


def costs_between_states(manipulator: Manipulator, weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the cost of the switches between any two states of each module (B, Kmax, Kmax), for weights (B, Amax)."""
    bits = manipulator.bits
    return np.ascontiguousarray(cost_of_switches(bits[:, :, None] != bits[:, None], weights[:, None, None], axis=3))


def distances(manipulator: Manipulator, configuration: ArrayLike) -> StageCosts:
    """Returns the number of actuators (B, Kmax) of each state that differ from a configuration (B,)."""
    return switch_costs(manipulator, configuration, np.ones((len(manipulator.modules), manipulator.bits.shape[2])))


def mean_cost(manipulator: Manipulator, costs: StageCosts) -> float:
    """Returns the mean cost of switching an actuator, from the costs of each state (B, Kmax)."""
    dearest = sum(costs[i, :k].max() for i, k in enumerate(manipulator.states.tolist()))
    return float(dearest / len(manipulator.actuators))

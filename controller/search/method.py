"""Methods by name, what their states cost, and IPOP's secondary criteria, as penalties.

The criteria of section 3.2.2 count modules: those that remain in the same state (`similarity`), those that are fully
contracted (`contraction`). Two variants of ours count actuators: those that switch, those that are extended. Weights
fall from base to tip. The paper gives neither the weights nor the threshold on the density: see paths.ENOUGH for ours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.settings import Method as Method
from controller.settings import PaperMethod as PaperMethod
from controller.settings import Variant as Variant

if TYPE_CHECKING:  # its kernels take long to import, and commands need the names only
    from controller.manipulator.manipulator import Manipulator

PAPER_METHODS: tuple[PaperMethod, ...] = get_args(PaperMethod)
VARIANTS: tuple[Variant, ...] = get_args(Variant)
METHODS: tuple[Method, ...] = ("minimum-switch", *PAPER_METHODS, *VARIANTS)

Penalties = NDArray[np.float64]


def indifferent(manipulator: Manipulator) -> Penalties:
    """Returns no penalty (B, Kmax) for any state: POP."""
    return np.zeros(manipulator.bits.shape[:2])


def similarity(manipulator: Manipulator, previous: ArrayLike) -> Penalties:
    """Returns penalties (B, Kmax) that count the modules which do not remain in the state of `previous` (B,)."""
    states = np.arange(manipulator.bits.shape[1])
    return weighted(np.asarray(states != np.asarray(previous)[:, None], dtype=np.int64))


def contraction(manipulator: Manipulator) -> Penalties:
    """Returns penalties (B, Kmax) that count the modules which are not fully contracted, binary state 0."""
    return weighted(np.asarray(manipulator.bits.any(axis=2), dtype=np.int64))


def fewest_switches(manipulator: Manipulator, previous: ArrayLike) -> Penalties:
    """Returns penalties (B, Kmax) that count the actuators which differ from configuration `previous` (B,)."""
    own = manipulator.bits[np.arange(len(manipulator.modules)), np.asarray(previous)]
    return weighted((manipulator.bits != own[:, None]).sum(axis=2))


def fewest_extended(manipulator: Manipulator) -> Penalties:
    """Returns penalties (B, Kmax) that count the extended actuators."""
    return weighted(manipulator.bits.sum(axis=2))


def switching(manipulator: Manipulator, previous: ArrayLike, weights: NDArray[np.float64]) -> Penalties:
    """Returns what each state costs (B, Kmax): the weights, (B, Amax), of the actuators that differ from `previous`."""
    own = manipulator.bits[np.arange(len(manipulator.modules)), np.asarray(previous)]
    return np.asarray(((manipulator.bits != own[:, None]) * weights[:, None]).sum(axis=2), dtype=float)


def mean_cost(manipulator: Manipulator, costs: Penalties) -> float:
    """Returns the mean cost of switching an actuator, from the costs of each state (B, Kmax)."""
    dearest = sum(costs[i, :k].max() for i, k in enumerate(manipulator.states.tolist()))
    return float(dearest / len(manipulator.actuators))


def weighted(counts: NDArray[np.integer]) -> Penalties:
    """Returns counts (B, Kmax) weighted from 2 at the base to 1 at the tip."""
    return np.linspace(2.0, 1.0, len(counts))[:, None] * counts


def distances(manipulator: Manipulator, configuration: ArrayLike) -> NDArray[np.float64]:
    """Returns how many actuators of each state (B, Kmax) differ from a configuration (B,)."""
    own = manipulator.bits[np.arange(len(manipulator.modules)), np.asarray(configuration)]
    return np.asarray((manipulator.bits != own[:, None]).sum(axis=2), dtype=float)

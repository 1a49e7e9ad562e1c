"""Which configurations to measure next: those whose tips tell most about the numbers that are fitted.

The proposals are greedy. Each is the configuration that most lowers the mean variance of the tips that a fit predicts,
over tips spread evenly over the workspace (I-optimal design; Box and Draper 1959). The variances follow from the
derivatives of the tips by the numbers, and from the prior of the file's numbers, as in the fit. The best configuration
of a pool is improved by exchanging one module's state after the other (Meyer and Nachtsheim 1995).
"""

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.calibration.model import Array, Model
from hyperbit.controller.manipulator.manipulator import Configuration

Configurations = NDArray[np.int64]

POOL, DRAWN = 600, 6000  # configurations of the pool, and those that are drawn for it
CELLS = 12  # cells of the workspace along the arm's length, of which each has the same share of the pool
CHANGES = (0.1, 0.2, 0.4, 1.0)  # probabilities that a module of a drawn configuration differs from the one below
EXCHANGES = 16  # most states that are exchanged in one proposal
NOISE = 1e-3  # standard deviation of a coordinate relative to the mean length of a module, and of an angle [rad]


class Design:
    """The information that measured configurations give, and the configurations that add most to it.

    Attributes:
        pool: configurations (n, B) that may be proposed, with tips spread evenly over the workspace.

    Args:
        arm: the arm of the file; its locked actuators stay, and no configuration collides.
        model: the numbers to fit.
        oriented: whether orientations are measured.
        noise: standard deviation of a coordinate, and of an angle [rad], as a fit has found; None: NOISE.
        seed: of the pool.

    Raises:
        ValueError: each configuration that was drawn collides.
    """

    def __init__(
        self, arm: Arm, model: Model, *, oriented: bool = False, noise: Array | None = None, seed: int = 0
    ) -> None:
        self._arm, self._model, self._oriented = arm, model, oriented
        self._clearance, self._states = arm.clearance(), states_of(arm)
        self._priors = np.array([parameter.prior for parameter in model.parameters])
        self.pool = self._drawn(np.random.default_rng(seed))
        self._slopes, size = self._jacobian(self.pool), arm.manipulator.dimension
        scale = arm.manipulator.length / len(arm.manipulator.modules)
        given = np.array([NOISE * scale, NOISE]) if noise is None else np.resize(noise, 2)
        self._noise = given[(np.arange(self._slopes.shape[1]) >= size).astype(int)]
        positions = self._slopes[:, :size].reshape(-1, len(self._priors))
        self._wanted = positions.T @ positions / len(self.pool)
        self._information = np.eye(len(self._priors))  # of the file
        self._taken = set[bytes]()

    @property
    def error(self) -> float:
        """Root mean square distance of a tip from its prediction that is expected, over the workspace."""
        return float(np.sqrt(np.trace(np.linalg.solve(self._information, self._wanted))))

    def add(self, configurations: Configurations) -> None:
        """Adds measured configurations (n, B)."""
        if len(configurations):
            weighted = self._jacobian(configurations) / self._noise[:, None]
            self._information += np.einsum("ncp,ncq->pq", weighted, weighted)
            self.leave_out(configurations)

    def leave_out(self, configurations: Configurations) -> None:
        """Proposes configurations (n, B) no more."""
        self._taken |= {row.tobytes() for row in configurations}

    def propose(self) -> Configuration | None:
        """Returns the configuration (B,) to measure next; None if all of the pool are taken."""
        free = np.array([row.tobytes() not in self._taken for row in self.pool])
        if not free.any():
            return None
        covariance = np.linalg.inv(self._information)
        spread = covariance @ self._wanted @ covariance

        def gains(slopes: Array) -> Array:
            """Returns how much each configuration lowers the variance (n,), from derivatives (n, C, P)."""
            seen = slopes @ covariance @ np.swapaxes(slopes, 1, 2) + np.diag(self._noise**2)
            told = slopes @ spread @ np.swapaxes(slopes, 1, 2)
            return np.asarray(np.trace(np.linalg.solve(seen, told), axis1=1, axis2=2))

        of_pool = np.where(free, gains(self._slopes), -np.inf)
        best: Configuration = self.pool[int(of_pool.argmax())]
        greatest = float(of_pool.max())
        for _ in range(EXCHANGES):
            near = self._neighbours(best)
            if not len(near) or (found := gains(self._jacobian(near))).max() <= greatest * 1.001:
                break
            best, greatest = near[int(found.argmax())], float(found.max())
        return best

    def _neighbours(self, configuration: Configuration) -> Configurations:
        """Returns the configurations (n, B) that differ in one module, and may be proposed."""
        near = np.repeat(configuration[None], sum(map(len, self._states)), axis=0)
        begin = 0
        for i, states in enumerate(self._states):
            near[begin : begin + len(states), i] = states
            begin += len(states)
        free = np.array([row.tobytes() not in self._taken for row in near]) & (near != configuration).any(axis=1)
        return np.asarray(near[free & ~self._clearance.blocked(near)])

    def _drawn(self, random: np.random.Generator) -> Configurations:
        """Returns at most POOL configurations (n, B) that are clear, with tips spread evenly over the workspace.

        In some of those that are drawn, neighbouring modules have equal states, so that the arm curls up.
        """
        counts = np.array([len(states) for states in self._states])
        drawn = random.integers(0, counts, (DRAWN, len(counts)))
        change = random.random(drawn.shape) < random.choice(CHANGES, (DRAWN, 1))
        begins = np.maximum.accumulate(np.where(change, np.arange(drawn.shape[1]), 0), axis=1)
        drawn = np.take_along_axis(drawn, begins, axis=1) % counts
        drawn = np.column_stack([states[drawn[:, i]] for i, states in enumerate(self._states)])
        drawn = np.unique(drawn[~self._clearance.blocked(drawn)], axis=0)
        if not len(drawn):
            raise ValueError("all configurations that were drawn collide: are the obstacles right?")
        tips = self._arm.manipulator.tips(drawn)[:, : self._arm.manipulator.dimension, 3]
        cells = np.floor(tips / (self._arm.manipulator.length / CELLS)).astype(np.int64)
        _, cell, tips_in_cell = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        chances: Array = 1.0 / tips_in_cell[cell.ravel()]
        chosen = random.choice(len(drawn), min(POOL, len(drawn)), replace=False, p=chances / chances.sum())
        return np.asarray(drawn[chosen])

    def _jacobian(self, configurations: Configurations) -> Array:
        """Returns the derivatives (n, C, P) of tips by the numbers, in units of their prior standard deviations."""
        seen = self._model.computed(configurations, oriented=self._oriented)
        return np.asarray(self._model.jacobian(seen, np.zeros(len(self._priors))) * self._priors)


def states_of(arm: Arm) -> list[NDArray[np.int64]]:
    """Returns the states that each module may have as actuators are locked."""
    bits, locked = arm.manipulator.bits, arm.manipulator.per_module(arm.locked)
    fits = ((bits == locked[:, None]) | (locked[:, None] < 0)).all(axis=2)
    return [np.flatnonzero(fits[i, :count]) for i, count in enumerate(arm.manipulator.states)]

"""All configurations of a small arm, what they touch, and the cheapest ways among them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Manipulator

Costs = NDArray[np.float64]


class Disc(NamedTuple):
    """An obstacle."""

    x: float
    y: float
    radius: float


class Graph(NamedTuple):
    """The configurations that are permitted, and the costs of the stages between them, shape (N, N)."""

    permitted: NDArray[np.bool_]
    stages: Costs

    def spread(self, costs: Costs) -> Costs:
        """Returns the least cost (N,) to reach each configuration, from the costs (N,) to begin in it."""
        while True:
            better = np.minimum(costs, (costs[:, None] + self.stages).min(axis=0))
            if (better == costs).all():
                return costs
            costs = better


class Configurations:
    """All N configurations of an arm.

    Attributes:
        codes: actuator states as integers, shape (N,).
        tips: positions, shape (N, dimension).
        joints: positions of all frames from the base to the tip, shape (N, B + 1, dimension).
        angles: orientations of the tips of a planar arm, shape (N,) [rad].
        index: number of the configuration of each code.
        notations: each configuration as text.

    Args:
        most: actuators that may switch at once.
        weights: cost of a switch of each actuator, whole numbers.
        body: radius of the modules' bodies, which are lines from frame to frame.
    """

    def __init__(self, manipulator: Manipulator, most: int, weights: Sequence[float], body: float) -> None:
        every = np.array(list(product(*(range(count) for count in manipulator.states.tolist()))))
        frames, size = [np.tile(manipulator.base, (len(every), 1, 1))], manipulator.dimension
        for i, module in enumerate(manipulator.modules):
            frames.append(frames[-1] @ module.frames[every[:, i]])
        self.weights, self._body = tuple(weights), body
        bits = [module.bits[every[:, i]] for i, module in enumerate(manipulator.modules)]
        self.codes = np.concatenate(bits, axis=1).astype(np.int64) @ (1 << np.arange(len(weights)))
        self.joints = np.stack([frame[:, :size, 3] for frame in frames], axis=1)
        self.tips = self.joints[:, -1].copy()
        self.angles = np.arctan2(frames[-1][:, 1, 0], frames[-1][:, 0, 0])
        self.notations = ["".join(map(str, row)) for row in every.tolist()]
        self.index = {code: k for k, code in enumerate(self.codes.tolist())}
        differ = self.codes[:, None] ^ self.codes
        apart = sum(differ >> k & 1 for k in range(len(weights)))
        costs = sum((differ >> k & 1) * weight for k, weight in enumerate(weights))
        self._costs, self._apart = np.where(apart <= most, costs, np.inf), costs
        self._graphs: dict[object, Graph] = {}
        self._touching: dict[Disc, NDArray[np.bool_]] = {}

    def nearest(self, states: int, locked: int) -> int:
        """Returns the code nearest to actuator states, without a switch of the locked actuators."""
        fitting = [code for code in self.index if not (code ^ states) & locked] or [0]
        return min(fitting, key=lambda code: (code ^ states).bit_count())

    def touched(self, disc: Disc, before: int, after: int) -> bool:
        """Returns whether a stage passes a configuration that touches a disc. What lies between these is not judged."""
        touching = self.codes[self.touching(disc)]
        return bool((((touching ^ before) & (touching ^ after)) == 0).any())

    def touching(self, disc: Disc) -> NDArray[np.bool_]:
        """Returns which configurations touch a disc with some module, shape (N,)."""
        if disc not in self._touching:
            starts, ways = self.joints[:, :-1], np.diff(self.joints, axis=1)
            to = np.array([disc.x, disc.y]) - starts
            shares = (to * ways).sum(axis=2) / np.maximum((ways**2).sum(axis=2), 1e-300)
            away = np.linalg.norm(to - np.clip(shares, 0.0, 1.0)[:, :, None] * ways, axis=2)
            self._touching[disc] = (away <= disc.radius + self._body).any(axis=1)
        return self._touching[disc]

    def graph(self, locked: int, states: int, discs: tuple[Disc, ...], between: bool = False) -> Graph:
        """Returns the graph of the configurations with locked actuators that touch no obstacle.

        A stage may pass a configuration that does: the cheapest way of the arm costs as much as in this graph, or more.
        `between`: several stages may lead from one to the next, through states that are no configurations.
        """
        key = locked, states & locked, discs, between
        if key not in self._graphs:
            if len(self._graphs) > 8:
                self._graphs.clear()
            permitted = (self.codes ^ states) & locked == 0
            for disc in discs:
                permitted &= ~self.touching(disc)
            costs = self._apart if between else self._costs
            self._graphs[key] = Graph(permitted, np.where(permitted[:, None] & permitted, costs, np.inf))
        return self._graphs[key]

    def optimum(self, graph: Graph, start: int, wanted: Sequence[NDArray[np.bool_]]) -> float:
        """Returns the least cost from a configuration through all wanted sets; infinite if there is no way."""
        costs = np.full(len(self.codes), np.inf)
        costs[start] = 0.0
        for fits in wanted:
            costs = np.where(fits, graph.spread(costs), np.inf)
        return float(costs.min())

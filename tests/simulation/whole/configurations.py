"""All configurations of a small arm, and exact searches among them.

An obstacle of the simulation is a set of actuator states: all states that equal `value` on the bits of `mask`. A stage
touches an obstacle if the arm may be in one of these states before, during or after the stage.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.notation import format_configuration
from tests.simulation.whole.planned_arms import integer

Costs = NDArray[np.float64]


class Cube(NamedTuple):
    mask: int
    value: int

    def touched(self, before: int, after: int) -> bool:
        """Returns whether a stage touches it."""
        return not (before ^ self.value) & (after ^ self.value) & self.mask


def cubes_of(obstacles: Any) -> tuple[Cube, ...]:
    """Returns the obstacles of a decoded request; the centre of each disc has mask and value."""
    return tuple(Cube(round(centre[0]), round(centre[1])) for centre in obstacles.centres)


def first_touched(cubes: Sequence[Cube], before: int, stages: Sequence[int]) -> str | None:
    """Returns the first obstacle that stages touch, in words; None if they touch none."""
    for stage in stages:
        for cube in cubes:
            if cube.touched(before, stage):
                return f"the arm touches the cube {cube.mask:b} {cube.value:b}"
        before = stage
    return None


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
        angles: orientations of the tips of a planar arm, shape (N,) [rad].
        index: number of the configuration of each code.
        notations: each configuration as text.

    Args:
        most: actuators that may switch at once.
        weights: cost of a switch of each actuator, whole numbers.
    """

    def __init__(self, manipulator: Manipulator, most: int, weights: Sequence[float]) -> None:
        every = np.array(list(product(*(range(count) for count in manipulator.states.tolist()))))
        self.weights = tuple(weights)
        self.codes = np.array([integer(manipulator.actuator_states(row)) for row in every])
        frames = manipulator.tips(every)
        self.tips = frames[:, : manipulator.dimension, 3].copy()
        self.angles = np.arctan2(frames[:, 1, 0], frames[:, 0, 0])
        self.notations = [format_configuration(manipulator, row) for row in every]
        self.index = {code: k for k, code in enumerate(self.codes.tolist())}
        self._differ = self.codes[:, None] ^ self.codes
        apart = np.zeros(self._differ.shape)
        for k in range(len(manipulator.actuators)):
            apart += self._differ >> k & 1
        costs = sum((self._differ >> k & 1) * weight for k, weight in enumerate(weights))
        self._costs = np.where(apart <= most, costs, np.inf)
        self._graphs: dict[object, Graph] = {}

    def nearest(self, states: int, locked: int) -> int:
        """Returns the code nearest to actuator states, without a switch of the locked actuators."""
        fitting = [code for code in self.index if not (code ^ states) & locked] or [0]
        return min(fitting, key=lambda code: (code ^ states).bit_count())

    def graph(self, locked: int, states: int, cubes: tuple[Cube, ...]) -> Graph:
        """Returns the graph of the configurations with locked actuators, among obstacles."""
        key = locked, states & locked, cubes
        if key not in self._graphs:
            if len(self._graphs) > 8:
                self._graphs.clear()
            self._graphs[key] = self._build(locked, states, cubes)
        return self._graphs[key]

    def _build(self, locked: int, states: int, cubes: tuple[Cube, ...]) -> Graph:
        permitted = (self.codes ^ states) & locked == 0
        costs = np.where(permitted[:, None] & permitted, self._costs, np.inf)
        for cube in cubes:
            apart = (self.codes ^ cube.value) & cube.mask
            permitted &= apart != 0
            costs[(apart[:, None] & apart) == 0] = np.inf
        return Graph(permitted, costs)

    def near(self, position: NDArray[np.float64], tolerance: float) -> NDArray[np.bool_]:
        """Returns which configurations have their tip near a position, shape (N,)."""
        return np.asarray(np.linalg.norm(self.tips - position, axis=1) <= tolerance)

    def turned(self, rotation: NDArray[np.float64], tolerance: float) -> NDArray[np.bool_]:
        """Returns which configurations have their tip turned as a rotation (3, 3), shape (N,)."""
        apart = self.angles - np.arctan2(rotation[1, 0], rotation[0, 0])
        return np.asarray(np.abs((apart + np.pi) % (2 * np.pi) - np.pi) <= tolerance)

    def layers(self, graph: Graph, start: int, wanted: Sequence[NDArray[np.bool_]]) -> list[Costs]:
        """Returns the least costs from a configuration over each of the wanted sets, before and at each point."""
        costs = np.full(len(self.codes), np.inf)
        costs[start] = 0.0
        layers = []
        for fits in wanted:
            reached = graph.spread(costs)
            costs = np.where(fits, reached, np.inf)
            layers += [reached, costs]
        return layers

    def optimum(self, graph: Graph, start: int, wanted: Sequence[NDArray[np.bool_]]) -> float:
        """Returns the least cost from a configuration through all wanted sets; infinite if there is no way."""
        return float(self.layers(graph, start, wanted)[-1].min())

    def path(self, graph: Graph, start: int, end: int, reached: Costs) -> list[int]:
        """Returns the configurations after `start` on a cheapest way to `end`; `reached` has costs from `start`."""
        way = [end]
        while way[-1] != start:
            way.append(self._before(graph, way[-1], reached))
        return way[-2::-1]

    def _before(self, graph: Graph, end: int, reached: Costs) -> int:
        """Returns a configuration before another one on a cheapest way; all costs are whole numbers."""
        costs = reached + graph.stages[:, end]
        costs[end] = np.inf
        return int(np.argmin(costs))

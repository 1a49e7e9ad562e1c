"""The mechanics of a small arm by plain computation: all configurations, their tips, and the cheapest ways."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, ...]
MOST_KNOWN = 8  # tables of stages that are kept


class Cube(NamedTuple):
    """An obstacle: all actuator states that equal `value` on the bits of `mask`."""

    mask: int
    value: int

    def touched(self, before: int, after: int) -> bool:
        """Returns whether a stage touches it: the arm may be in one of its states before, during or after the stage."""
        return not (before ^ self.value) & (after ^ self.value) & self.mask


class Tip(NamedTuple):
    """The tip in the world; `angle` is counter-clockwise [rad]."""

    position: Point
    angle: float


class ModuleFacts(NamedTuple):
    """A module.

    Attributes:
        frames: from its base to its end, one (4, 4) for each state.
        codes: states of its actuators, one row for each state.
    """

    frames: Any
    codes: Any


class JudgedModules:
    """All configurations of a planar arm.

    Attributes:
        uniform: whether each switch costs 1.
        tips: by code; a code is the actuator states as bits.
        notations: digit of each module's state, by code.

    Args:
        base: frame (4, 4).
        weights: cost of a switch of each actuator.
        most: actuators that may switch at once.
    """

    def __init__(
        self, modules: Sequence[ModuleFacts], base: Any, labels: Sequence[str], weights: Sequence[float], most: int
    ) -> None:
        self.labels, self.uniform = tuple(labels), set(weights) == {1.0}
        self.tips: dict[int, Tip] = {}
        self.notations: dict[int, str] = {}
        for states in product(*(range(len(module.frames)) for module in modules)):
            frame, code, place = np.array(base, float), 0, 0
            for module, state in zip(modules, states, strict=True):
                frame = frame @ np.array(module.frames[state], float)
                for bit in module.codes[state]:
                    code |= int(bit) << place
                    place += 1
            position = (float(frame[0, 3]), float(frame[1, 3]))
            self.tips[code] = Tip(position, math.atan2(frame[1, 0], frame[0, 0]))
            self.notations[code] = "".join(map(str, states))
        self._codes = np.array(list(self.tips))
        differ = self._codes[:, None] ^ self._codes
        bits = [(differ >> k & 1) * weight for k, weight in enumerate(weights)]
        apart = sum(differ >> k & 1 for k in range(len(weights)))
        self._costs = np.where(apart <= most, sum(bits), np.inf)
        self._known: dict[object, NDArray[np.float64]] = {}
        self.codes = {text: code for code, text in self.notations.items()}
        self.farthest = max(math.hypot(*tip.position) for tip in self.tips.values())

    def near(self, position: Point, tolerance: float) -> set[int]:
        """Returns the codes whose tip is within a distance of a position."""
        return {code for code, tip in self.tips.items() if math.dist(tip.position, position) <= tolerance}

    def turned(self, angle: float, tolerance: float) -> set[int]:
        """Returns the codes whose tip has an orientation within a tolerance [rad]."""
        return {code for code, tip in self.tips.items() if abs(turn(tip.angle, angle)) <= tolerance + 1e-9}

    def least(self, start: int, locked: int, cubes: Sequence[Cube], wanted: Sequence[set[int]]) -> float:
        """Returns the least cost from a state through a code of each set, in order; infinite if there is no way.

        Args:
            start: where the arm is.
            locked: mask of the actuators that keep their states.
            cubes: what no stage may touch.
            wanted: codes that serve each waypoint.
        """
        steps = self._steps(start & locked, locked, tuple(cubes))
        costs = np.where(self._codes == start, 0.0, np.inf)
        for serving in wanted:
            spread = np.minimum(costs, (costs[:, None] + steps).min(axis=0))
            while (spread != costs).any():
                costs, spread = spread, np.minimum(spread, (spread[:, None] + steps).min(axis=0))
            costs = np.where([code in serving for code in self.tips], spread, np.inf)
        return float(costs.min())

    def unreachable(self, wanted: Sequence[set[int]], start: int, locked: int) -> bool:
        """Returns whether some waypoint is served by no configuration with the present locks."""
        return any(all((code ^ start) & locked for code in serving) for serving in wanted)

    def _steps(self, states: int, locked: int, cubes: tuple[Cube, ...]) -> NDArray[np.float64]:
        """Returns the cost of one stage between all codes, shape (N, N); infinite if there is no such stage."""
        key = states, locked, cubes
        if key not in self._known:
            if len(self._known) > MOST_KNOWN:
                self._known.clear()
            codes, costs = self._codes, self._costs.copy()
            costs[(codes ^ states) & locked != 0] = np.inf
            costs[:, (codes ^ states) & locked != 0] = np.inf
            for cube in cubes:
                apart = (codes ^ cube.value) & cube.mask
                costs[(apart[:, None] & apart) == 0] = np.inf
            self._known[key] = costs
        return self._known[key]


def turn(first: float, second: float) -> float:
    """Returns the angle from the second orientation to the first, from -pi to pi [rad]."""
    return math.remainder(first - second, 2 * math.pi)

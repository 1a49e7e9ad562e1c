"""Whether actuators may switch together: no body touches anything, however far each of them is in mid-stroke."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from controller.obstacles.clearance import Clearance, balls
from controller.obstacles.distance import Array, Index
from controller.obstacles.strokes import strokes_of
from controller.obstacles.swept_check import CLEAR, TOUCHED, swept_check

States = NDArray[np.uint8]

SAMPLES = 64  # most configurations among a stage's that are looked at before all
BOXES = 512  # most boxes of strokes; a stage that they do not show to be clear is taken as if it touched


@dataclass(frozen=True)
class Touch:
    """What touches, or may.

    Attributes:
        module: the first.
        region: that it touches; -1 for none.
        other: module that it touches; -1 for none. If it touches neither, nobody knows where it is in mid-stroke.
    """

    module: int
    region: int = -1
    other: int = -1


class Sweep:
    """What an arm's bodies sweep while actuators switch.

    Args:
        clearance: of the arm.
    """

    def __init__(self, clearance: Clearance) -> None:
        self._clearance, arm = clearance, clearance.manipulator
        self._arm = arm
        counts = [len(module.actuators) for module in arm.modules]
        self._starts = np.cumsum([0, *counts])
        self._owners = np.repeat(np.arange(len(counts)), counts)
        self._flags = 1 << (np.arange(len(self._owners)) - self._starts[self._owners])
        self._states = [states_of(module.bits) for module in arm.modules]
        self._strokes = [strokes_of(module) for module in arm.modules]

    @property
    def proven(self) -> bool:
        """Whether what is said to be clear is proven: all modules have proven bounds, see Module.proven."""
        return all(module.proven for module in self._arm.modules)

    def touch(self, states: States, actuators: Index) -> Touch | None:
        """Returns what is touched, or may be, while actuators (k,) switch from states (A,) on; None: nothing.

        Any of them may be anywhere on its way, whatever the others do. That nothing is touched is proven, for modules
        that move as Module.motion says, if `proven`; otherwise it rests on samples, see Strokes.rates.
        """
        if self._clearance.free:
            return None
        return self._sampled(states, actuators) or self._swept(states, actuators)

    def standing(self, states: States) -> NDArray[np.bool_]:
        """Returns which of actuator states (n, A) touch anything, or are no configuration's, shape (n,)."""
        configurations = self._spelled(states)
        result = np.ones(len(states), dtype=bool)
        known = np.flatnonzero((configurations >= 0).all(axis=1))
        result[known] = self._clearance.blocked(configurations[known])
        return result

    def _spelled(self, states: States) -> Index:
        """Returns the configurations (n, B) of actuator states (n, A), -1 where a module has none."""
        parts = zip(self._states, self._starts[:-1], self._starts[1:], strict=True)
        return np.column_stack([known[states[:, a:b] @ self._flags[a:b]] for known, a, b in parts])

    def words(self, touch: Touch) -> str:
        """Returns what touches, as Clearance.where has it."""
        if touch.region >= 0:
            return f"module {touch.module + 1} is in {self._clearance.regions.names[touch.region]}"
        if touch.other >= 0:
            return f"modules {touch.other + 1} and {touch.module + 1} touch"
        return f"nobody knows where module {touch.module + 1} is in mid-stroke"

    def _sampled(self, states: States, actuators: Index) -> Touch | None:
        """Looks at configurations among those that the actuators may spell: all if there are few."""
        k = len(actuators)
        if 1 << k <= SAMPLES:
            chosen = np.arange(1 << k)[:, None] >> np.arange(k) & 1
        else:
            chosen = np.random.default_rng(k).integers(0, 2, (SAMPLES, k))
            chosen[0], chosen[1] = 0, 1
        subsets = np.tile(states, (len(chosen), 1))
        subsets[:, actuators] ^= chosen.astype(np.uint8)
        configurations = self._spelled(subsets)
        if configurations.min() < 0:
            return Touch(int(np.argmin(configurations.min(axis=0))))
        found = self._clearance.first_collisions(configurations)
        first = np.flatnonzero(found[:, 0] >= 0)
        return Touch(*found[first[0]].tolist()) if len(first) else None

    def _swept(self, states: States, actuators: Index) -> Touch | None:
        """Shows by bounds that nothing is touched: of all strokes, and where that does not do, of halves of them."""
        actuators, c = np.sort(actuators), self._clearance
        owners, rates = self._owners[actuators], np.empty((len(actuators), 3))
        modules = np.unique(owners)
        for i in modules:
            here = states[self._starts[i] : self._starts[i + 1]].astype(float)
            rates[owners == i] = self._strokes[i].rates(here, actuators[owners == i] - self._starts[i])
            if not np.isfinite(rates[owners == i]).all():
                return Touch(int(i))
        chain, left = self._chain(states), BOXES
        middles = halves = np.full((1, len(actuators)), 0.5)
        suspects = np.ones((1, len(self._arm.modules)), dtype=bool)
        while len(middles):
            left -= len(middles)
            parts = self._placed(chain, states, actuators, modules, middles)
            reports = np.full((len(middles), 3), -1)
            regions = c.regions.kinds, c.regions.axes, c.regions.centres, c.regions.sizes
            verdicts = swept_check(
                *parts, c.lines, owners, rates, halves, *regions, c.margin, c.apart, suspects, reports
            )
            touched, unclear = np.flatnonzero(verdicts == TOUCHED), np.flatnonzero(verdicts != CLEAR)
            if len(touched) or 2 * len(unclear) > left:
                return Touch(*reports[[*touched, *unclear][0]].tolist())
            middles, halves = halved(middles[unclear], halves[unclear], verdicts[unclear])
            suspects = np.concatenate([suspects[unclear]] * 2)
        return None

    def _chain(self, states: States) -> tuple[Array, Array, Array, Array]:
        """Returns rotations (B + 1, 3, 3), translations (B + 1, 3), bodies and balls (B, ...) at states (A,)."""
        arm, c = self._arm, self._clearance
        modules = np.arange(len(arm.modules))
        configuration = self._spelled(states[None])[0]
        frames = np.concatenate([arm.base[None], arm.frames[modules, configuration]])
        return frames[:, :3, :3], frames[:, :3, 3], c.bodies[modules, configuration], c.balls[modules, configuration]

    def _placed(
        self, chain: tuple[Array, Array, Array, Array], states: States, actuators: Index, modules: Index, middles: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Returns what `swept_check` wants of each box: the chain with actuators (k,) at strokes (n, k)."""
        n = len(middles)
        r, b, bodies, around = (np.repeat(part[None], n, axis=0) for part in chain)
        strokes = np.tile(states.astype(float), (n, 1))
        strokes[:, actuators] = middles
        for i in modules:
            frames, body = self._strokes[i].at(strokes[:, self._starts[i] : self._starts[i + 1]])
            r[:, i + 1], b[:, i + 1], bodies[:, i, : body.shape[1]] = frames[:, :3, :3], frames[:, :3, 3], body
            around[:, i] = balls(body)
        return r, b, bodies, around


def halved(middles: Array, halves: Array, strokes: Index) -> tuple[Array, Array]:
    """Returns middles and half sides (2 n, k) of the halves of boxes (n, k), each cut across one stroke (n,)."""
    rows, halves = np.arange(len(strokes)), halves.copy()
    halves[rows, strokes] /= 2
    step = np.zeros_like(halves)
    step[rows, strokes] = halves[rows, strokes]
    return np.concatenate([middles - step, middles + step]), np.concatenate([halves, halves])


@lru_cache(maxsize=16)
def sweep_of(clearance: Clearance) -> Sweep:
    """Returns the sweep of a clearance, the same for all that ask."""
    return Sweep(clearance)


def states_of(bits: States) -> Index:
    """Returns the state that each code spells, the first actuator the lowest digit; -1 where there is none, (2^A,)."""
    codes = bits @ (1 << np.arange(bits.shape[1]))
    states = np.full(1 << bits.shape[1], -1)
    states[codes[::-1]] = np.arange(len(bits))[::-1]
    return states

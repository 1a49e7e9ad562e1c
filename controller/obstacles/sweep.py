"""Collision checks of transitions: actuators may switch together if no body touches anything at any displacement."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.obstacles.clearance import BodyClearance, balls
from hyperbit.controller.obstacles.displacements import displacements_of
from hyperbit.controller.obstacles.distance import Array, Index
from hyperbit.controller.obstacles.swept_check import CLEAR, COLLIDING, Chains, Switching, swept_check

States = NDArray[np.uint8]

SAMPLES = 64  # most configurations of a stage to check before the sweep
BOXES = 512  # most boxes of displacements; without a proof the stage counts as a collision


@dataclass(frozen=True)
class Collision:
    """A collision, or one that the check cannot exclude."""

    module: int  # the first module
    obstacle: int = -1  # the obstacle that it touches; -1 for none
    other: int = -1  # the module that it touches; -1 for none. If both are -1, its position in mid-travel is unknown.


class Sweep:
    """Collision checks of the lowest modules of an arm, or of all, while actuators switch.

    States are those of the actuators of these modules.
    """

    def __init__(self, clearance: BodyClearance, modules: int | None = None) -> None:
        self._clearance, self._arm = clearance, clearance.manipulator
        self._modules = self._arm.modules[:modules]
        counts = [len(module.actuators) for module in self._modules]
        self._starts = np.cumsum([0, *counts])
        self._owners = np.repeat(np.arange(len(counts)), counts)
        self._weights = np.zeros((len(self._owners), len(counts)))  # weight of an actuator's state in its module's code
        actuators = np.arange(len(self._owners))
        self._weights[actuators, self._owners] = 1 << (actuators - self._starts[self._owners])
        known = [states_of(module.bits) for module in self._modules]
        self._known, self._tables = np.concatenate(known), np.cumsum([0, *map(len, known[:-1])])
        self._displacements = [displacements_of(module) for module in self._modules]

    @property
    def proven(self) -> bool:
        """Whether "clear" is a proof: all modules have proven bounds, see Module.proven."""
        return all(module.proven for module in self._modules)

    def first_collision(self, states: States, actuators: Index) -> Collision | None:
        """Returns a possible collision while actuators (k,) switch from states (A,); None if the transition is clear.

        Each actuator may be at any displacement, independently of the others. "Clear" is proven if `proven`, for
        modules that move according to Module.motion. Otherwise it relies on samples, see Displacements.rates.
        """
        if self._clearance.free:
            return None
        return self._sampled(states, actuators) or self._swept(states, actuators)

    def _spelled(self, states: States) -> Index:
        """Returns the configurations (n, B) of actuator states (n, A); -1 for a module without such a state."""
        codes = states.astype(np.float64) @ self._weights  # exact, and faster than integers
        return np.asarray(self._known[self._tables + codes.astype(np.int64)])

    def describe(self, collision: Collision) -> str:
        """Returns a collision as a sentence, like BodyClearance.where."""
        if collision.obstacle >= 0:
            return f"module {collision.module + 1} is in {self._clearance.obstacles.names[collision.obstacle]}"
        if collision.other >= 0:
            return f"modules {collision.other + 1} and {collision.module + 1} touch"
        return f"the position of module {collision.module + 1} in mid-travel is unknown"

    def _sampled(self, states: States, actuators: Index) -> Collision | None:
        """Checks the configurations that the switching actuators pass: all of them, or SAMPLES at random."""
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
            return Collision(int(np.argmin(configurations.min(axis=0))))
        found = self._clearance.first_collisions(configurations)
        first = np.flatnonzero(found[:, 0] >= 0)
        return Collision(*found[first[0]].tolist()) if len(first) else None

    def _swept(self, states: States, actuators: Index) -> Collision | None:
        """Proves by bounds that the transition is clear, for boxes of displacements that are halved as needed."""
        actuators = np.sort(actuators)
        owners, rates = self._owners[actuators], np.empty((len(actuators), 3))
        modules = np.unique(owners)
        for i in modules:
            here = states[self._starts[i] : self._starts[i + 1]].astype(float)
            rates[owners == i] = self._displacements[i].rates(here, actuators[owners == i] - self._starts[i])
            if not np.isfinite(rates[owners == i]).all():
                return Collision(int(i))
        chain, boxes = self._chain(states), BOXES
        middles = half_widths = np.full((1, len(actuators)), 0.5)
        suspects = np.ones((1, len(self._modules)), dtype=bool)
        while len(middles):
            boxes -= len(middles)
            chains = self._placed(chain, states, actuators, modules, middles)
            reports = np.full((len(middles), 3), -1)
            switching = Switching(owners, rates, half_widths)
            verdicts = swept_check(chains, switching, self._clearance.surroundings, suspects, reports)
            colliding, unclear = np.flatnonzero(verdicts == COLLIDING), np.flatnonzero(verdicts != CLEAR)
            if len(colliding) or 2 * len(unclear) > boxes:
                return Collision(*reports[[*colliding, *unclear][0]].tolist())
            middles, half_widths = cut(middles[unclear], half_widths[unclear], verdicts[unclear])
            suspects = np.concatenate([suspects[unclear]] * 2)
        return None

    def _chain(self, states: States) -> tuple[Array, Array, Array, Array]:
        """Returns rotations (B + 1, 3, 3), translations (B + 1, 3), bodies and balls (B, ...) at states (A,)."""
        arm, c = self._arm, self._clearance
        modules = np.arange(len(self._modules))
        configuration = self._spelled(states[None])[0]
        frames = np.concatenate([arm.base[None], arm.frames[modules, configuration]])
        return frames[:, :3, :3], frames[:, :3, 3], c.bodies[modules, configuration], c.balls[modules, configuration]

    def _placed(
        self, chain: tuple[Array, Array, Array, Array], states: States, actuators: Index, modules: Index, middles: Array
    ) -> Chains:
        """Returns the chain (see _chain) of each box, with actuators (k,) at displacements (n, k)."""
        n = len(middles)
        r, b, bodies, around = (np.repeat(part[None], n, axis=0) for part in chain)
        displacements = np.tile(states.astype(float), (n, 1))
        displacements[:, actuators] = middles
        for i in modules:
            frames, body = self._displacements[i].at(displacements[:, self._starts[i] : self._starts[i + 1]])
            r[:, i + 1], b[:, i + 1], bodies[:, i, : body.shape[1]] = frames[:, :3, :3], frames[:, :3, 3], body
            around[:, i] = balls(body)
        return Chains(r, b, bodies, around, self._clearance.lines[: len(self._modules)])


def cut(middles: Array, half_widths: Array, axes: Index) -> tuple[Array, Array]:
    """Returns middles and half widths (2 n, k) of the two parts of boxes (n, k), each cut along one axis (n,)."""
    rows, half_widths = np.arange(len(axes)), half_widths.copy()
    half_widths[rows, axes] /= 2
    step = np.zeros_like(half_widths)
    step[rows, axes] = half_widths[rows, axes]
    return np.concatenate([middles - step, middles + step]), np.concatenate([half_widths, half_widths])


@lru_cache(maxsize=16)
def sweep_of(clearance: BodyClearance) -> Sweep:
    return Sweep(clearance)


def states_of(bits: States) -> Index:
    """Returns the state of each actuator code (2^A,), or -1; the first actuator is the lowest bit."""
    codes = bits @ (1 << np.arange(bits.shape[1]))
    states = np.full(1 << bits.shape[1], -1)
    states[codes[::-1]] = np.arange(len(bits))[::-1]
    return states

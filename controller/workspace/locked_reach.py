"""Reach and redundancy of an arm with locked actuators, by the Mapping Algorithm.

All arms are mapped with the same grid of pixels in the base frame, so that they compare pixel by pixel. A locked
actuator changes only the intermediate workspaces below its module. The others are mapped once for all choices.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.locked import LockedStates, lock_actuators, none_locked
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.studies.shares import Run, Spread, alone
from hyperbit.controller.workspace.coverage import quantile
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.mapping import Level, below, coarsened, tip_level

Array = NDArray[np.float64]

SHARE = 8  # choices of a share
PIXELS = {2: 1 << 16, 3: 1 << 17}  # most pixels of the box of W_0, by dimension


class Reach(NamedTuple):
    """Reach and redundancy of one arm."""

    locked: LockedStates  # state in which each actuator is locked, -1 if it is free, shape (A,)
    # area or volume of the pixels that contain a tip. It depends on the pixel, so compare it with the free arm's only.
    reach: float
    # expected area or volume of the positions with a configuration within the tolerance, if the tips in a pixel are
    # spread at random over it
    covered: float
    # log10 of the expected number of configurations within the tolerance of a position: the median over the area that
    # the free arm covers; minus infinity if more than half of it is lost
    log10_redundancy: float


class LockedReach(NamedTuple):
    """Reach of the free arm and of the arm with each choice of locked actuators."""

    free: Reach  # reach of the free arm
    choices: tuple[Reach, ...]  # reach for each choice of locked actuators and states
    every: bool  # whether `choices` has all choices, not a sample
    impossible: int  # number of choices that leave a module without a state
    pixel: float  # side of the pixels
    reference: Array  # centre (x, y, z) of the first pixel in the base frame
    # ln of the number of configurations of the free arm within the tolerance of each pixel; minus infinity if there are
    # none, shape (z, y, x)
    free_counts: Array
    least_counts: Array  # the least over all choices, shape (z, y, x)

    def worst(self, figure: str) -> Reach:
        """Returns the choice with the least `reach`, `covered` or `log10_redundancy`."""
        return min(self.choices, key=lambda choice: float(getattr(choice, figure)))

    def mean(self, figure: str) -> float:
        """Returns the mean of `reach`, `covered` or `log10_redundancy` over all choices."""
        return float(np.mean([getattr(choice, figure) for choice in self.choices]))


class LockChoices(NamedTuple):
    """Choices of locked actuators."""

    actuators: int  # number of actuators to lock, at least 1
    samples: int  # most choices if more than one actuator is locked; for one all choices are tried
    seed: int = 0  # of the random choices


class FreeArm(NamedTuple):
    """The intermediate workspaces of the free arm, and its numbers of configurations."""

    levels: list[Level]  # intermediate workspaces, base first; the first is the whole arm's
    most: int  # most pixels of each level
    ball: float  # ln of the pixels in a ball of the tolerance
    volume: float  # of a pixel
    counts: Array  # ln of the number of configurations within the tolerance of each pixel, shape (z, y, x)

    def reach(self, locked: LockedStates, counts: Array) -> Reach:
        """Returns the reach of an arm from the ln of its numbers of configurations within the tolerance."""
        redundancy = quantile(counts.ravel(), covered_share(self.counts).ravel(), 0.5) / math.log(10)
        reach, covered = np.isfinite(counts).sum() * self.volume, covered_share(counts).sum() * self.volume
        return Reach(locked, float(reach), float(covered), redundancy)

    def counts_of(self, reduced: Manipulator, last: int) -> Array:
        """Returns the counts of an arm whose last module with a locked actuator is `last`."""
        level = self.levels[last + 1]
        for i in reversed(range(last + 1)):
            level = below(level, reduced, i, self.most)
        return log_counts(level, self.levels[0]) + self.ball


def covered_share(counts: Array) -> Array:
    """Returns the shares of pixels that are covered, from ln of the expected numbers of configurations.

    The tips in a pixel are taken as a Poisson process: a position has none with probability exp(-expected).
    """
    return np.asarray(-np.expm1(-np.exp(np.minimum(counts, 9.0))))


class ChoiceReach(NamedTuple):
    reach: Reach | None  # None if the choice leaves a module without a state
    least: Array | None  # only with the last choice of a share: the least counts over the share, see `LockedReach`


class LocksJob(NamedTuple):
    """Maps an arm with locked actuators; constant for all choices."""

    manipulator: Manipulator  # the free arm
    low: Array  # lower corner of its workspace in the densities
    high: Array  # upper corner
    pixel: float  # of the densities
    tolerance: float  # see `reach_when_locked`

    def prepare(self) -> Run:
        """Maps the free arm; returns a function that maps the choices (A,) of a share."""
        free = free_arm(self)

        def run(share: list[LockedStates]) -> Iterator[ChoiceReach]:
            least = free.counts.copy()
            for number, locked in enumerate(share, 1):
                reach = None
                with suppress(ValueError):  # the choice leaves a module without a state
                    reduced = lock_actuators(self.manipulator, locked)
                    counts = free.counts_of(reduced, last_locked(self.manipulator, locked))
                    reach = free.reach(locked, counts)
                    np.minimum(least, counts, out=least)
                yield ChoiceReach(reach, least if number == len(share) else None)

        return run


def free_arm(job: LocksJob) -> FreeArm:
    manipulator, low, high, finest, tolerance = job
    most, dimension = PIXELS[manipulator.dimension], manipulator.dimension
    pixel = coarsened(finest, low, high, most, dimension)
    levels = [tip_level(pixel)]
    for i in reversed(range(len(manipulator.modules))):
        levels.append(below(levels[-1], manipulator, i, 2 * most))
    levels.reverse()
    volume = levels[0].pixel ** dimension
    measure = math.pi * tolerance**2 if manipulator.planar else 4 / 3 * math.pi * tolerance**3
    ball = math.log(measure / volume)
    return FreeArm(levels, 2 * most, ball, volume, log_counts(levels[0], levels[0]) + ball)


def reach_when_locked(
    manipulator: Manipulator,
    densities: Densities,
    tolerance: float,
    locks: LockChoices,
    spread: Spread = alone,
) -> LockedReach:
    """Returns reach and redundancy over choices of locked actuators, which `spread` maps.

    The box of the workspace is that of the densities; `tolerance` is the greatest distance of the tip from a goal.
    Raises ValueError if the arm has fewer actuators with two states.
    """
    chosen, every = choices(manipulator, *locks)
    job = LocksJob(manipulator, *densities.box(0), float(densities.pixels[0]), tolerance)
    free, shares = free_arm(job), [chosen[k : k + SHARE] for k in range(0, len(chosen), SHARE)]
    found, least = list[Reach](), free.counts.copy()
    for one in spread(job, shares):
        if one.reach is not None:
            found.append(one.reach)
        if one.least is not None:
            np.minimum(least, one.least, out=least)
    impossible = len(chosen) - len(found)
    if not found:
        raise ValueError(f"no choice of {locks.actuators} locked actuators leaves each module a state")
    nothing_locked, whole = free.reach(none_locked(manipulator), free.counts), free.levels[0]
    pixel, reference = whole.pixel, whole.reference
    return LockedReach(nothing_locked, tuple(found), every, impossible, pixel, reference, free.counts, least)


def choices(manipulator: Manipulator, locks: int, samples: int, seed: int) -> tuple[list[LockedStates], bool]:
    """Returns choices of locked states, each (A,), and whether these are all. Raises ValueError for too many locks."""
    rows = [module.bits for module in manipulator.modules]
    moving = np.flatnonzero(np.concatenate([bits.min(axis=0) < bits.max(axis=0) for bits in rows])).tolist()
    if not 1 <= locks <= len(moving):
        raise ValueError(f"1 to {len(moving)} actuators can be locked, not {locks}")

    def locked(actuators: tuple[int, ...], states: tuple[int, ...]) -> LockedStates:
        held = none_locked(manipulator)
        held[list(actuators)] = states
        return held

    every = math.comb(len(moving), locks) << locks
    if locks == 1 or every <= samples:
        pairs = product(combinations(moving, locks), product((0, 1), repeat=locks))
        return [locked(actuators, states) for actuators, states in pairs], True
    drawn = set[tuple[tuple[int, ...], tuple[int, ...]]]()
    for actuators, states in random_choices(moving, locks, seed):
        drawn.add((actuators, states))
        if len(drawn) == samples:
            break
    return [locked(*choice) for choice in sorted(drawn)], False


def random_choices(moving: list[int], locks: int, seed: int) -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Yields random actuators in ascending order, with random states."""
    random = np.random.default_rng(seed)
    while True:
        actuators = np.sort(random.choice(moving, locks, replace=False))
        yield tuple(actuators.tolist()), tuple(random.integers(0, 2, locks).tolist())


def last_locked(manipulator: Manipulator, locked: LockedStates) -> int:
    owners = np.repeat(np.arange(len(manipulator.modules)), [len(m.actuators) for m in manipulator.modules])
    return int(owners[locked >= 0].max())


def log_counts(level: Level, whole: Level) -> Array:
    """Returns ln of the counts of a level in the pixels (z, y, x) of `whole`; minus infinity for a count of 0."""
    result = np.full(whole.counts.shape, -math.inf)
    shift = np.round((level.reference - whole.reference) / whole.pixel).astype(int)[::-1]
    first, last = np.maximum(shift, 0), np.minimum(shift + level.counts.shape, result.shape)
    if (first < last).all():
        own = tuple(slice(a, b) for a, b in zip(first - shift, last - shift, strict=True))
        place = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
        with np.errstate(divide="ignore"):
            result[place] = np.log(level.counts[own]) + level.exponent * math.log(2.0)
    return result

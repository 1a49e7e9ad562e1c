"""Densities with orientation side by side: with the enumeration of all configurations, and with each other."""

import math
from functools import reduce

import numpy as np
from scipy.stats import spearmanr

from controller.manipulator.manipulator import Manipulator
from controller.workspace.convolution import PlanarDensity, scatter
from controller.workspace.oriented import OrientedDensities
from controller.workspace.spatial_convolution import SpatialDensity
from tests.arms import every_configuration


def exact_counts(manipulator: Manipulator, densities: OrientedDensities) -> tuple[np.ndarray, np.ndarray]:
    """Counts of the whole arm's pixels, enumerated and mapped, for every pixel that has either."""
    keys, enumerated = np.unique(
        densities.keys_of(0, manipulator.tips(every_configuration(manipulator))), return_counts=True
    )
    own = densities.keys[: densities.offsets[1]]
    union = np.union1d(keys, own)
    exact, mapped = np.zeros(len(union)), np.zeros(len(union))
    exact[np.searchsorted(union, keys)] = enumerated
    mapped[np.searchsorted(union, own)] = np.exp(densities.level(0).astype(float))
    return exact, mapped


def rank_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Spearman's, over what is positive in either."""
    either = (first > 0) | (second > 0)
    return float(spearmanr(first[either], second[either]).statistic)


def total_variation(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.abs(first - second).sum() / 2)


def smoothed(points: np.ndarray, shares: np.ndarray, pixel: float, turns: int, reach: float) -> np.ndarray:
    """Points (x, y, angle) spread over a grid of its own, the same for all densities, shape (turns, n, n)."""
    half = math.ceil(reach / pixel) + 2
    grid = np.zeros((turns, 2 * half + 1, 2 * half + 1))
    scatter(np.ascontiguousarray(points), shares / shares.sum(), grid, np.full(2, -half * pixel), pixel)
    return grid


def convolved_points(density: PlanarDensity) -> tuple[np.ndarray, np.ndarray]:
    t, y, x = np.nonzero(density.shares)
    positions = density.reference + density.pixel * np.column_stack((x, y))
    return np.column_stack((positions, 2 * math.pi * t / len(density.shares))), density.shares[t, y, x]


def mapped_points(densities: OrientedDensities) -> tuple[np.ndarray, np.ndarray]:
    values = densities.level(0).astype(float)
    centres, cells = densities.cells(0)
    points = np.column_stack((centres[:, :2], 2 * math.pi * cells / densities.turns[0]))
    return points, np.exp(values - values.max())


def enumerated_points(manipulator: Manipulator) -> tuple[np.ndarray, np.ndarray]:
    tips = manipulator.tips(every_configuration(manipulator))
    return np.column_stack((tips[:, :2, 3], np.arctan2(tips[:, 1, 0], tips[:, 0, 0]))), np.ones(len(tips))


def spatial_points(density: SpatialDensity) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) of the pixels and the shares of all rotations there."""
    shares = density.shares.sum(axis=0)
    places = np.argwhere(shares != 0)
    return density.pixel * (places[:, ::-1] - len(shares) // 2), shares[tuple(places.T)]


def mapped_positions(densities: OrientedDensities) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) of the whole arm's pixels and what is in them, up to a factor."""
    values = densities.level(0).astype(float)
    return densities.cells(0)[0], np.exp(values - values.max())


def drawn_points(manipulator: Manipulator, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) of the tip in random configurations, the same weight for each."""
    drawn = np.random.default_rng(5).integers(0, manipulator.states, (number, len(manipulator.states)))
    return manipulator.tips(drawn)[:, :3, 3], np.ones(number)


def placed(points: np.ndarray, shares: np.ndarray, pixel: float, reach: float) -> np.ndarray:
    """Positions (n, 3) spread over a grid of its own, the same for all densities, each among the eight around it."""
    half = math.ceil(reach / pixel) + 2
    grid = np.zeros((2 * half + 2,) * 3)
    places = np.clip(points / pixel, -half, half) + half
    first = np.floor(places).astype(int)
    for corner in np.ndindex(2, 2, 2):
        parts = np.abs(1 - np.array(corner) - (places - first)).prod(axis=1)
        np.add.at(grid, tuple((first + corner).T), parts * shares / shares.sum())
    return grid


def second_moment(manipulator: Manipulator) -> float:
    """The mean square of the tip's distance from the base: means of products are products of means."""
    squared = [np.mean([np.kron(f, f) for f in module.frames], axis=0) for module in manipulator.modules]
    return float(np.trace(reduce(np.matmul, squared)[:, -1].reshape(4, 4)[:3, :3]))

"""Area or volume that an arm covers within a radius, and the number of configurations over it.

A position is covered if the tip of at least one configuration is within the radius: the covered set is the union of
balls about all tips. Positions are drawn in two ways: uniformly in cells around the workspace, which suits a dense
arm, and in the ball of a random tip (Karp and Luby 1983), which suits a sparse arm. Each position counts with the
inverse of its density under both ways together (the balance heuristic, Veach and Guibas 1995). So the expected area is
the true one for any pixels; pixels only decide how many positions are needed.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.manipulator.frames import inverse
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.studies.shares import Run, Spread, alone
from hyperbit.controller.workspace.cache import default_directory, load_or_map
from hyperbit.controller.workspace.densities import Densities, ball
from hyperbit.controller.workspace.nearby_counts import CountMethod, NearbyCounts

Array = NDArray[np.float64]

LEAST, MOST = 512, 1 << 15  # positions
WORK = {"listing": 1 << 15, "halves": 1 << 26, "draws": 1 << 19}  # about: most positions times compared configurations
TESTS = 2e9  # about: most distances to compute
PART = {"listing": 4096, "halves": 1024, "draws": 16}  # positions that are counted together, with their own seed
PILOT = 64  # positions that estimate the distances to compute


class Range(NamedTuple):
    """An estimate between two limits: two standard errors on both sides, and the positions that draws cannot decide."""

    lower: float
    middle: float
    upper: float


class Coverage(NamedTuple):
    """Where the tip can be within a radius, and by how many configurations."""

    method: CountMethod  # how configurations near a position were counted, see NearbyCounts
    positions: int  # number of positions drawn
    log10_configurations: float  # log10 of the number of all configurations
    area: Range  # area (planar) or volume of the positions with at least one configuration's tip within the radius
    log10_median: Range  # log10 of the median number of configurations within the radius, over that area
    log10_greatest: float  # log10 of the greatest number found at a drawn position
    densest: Array  # that position in the world, shape (dimension,)


class WorkspaceCells(NamedTuple):
    """Cells that contain the workspace, each no smaller than the radius."""

    # by the densities: ln of the number of configurations in each cell, minus infinity for none, shape (z, y, x)
    logs: Array
    near: NDArray[np.bool_]  # whether a cell or a neighbour has configurations, shape (z, y, x)
    corner: Array  # least corner (x, y, z) of the first cell, shape (3,)
    side: Array  # of a cell; 0 along z for planar arms, shape (3,)
    size: float  # area or volume of all cells in `near`

    def draw(self, count: int, random: np.random.Generator) -> Array:
        """Returns positions (count, 3) in frame F_0, uniform in the cells in `near`."""
        cells = np.argwhere(self.near)[:, ::-1]
        chosen = cells[random.integers(0, len(cells), count)]
        return np.asarray(self.corner + self.side * (chosen + random.random((count, 3))))

    def at(self, points: Array) -> tuple[NDArray[np.bool_], Array]:
        """Returns `near` and `logs` of the cells of points (n, 3), shape (n,) each."""
        with np.errstate(invalid="ignore", divide="ignore"):
            place = np.where(self.side > 0, np.floor((points - self.corner) / self.side), 0.0)[:, ::-1]
        inside = np.asarray(((place >= 0) & (place < self.near.shape)).all(axis=1))
        index = tuple(np.where(inside[:, None], place, 0).astype(np.int64).T)
        return inside & self.near[index], np.where(inside, self.logs[index], -math.inf)


class PositionPart(NamedTuple):
    """Positions (n, 3) in frame F_0 that are counted together, and the seed of their random numbers."""

    points: Array
    seed: tuple[int, int]


class CountJob(NamedTuple):
    """Counts configurations near positions; constant for all parts."""

    manipulator: Manipulator  # of the densities, which are in the cache or are mapped
    pixel: float  # of the densities
    level_pixels: int  # of the densities
    radius: float  # see `coverage_of`

    def prepare(self) -> Run:
        """Lists tips; returns a function that counts the configurations near a part's positions."""
        densities = load_or_map(self.manipulator, self.pixel, self.level_pixels, default_directory())
        return CountHere(NearbyCounts(self.manipulator, densities, self.radius)).prepare()


class CountHere(NamedTuple):
    counts: NearbyCounts

    def prepare(self) -> Run:
        return self._run

    def _run(self, part: PositionPart) -> Iterator[Array]:
        yield self.counts.logs(part.points, np.random.default_rng(part.seed))


def coverage_of(
    manipulator: Manipulator,
    densities: Densities,
    radius: float,
    *,
    positions: int | None = None,
    seed: int = 0,
    spread: Spread = alone,
    job: CountJob | None = None,
) -> Coverage:
    """Returns where the tip can be within a radius, and by how many configurations.

    Arms of up to 2^21 configurations are listed; the only error is that of the drawn positions, about 1 %. Without a
    given number of positions, the number depends on the cost of a position. `spread` counts the parts of the positions:
    with `job` in other processes, as densities are too large to be sent; None: this process counts.
    """
    random, size = np.random.default_rng(seed), manipulator.dimension
    counts = NearbyCounts(manipulator, densities, radius)
    around = workspace_cells(densities, radius, size)
    half = (positions or affordable(manipulator, counts, radius, random) + 1) // 2
    points = np.concatenate((around.draw(half, random), near_tips(manipulator, radius, half, random)))
    step = PART[counts.method]
    parts = [PositionPart(points[k : k + step], (seed, k)) for k in range(0, len(points), step)]
    logs = np.concatenate(list(spread(job or CountHere(counts), parts)))
    logs_of_all = float(np.log(manipulator.states).sum())
    log_ball = math.log(ball(size, radius))
    near, cell_logs = around.at(points)
    log_expected = cell_logs + log_ball - float(np.log(around.side[:size]).sum())

    def areas(of: Array) -> Array:
        """Returns the area that each position stands for, from ln of its number of configurations."""
        return np.asarray(2.0 / (near / around.size + np.exp(of - logs_of_all - log_ball)))

    certain = np.arange(len(points)) >= half  # the tip of a configuration is known to be near
    if counts.method != "draws":
        logs[certain] = np.maximum(logs[certain], 0.0)  # against rounding
        log_expected, certain = np.full(len(points), -math.inf), np.zeros(len(points), dtype=bool)
    missed, expected = ~np.isfinite(logs), np.exp(np.minimum(log_expected, 9.0))
    guess = np.where(missed, np.maximum(log_expected, 0.0), logs)
    lower = np.where(missed, 0.0, areas(guess))
    middle = np.where(missed, np.where(certain, 1.0, -np.expm1(-expected)), 1.0) * areas(guess)
    upper = np.where(missed, np.where(certain, 1.0, np.minimum(expected, 1.0)) * areas(np.zeros(len(points))), lower)
    greatest = int(logs.argmax())
    return Coverage(
        method=counts.method,
        positions=len(points),
        log10_configurations=logs_of_all / math.log(10),
        area=Range(max(mean(lower, -2.0), 0.0), mean(middle), mean(upper, 2.0)),
        log10_median=Range(
            min(median(np.where(missed, 0.0, logs), upper, -1.0), median(guess, middle)),
            median(guess, middle),
            max(median(guess, lower, 1.0), median(guess, middle)),
        ),
        log10_greatest=float(logs[greatest]) / math.log(10),
        densest=(manipulator.base @ np.append(points[greatest], 1.0))[:size],
    )


def mean(weights: Array, errors: float = 0.0) -> float:
    """Returns the mean of weights (n,) plus some standard errors; each half is drawn in its own way."""
    half = len(weights) // 2
    error = math.sqrt(0.5 * (weights[:half].var() + weights[half:].var()) / len(weights))
    return float(weights.mean()) + errors * error


def workspace_cells(densities: Densities, radius: float, dimension: int) -> WorkspaceCells:
    """Returns cells of whole pixels around the workspace."""
    from scipy.ndimage import binary_dilation  # imported here: a planner with cached densities saves 5 MiB

    level, pixel = densities.level(0), float(densities.pixels[0])
    together = max(math.ceil(radius / pixel), 1)
    margin = np.array([dimension == 3, True, True])
    logs = np.full((np.array(level.shape) - 1) // together + 1 + 2 * margin, -math.inf)
    pixels = np.argwhere(level >= 0)
    np.logaddexp.at(logs, tuple((pixels // together + margin).T), level[tuple(pixels.T)].astype(float))
    near = binary_dilation(np.isfinite(logs), np.ones(1 + 2 * margin))
    side = together * pixel * margin[::-1].astype(float) if dimension == 2 else np.full(3, together * pixel)
    corner = densities.references[0] - np.where(side > 0, pixel / 2, 0.0) - side * margin[::-1]
    return WorkspaceCells(logs, near, corner, side, float(near.sum() * (together * pixel) ** dimension))


def affordable(manipulator: Manipulator, counts: NearbyCounts, radius: float, random: np.random.Generator) -> int:
    """Returns the number of positions to draw, by the cost of a few."""
    counts.logs(near_tips(manipulator, radius, PILOT, random), random)
    most = min(WORK[counts.method] // counts.compared, int(TESTS * PILOT / (counts.tests + 1)))
    return min(max(most, LEAST), MOST)


def near_tips(manipulator: Manipulator, radius: float, count: int, random: np.random.Generator) -> Array:
    """Returns positions (count, 3) in frame F_0, each uniform in the ball about the tip of a random configuration."""
    size = manipulator.dimension
    states = random.integers(0, manipulator.states, (count, len(manipulator.modules)))
    points = (inverse(manipulator.base) @ manipulator.tips(states))[:, :3, 3]
    away = random.normal(size=(count, size))
    away *= radius * random.random((count, 1)) ** (1 / size) / np.linalg.norm(away, axis=1, keepdims=True)
    points[:, :size] += away
    return np.asarray(points)


def median(logs: Array, weights: Array, errors: float = 0.0) -> float:
    """Returns log10 of the weighted median of numbers, from their ln (n,), plus about twice some standard errors."""
    effective = weights.sum() ** 2 / max((weights**2).sum(), 1e-300)
    margin = min(1.0 / math.sqrt(max(effective, 1.0)), 0.5)
    return quantile(logs, weights, 0.5 + errors * margin) / math.log(10)


def quantile(values: Array, weights: Array, share: float) -> float:
    """Returns the least value (n,) such that values up to it have a share of the weights (n,)."""
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order[min(int(np.searchsorted(sums, share * sums[-1])), len(values) - 1)]])

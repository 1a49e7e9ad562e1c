"""Trajectories: the goal's waypoints and, if straight lines are followed, points between them.

Each line is divided into parts. The target moves by one part from one point to the next. A tip that is close enough to
the middle of a part is close enough to all of the part.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal, leg

if TYPE_CHECKING:  # its kernels take a second to import; clients that only decode messages need not wait
    from hyperbit.controller.motion.stages.pacing import Pace

MOST_POINTS = 10_000  # of a trajectory
FINEST, COARSEST = 4, 2  # parts a path tolerance of length: if there is time, and at least

Array = NDArray[np.float64]

IDENTITY = np.eye(3)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A goal that has passed all checks, as points ordered by time."""

    stamp: float | None  # UNIX seconds of t = 0; None: when the executor accepts the program
    times: Array  # t at which the tip must have settled, shape (n,), increasing [s]
    positions: Array  # of the tip in the world, shape (n, dimension); between waypoints the middle of a line's part
    tolerances: Array  # greatest distances of the tip from the positions, shape (n,)
    rotations: Array  # of the tip in the world, shape (n, 3, 3); ignored where `turns` is infinite
    turns: Array  # tolerances of the orientations, shape (n,) [rad]; infinite where any orientation serves
    waypoints: NDArray[np.int64]  # indices of the goal's own points, shape (m,), ascending; the last point is one
    # greatest distance of a settled tip from the moving target; None: no lines are followed
    path_tolerance: float | None = None
    # tip bias by which the positions are corrected, shape (dimension,); None: there is no tracker
    bias: Array | None = None
    # actuator states (A,) of points given as configurations; the positions of these points are their tips
    fixed: Mapping[int, NDArray[np.uint8]] = field(default_factory=dict)

    def corrected(self, bias: Array | None) -> Trajectory:
        """Returns the trajectory for computed tips, given the tip bias (dimension,).

        The positions of points given as configurations are not corrected.
        """
        if bias is None:
            return self
        positions = self.positions - bias
        if self.fixed:
            positions[list(self.fixed)] = self.positions[list(self.fixed)]
        return replace(self, positions=positions, bias=bias)

    def goal(self, point: int) -> Array:
        """Returns a point's position (dimension,), or its frame (4, 4) if the orientation matters."""
        position: Array = self.positions[point]
        if self.turns[point] == np.inf:
            return position
        frame = np.eye(4)
        frame[: len(position), 3], frame[:3, :3] = position, self.rotations[point]
        return frame

    def between(self, point: int) -> bool:
        return len(self.waypoints) < len(self.times) and int(self.waypoints[self.next(point)]) != point

    def next(self, point: int) -> int:
        """Returns the number of the first waypoint at or after a point."""
        return int(np.searchsorted(self.waypoints, point))

    def last(self, point: int) -> int:
        """Returns the number of the last waypoint at or before a point; -1 before the first."""
        return int(np.searchsorted(self.waypoints, point, side="right")) - 1


def through(
    times: Array,
    positions: Array,
    tolerance: float,
    stamp: float | None = None,
    rotations: Array | None = None,
    turns: Array | None = None,
) -> Trajectory:
    """Returns the trajectory through waypoints (m, dimension), with free movement between them; see Trajectory."""
    if rotations is None or turns is None:
        rotations, turns = unoriented(len(times))
    return Trajectory(stamp, times, positions, np.full(len(times), tolerance), rotations, turns, np.arange(len(times)))


def unoriented(count: int) -> tuple[Array, Array]:
    """Returns rotations and turns of `count` points at which any orientation serves."""
    rotations = np.empty((count, 3, 3))
    rotations[:] = IDENTITY
    return rotations, np.full(count, np.inf)


def along(
    times: Array, positions: Array, tolerance: float, path_tolerance: float, pace: Pace, stamp: float | None = None
) -> Trajectory:
    """Returns the trajectory along the straight lines between waypoints, with points between them.

    The target moves along each line at constant speed. A configuration may change at each point. If its tip is within
    the point's tolerance, it stays within the path tolerance of the target until the next point's time. Waypoints have
    times (m,) [s], positions (m, dimension) and a tolerance of their own; `stamp` is t = 0 [UNIX s].

    Raises:
        Refusal: a line is too fast, or the lines are too long, for the path tolerance.
    """
    lengths, durations = np.linalg.norm(np.diff(positions, axis=0), axis=1), np.diff(times)
    parts = parts_of_lines(lengths, durations, path_tolerance, pace)
    lines = list(zip(times, positions, durations, np.diff(positions, axis=0), parts.astype(int), strict=False))
    steps = np.append(lengths / parts, 0.0)
    return Trajectory(
        stamp,
        np.concatenate([t + duration * np.arange(n) / n for t, _, duration, _, n in lines] + [times[-1:]]),
        np.concatenate([p + np.outer(middles(n), way) for _, p, _, way, n in lines] + [positions[-1:]]),
        np.concatenate(
            [
                [min(tolerance, path_tolerance - step), *[path_tolerance - step / 2] * (n - 1)]
                for step, n in zip(steps, [*parts.astype(int), 1], strict=True)
            ]
        ),
        *unoriented(int(parts.sum()) + 1),
        np.concatenate([[0], np.cumsum(parts)]).astype(np.int64),
        path_tolerance,
    )


def parts_of_lines(lengths: Array, durations: Array, path_tolerance: float, pace: Pace) -> Array:
    """Returns the number of parts into which each line is divided, from lengths and durations [s], all (m - 1,).

    Raises:
        Refusal: a line is too fast, or the lines are too long, for the path tolerance.
    """
    fewest = count_parts(lengths, path_tolerance / COARSEST)
    if fewest.sum() + 1 > MOST_POINTS:
        least = COARSEST * lengths.sum() / max(MOST_POINTS - len(lengths) - 1, 1)
        raise Refusal(
            Reason.TOO_MANY_POINTS,
            tolerance=path_tolerance,
            count=float(fewest.sum() + 1),
            length=f"{lengths.sum():.3g}",
            most=MOST_POINTS,
            enough=upwards(least),
        )
    needed = pace.shortest * fewest
    if (durations < needed - 1e-9).any():
        k = int(np.argmax(durations < needed - 1e-9))
        raise Refusal(
            Reason.LINE_TOO_FAST,
            where=leg(k),
            seconds=f"{durations[k]:.3g}",
            length=f"{lengths[k]:.3g}",
            tolerance=path_tolerance,
            needed=upwards(needed[k]),
        )
    finest = count_parts(lengths, path_tolerance / FINEST)
    parts = np.clip(np.floor(durations / pace.unhurried + 1e-9), fewest, finest)
    return fewest if parts.sum() + 1 > MOST_POINTS else parts


def count_parts(lengths: Array, longest: float) -> Array:
    """Returns the number of parts of each line (m,), at least 1, so that no part exceeds `longest` but by rounding."""
    return np.maximum(np.ceil(lengths / longest - 1e-9), 1.0)


def middles(parts: int) -> Array:
    """Returns the places of a line's points as shares of its length: 0, then the middles of all parts but the first."""
    return np.concatenate([[0.0], (np.arange(1, parts) + 0.5) / parts])


def upwards(value: float) -> float:
    """Returns a value rounded up to three digits: a goal with this value is not refused again."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / unit - 1e-9) * unit

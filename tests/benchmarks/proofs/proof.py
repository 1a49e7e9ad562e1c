"""The fewest switches to a goal, proven by exhaustion: independent of controller/search.

The arm is cut in two. Rigid motions keep distances, so the tip's miss is the distance between two points: the goal as
seen from the lower half's top, and the tip as seen from there. Both halves are listed up to `depth` switches and
matched. A pair that this leaves out has more than `depth` switches in one half, or in both. With more in one half, the
other half is listed: all rows of the one half are streamed and looked up in the list of the other. With more in both
halves, the pair has at least 2 depth + 2 switches; there is no such pair if one half is listed whole. So the best
pair is proven if it has no more than that; otherwise `depth` grows.

Positions and poses of planar arms, positions of spatial arms, obstacles. Angles of planar poses are the third
coordinate. A pair is accepted by forward kinematics of the whole arm, and by the distances of its bodies from the
obstacles.
"""

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.obstacles.clearance import BodyClearance
from tests.benchmarks.proofs.acceptance import Check, accepted, check_of
from tests.benchmarks.proofs.half_rows import NONE, Array, Half, Index, Rows, Table, halves, moved, rows, table, write

DEPTHS = (3, 4, 6, 8, 10, 12)
SLACK = 1e-9  # of the tolerance and of the arm's length: the search looks a little farther, acceptance decides


@dataclass(frozen=True)
class Proof:
    """What is proven of a goal.

    Attributes:
        switches: of `configuration`; the fewest if equal to `bound`.
        configuration: accepted, shape (B,); None if none was found.
    """

    bound: int
    switches: int
    configuration: Configuration | None
    seconds: float

    @property
    def proven(self) -> bool:
        """Whether `switches` are the fewest."""
        return self.switches == self.bound


class Near(NamedTuple):
    """When two points may match: their distance, or that in x and y and apart from it that in z, and its period."""

    radius: float
    apart: bool
    period: float


class Found(NamedTuple):
    """The best pair: switches, shape (1,), and configuration, shape (B,); and a configuration that is being asked for.

    Kernels write it.
    """

    switches: Index
    configuration: Index
    asked: Index


def prove(
    clearance: BodyClearance,
    goal: Array,
    start: Configuration,
    tolerance: float,
    turn: float = np.inf,
    seconds: float = 60.0,
    depths: tuple[int, ...] = DEPTHS,
    known: Configuration | None = None,
) -> Proof:
    """Returns the fewest switches from a configuration to a goal.

    Args:
        clearance: the arm, and the obstacles that its bodies must not touch.
        goal: tip's frame in the world, shape (4, 4).
        start: shape (B,).
        turn: of the angle [rad]; infinite if any will do. Planar arms only.
        seconds: no deeper lists are begun after this time of the processor.
        known: a configuration that is accepted, shape (B,), if any is known; the search looks for a better one.
    """
    began, m = time.thread_time(), clearance.manipulator
    check = check_of(clearance, goal, tolerance, turn)
    lower, upper, first, second = halves(m, goal, start, tolerance, turn)
    oriented = turn < np.pi
    radius = tolerance * (1 + SLACK) + SLACK * m.length
    near = Near(radius, oriented, 2 * np.pi * tolerance / turn if oriented else 0.0)
    own = np.array(start if known is None else known, dtype=np.int64)
    found = Found(np.array([NONE if known is None else m.switches(start, own)]), own, own.copy())
    bound = 0
    for depth in depths:
        tables = [table(rows(half, point, depth), radius) for half, point in ((lower, first), (upper, second))]
        match(tables[0].rows, lower, upper, tables[1], near, check, found)
        whole = depth >= min(int(half.costs.max(axis=1).sum()) for half in (lower, upper))
        most = NONE if whole else 2 * depth + 1
        stream(first, lower, upper, tables[1], depth, most, near, check, found)
        stream(second, upper, lower, tables[0], depth, most, near, check, found)
        bound = min(int(found.switches[0]), most + 1) if most < NONE else int(found.switches[0])
        if found.switches[0] == bound or time.thread_time() - began > seconds:
            break
    switches = int(found.switches[0])
    return Proof(bound, switches, None if switches == NONE else own, time.thread_time() - began)


@njit(cache=True, nogil=True, error_model="numpy")
def look_up(
    x: float,
    y: float,
    z: float,
    cost: int,
    code: int,
    asking: Half,
    other: Half,
    answers: Table,
    near: Near,
    check: Check,
    found: Found,
) -> None:
    """Takes the best accepted pair of a row and one of a table, if it is better than the one found."""
    own, side, low, shape = found.asked, answers.side, answers.low, answers.shape
    square = near.radius * near.radius
    for image in range(-1, 2) if near.apart else range(1):
        fz = (z + image * near.period - low[2]) / side - 0.5
        fx, fy = (x - low[0]) / side - 0.5, (y - low[1]) / side - 0.5
        if not (-1.5 <= fx < shape[0] + 0.5 and -1.5 <= fy < shape[1] + 0.5 and -1.5 <= fz < shape[2] + 0.5):
            continue
        cx, cy, cz = int(np.floor(fx)), int(np.floor(fy)), int(np.floor(fz))
        for iz in range(max(cz, 0), min(cz + 2, shape[2])):
            for iy in range(max(cy, 0), min(cy + 2, shape[1])):
                for ix in range(max(cx, 0), min(cx + 2, shape[0])):
                    c = (iz * shape[1] + iy) * shape[0] + ix
                    for row in range(answers.starts[c], answers.starts[c + 1]):
                        total = cost + answers.rows.costs[row]
                        if total >= found.switches[0]:
                            break
                        dx, dy = answers.rows.points[row, 0] - x, answers.rows.points[row, 1] - y
                        dz = answers.rows.points[row, 2] - z - image * near.period
                        if near.apart:
                            close = dx * dx + dy * dy <= square and abs(dz) <= near.radius
                        else:
                            close = dx * dx + dy * dy + dz * dz <= square
                        if close:
                            write(asking, code, own)
                            write(other, answers.rows.codes[row], own)
                            if accepted(check, own):
                                found.switches[0] = total
                                found.configuration[:] = own


@njit(cache=True, nogil=True, error_model="numpy")
def match(listed: Rows, asking: Half, other: Half, answers: Table, near: Near, check: Check, found: Found) -> None:
    """Looks up all rows of a list, fewest switches first."""
    for cost in range(listed.costs.max() + 1):
        for n in range(len(listed.costs)):
            if listed.costs[n] == cost and cost < found.switches[0]:
                x, y, z = listed.points[n]
                look_up(x, y, z, cost, listed.codes[n], asking, other, answers, near, check, found)


@njit(cache=True, nogil=True, error_model="numpy")
def stream(
    point: Array,
    asking: Half,
    other: Half,
    answers: Table,
    listed: int,
    most: int,
    near: Near,
    check: Check,
    found: Found,
) -> None:
    """Looks up every configuration of a half with more than `listed` and at most `most` switches."""
    count, motions, states, costs = len(asking.states), asking.motions, asking.states, asking.costs
    points, spent = np.empty((count, 3)), np.zeros(count, dtype=np.int64)
    codes, place = np.zeros(count, dtype=np.int64), np.full(count, -1)
    # Switches that the modules from here on can add at most: branches that cannot leave the list end.
    rest = np.zeros(count + 1, dtype=np.int64)
    for i in range(count - 1, -1, -1):
        rest[i] = rest[i + 1] + costs[i, : states[i]].max()
    low, side, shape, least = answers.low, answers.side, answers.shape, answers.least
    images = 1 if near.apart else 0
    points[0], i = point, 0
    while i >= 0:
        place[i] += 1
        j = asking.order[i, min(place[i], states[i] - 1)]
        cost = spent[i] + costs[i, j]
        if place[i] == states[i] or cost > most or cost >= found.switches[0]:
            place[i] = -1
            i -= 1
            continue
        if cost + rest[i + 1] <= listed:
            continue
        x, y, z = moved(motions, i, j, points[i, 0], points[i, 1], points[i, 2])
        code = codes[i] * states[i] + j
        if i + 1 < count:
            i += 1
            points[i, 0], points[i, 1], points[i, 2], spent[i], codes[i] = x, y, z, cost, code
            continue
        cx, cy = int(np.floor((x - low[0]) / side)), int(np.floor((y - low[1]) / side))
        if not (-1 <= cx <= shape[0] and -1 <= cy <= shape[1]):
            continue
        cx, cy = min(max(cx, 0), shape[0] - 1), min(max(cy, 0), shape[1] - 1)
        for image in range(-images, images + 1):
            cz = int(np.floor((z + image * near.period - low[2]) / side))
            if -1 <= cz <= shape[2]:
                cell = (min(max(cz, 0), shape[2] - 1) * shape[1] + cy) * shape[0] + cx
                if cost + least[cell] < found.switches[0]:
                    look_up(x, y, z, cost, code, asking, other, answers, near, check, found)
                    break

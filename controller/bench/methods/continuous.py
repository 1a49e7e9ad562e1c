"""Continuous inverse kinematics, rounded: what section 1 of Ebert-Uphoff and Chirikjian 1996 warns of.

The legs of the truss modules may have any length between contracted and extended; scipy's least squares brings the tip
to the goal from the lengths of before, which a weak second residual holds near. Rounded to the nearest lengths there
are, the arm is then switched one actuator at a time, the best each time, until within the tolerance or none is better.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from controller.bench.methods import k_switch
from controller.bench.methods.planar import Array
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.workspace.densities import Densities

HOLD = 1e-4  # weight of staying near; the tip's error is in the same unit


@dataclass(frozen=True, eq=False)
class Problem:
    """The truss: width and direction of each module, lengths contracted and extended (B, 3); and the descent's arm.

    `mirrored` is whether a module's diagonal is the paper's A-D.
    """

    descent: k_switch.Problem
    mirrored: np.ndarray
    width: float
    low: Array
    high: Array


def prepare(manipulator: Manipulator, densities: Densities | None) -> Problem:
    """Returns the tables of an arm."""
    if any(module.actuators != ("left", "diagonal", "right") for module in manipulator.modules):
        raise ValueError("only truss modules have lengths to be continuous in")
    bodies = np.array([module.body[[0, -1], :, :, :2] for module in manipulator.modules])
    lengths = np.linalg.norm(bodies[..., 1, :] - bodies[..., 0, :], axis=-1)
    return Problem(
        k_switch.prepare(manipulator, None, switches=1),
        bodies[:, 0, 1, 0, 0] < 0,
        float(lengths[0, 0, 3]),
        np.ascontiguousarray(lengths[:, 0, :3]),
        np.ascontiguousarray(lengths[:, 1, :3]),
    )


def solve(problem: Problem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    """Returns a configuration (B,) for a goal (2,)."""
    p = problem
    span = p.high - p.low
    before = (previous[:, None] >> np.array([2, 1, 0])) & 1
    start = np.clip(before.ravel(), 0.01, 0.99)  # inside the bounds, where there is a way to go

    def residuals(shares: Array) -> Array:
        tip = np.empty(2)
        reach(p.mirrored, p.width, p.low + span * shares.reshape(span.shape), tip)
        return np.concatenate((tip - goal, HOLD * (shares - start)))

    def jacobian(shares: Array) -> Array:
        slopes = np.empty((2, shares.size))
        slope(p.mirrored, p.width, p.low + span * shares.reshape(span.shape), slopes)
        return np.concatenate((slopes * span.ravel(), HOLD * np.eye(shares.size)))

    found = least_squares(residuals, start, jacobian, bounds=(0.0, 1.0), ftol=1e-6, xtol=1e-6, gtol=1e-9, max_nfev=50)
    bits = (found.x.reshape(span.shape) > 0.5).astype(np.int64)
    return k_switch.solve(p.descent, goal, bits @ np.array([4, 2, 1]), tolerance)


@njit("UniTuple(f8, 2)(f8, f8, f8, f8, f8, f8)", cache=True, nogil=True, error_model="numpy")
def apex(px: float, py: float, qx: float, qy: float, from_p: float, from_q: float) -> tuple[float, float]:
    """Returns the apex at these distances from p and q, on the left of p -> q."""
    dx, dy = qx - px, qy - py
    base = np.sqrt(dx * dx + dy * dy)
    foot = (base * base + from_p * from_p - from_q * from_q) / (2 * base)
    height = np.sqrt(from_p * from_p - foot * foot)
    return px + (foot * dx - height * dy) / base, py + (foot * dy + height * dx) / base


@njit("void(b1[::1], f8, f8[:,::1], f8[::1])", cache=True, nogil=True, error_model="numpy")
def reach(mirrored: np.ndarray, width: float, lengths: Array, tip: Array) -> None:
    """Writes the tip (2,) that lengths (B, 3) bring about: node by node, as each top is the next one's base."""
    ax, ay, bx, by = -width / 2, 0.0, width / 2, 0.0
    for i in range(len(lengths)):
        left, diagonal, right = lengths[i]
        if mirrored[i]:
            dx, dy = apex(ax, ay, bx, by, diagonal, right)
            cx, cy = apex(ax, ay, dx, dy, left, width)
        else:
            cx, cy = apex(ax, ay, bx, by, left, diagonal)
            dx, dy = apex(cx, cy, bx, by, width, right)
        ax, ay, bx, by = cx, cy, dx, dy
    tip[0], tip[1] = (ax + bx) / 2, (ay + by) / 2


@njit("void(b1[::1], f8, f8[:,::1], f8[:,::1])", cache=True, nogil=True, error_model="numpy")
def slope(mirrored: np.ndarray, width: float, lengths: Array, out: Array) -> None:
    """Writes the tip's derivatives (2, 3 B) by central differences."""
    step, tip, other = 1e-6, np.empty(2), np.empty(2)
    for i in range(len(lengths)):
        for a in range(3):
            length = lengths[i, a]
            lengths[i, a] = length + step
            reach(mirrored, width, lengths, tip)
            lengths[i, a] = length - step
            reach(mirrored, width, lengths, other)
            lengths[i, a] = length
            out[0, 3 * i + a] = (tip[0] - other[0]) / (2 * step)
            out[1, 3 * i + a] = (tip[1] - other[1]) / (2 * step)

"""Continuous inverse kinematics with rounding, against which section 1 of Ebert-Uphoff and Chirikjian 1996 argues.

The legs of truss modules may have any length between contracted and extended. Least squares (scipy) move the tip to the
goal from the previous lengths, with a weak residual that penalizes changes. The lengths are rounded to the nearest
state. Then the best single switch is made repeatedly, until the tip is within the tolerance or no switch improves it.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from hyperbit.controller.bench.methods import k_switch
from hyperbit.controller.bench.methods.planar import Array
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.workspace.densities import Densities

STAY = 1e-4  # weight of the change of lengths, relative to the tip's error


@dataclass(frozen=True, eq=False)
class ContinuousProblem:
    """Tables of a truss.

    Attributes:
        descent: tables of the final descent.
        mirrored: whether a module's diagonal is the paper's A-D, shape (B,).
        width: width of base and top.
        low, high: contracted and extended lengths of the legs, shape (B, 3).
    """

    descent: k_switch.KSwitchProblem
    mirrored: np.ndarray
    width: float
    low: Array
    high: Array


def prepare(manipulator: Manipulator, densities: Densities | None) -> ContinuousProblem:
    """Returns the tables of an arm."""
    if any(module.actuators != ("left", "diagonal", "right") for module in manipulator.modules):
        raise ValueError("this method supports truss modules only")
    bodies = np.array([module.body[[0, -1], :, :, :2] for module in manipulator.modules])
    lengths = np.linalg.norm(bodies[..., 1, :] - bodies[..., 0, :], axis=-1)
    return ContinuousProblem(
        k_switch.prepare(manipulator, None, switches=1),
        bodies[:, 0, 1, 0, 0] < 0,
        float(lengths[0, 0, 3]),
        np.ascontiguousarray(lengths[:, 0, :3]),
        np.ascontiguousarray(lengths[:, 1, :3]),
    )


def solve(problem: ContinuousProblem, goal: Array, previous: Configuration, tolerance: float) -> Configuration:
    """Returns a configuration (B,) for a goal (2,)."""
    p = problem
    span = p.high - p.low
    before = (previous[:, None] >> np.array([2, 1, 0])) & 1
    start = np.clip(before.ravel(), 0.01, 0.99)  # inside the bounds

    def residuals(shares: Array) -> Array:
        tip = np.empty(2)
        compute_tip(p.mirrored, p.width, p.low + span * shares.reshape(span.shape), tip)
        return np.concatenate((tip - goal, STAY * (shares - start)))

    def jacobian(shares: Array) -> Array:
        slopes = np.empty((2, shares.size))
        compute_derivatives(p.mirrored, p.width, p.low + span * shares.reshape(span.shape), slopes)
        return np.concatenate((slopes * span.ravel(), STAY * np.eye(shares.size)))

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
def compute_tip(mirrored: np.ndarray, width: float, lengths: Array, tip: Array) -> None:
    """Writes the tip (2,) for lengths (B, 3), node by node; each top is the base of the next module."""
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
def compute_derivatives(mirrored: np.ndarray, width: float, lengths: Array, out: Array) -> None:
    """Writes the tip's derivatives (2, 3 B) by central differences."""
    step, tip, other = 1e-6, np.empty(2), np.empty(2)
    for i in range(len(lengths)):
        for a in range(3):
            length = lengths[i, a]
            lengths[i, a] = length + step
            compute_tip(mirrored, width, lengths, tip)
            lengths[i, a] = length - step
            compute_tip(mirrored, width, lengths, other)
            lengths[i, a] = length
            out[0, 3 * i + a] = (tip[0] - other[0]) / (2 * step)
            out[1, 3 * i + a] = (tip[1] - other[1]) / (2 * step)

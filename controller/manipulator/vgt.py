"""The variable geometry truss module of section 4: two triangles over a base of fixed width."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.fields import Diagonal
from hyperbit.controller.manipulator.displacement_rates import truss_rates
from hyperbit.controller.manipulator.frames import Frame, planar
from hyperbit.controller.manipulator.module import Array, Module, binary_code

Point = NDArray[np.float64]
Lengths = tuple[float, float]

ACTUATORS = ("left", "diagonal", "right")


@dataclass(frozen=True, eq=False)
class Truss:
    """The geometry of a truss module with base nodes A, B and top nodes C, D, where |AB| = |CD| = `width`."""

    diagonal: Diagonal  # "BC" (odd modules of the paper) or "AD" (even modules)
    width: float  # width of base and top
    legs: Array  # contracted and extended length of the leg AC, the diagonal and the leg BD, shape (3, 2)
    base_bar: bool  # whether the body includes the bar AB. In a chain of trusses AB is the bar CD of the module below.

    def motion(self, displacements: Array) -> tuple[Frame, Array]:
        """Returns frames and bodies in mid-travel, see Module.motion."""
        return self.assemble((self.legs[:, 0] + displacements * (self.legs[:, 1] - self.legs[:, 0])).tolist())

    def rates(self, fixed: Array, moving: NDArray[np.int64]) -> Array:
        """Returns proven bounds in mid-travel, see Module.rates."""
        legs = self.legs
        ranges = legs[:, 0, None] + np.repeat(fixed[:, None], 2, axis=1) * (legs[:, 1] - legs[:, 0])[:, None]
        ranges[moving] = legs[moving]
        order = [0, 1, 2] if self.diagonal == "BC" else [2, 1, 0]
        first, middle, second = ranges[order]
        bounds = truss_rates(first, middle, second, self.width)[order]
        return np.asarray(bounds[moving] * abs(legs[moving, 1] - legs[moving, 0])[:, None])

    def assemble(self, lengths: Iterable[tuple[float, float, float]]) -> tuple[Frame, Array]:
        """Returns frames (n, 4, 4) and bodies (n, L, 2, 3) for lengths of left leg, diagonal and right leg.

        Raises ValueError if the two triangles of a state do not close.
        """
        states = [self.assemble_state(*three) for three in lengths]
        return np.array([frame for frame, _ in states]), np.array([body for _, body in states])

    def assemble_state(self, ac: float, across: float, bd: float) -> tuple[Frame, Array]:
        """Returns the frame (4, 4) and body (L, 2, 3) for lengths of left leg, diagonal and right leg."""
        width = self.width
        a, b = np.array([-width / 2, 0.0]), np.array([width / 2, 0.0])
        try:
            if self.diagonal == "BC":
                c = apex(a, b, ac, across)
                d = apex(c, b, width, bd)
            else:
                d = apex(a, b, across, bd)
                c = apex(a, d, ac, width)
        except ValueError as error:
            raise ValueError(f"legs {ac:g} and {bd:g}, diagonal {across:g}, width {width:g}: {error}") from None
        x, y = (c + d) / 2
        brace = (b, c) if self.diagonal == "BC" else (a, d)
        bars = [(a, c), brace, (b, d), (c, d), *([(a, b)] if self.base_bar else [])]
        body = [[(*p, 0.0), (*q, 0.0)] for p, q in bars]
        return planar(x, y, math.atan2(d[1] - c[1], d[0] - c[0])), np.array(body)


def vgt(
    diagonal: Diagonal, width: float, left: Lengths, middle: Lengths, right: Lengths, *, base_bar: bool = False
) -> Module:
    """Returns a truss module with the diagonal "BC" or "AD", see Truss.

    Base and top have the same width. The leg AC (left), the diagonal (middle) and the leg BD (right) have a contracted
    and an extended length. With `base_bar` the body includes the bar AB.

    Raises:
        ValueError: the two triangles of a state do not close.
    """
    truss = Truss(diagonal, width, np.array([left, middle, right]), base_bar)
    frames, body = truss.assemble(product(left, middle, right))
    return Module(frames, binary_code(8), ACTUATORS, body, planar=True, motion=truss.motion, rates=truss.rates)


def apex(p: Point, q: Point, from_p: float, from_q: float) -> Point:
    """Returns the apex (2,) to the left of p -> q, from its distances. Raises ValueError if there is none."""
    along = q - p
    base = math.hypot(*along)
    foot = (base**2 + from_p**2 - from_q**2) / (2 * base)
    height_squared = from_p**2 - foot**2
    if height_squared <= 0:
        raise ValueError(f"sides {from_p:g} and {from_q:g} do not meet over a base of {base:g}")
    unit = along / base
    normal = np.array([-unit[1], unit[0]])
    return np.asarray(p + foot * unit + math.sqrt(height_squared) * normal)

"""The incumbent of a search with its lower bound and deadline; the solution of a goal and its certificate."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Literal

import numpy as np

from hyperbit.controller.manipulator.frames import Array, Frame
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.search.clock import WALL, Clock
from hyperbit.controller.search.search_time import UNFOUND

Certificate = Literal["optimal", "bound", "unreachable", "unknown"]

# Sums of the same weights differ by rounding. Costs that differ by a smaller share count as equal.
EPSILON = 1e-9


def proves(bound: float, cost: float) -> bool:
    """Returns whether a lower bound proves that a cost is optimal."""
    return bound >= cost * (1 - EPSILON)


class Incumbent:
    """The best configuration that one search has found, its proof, and its deadline.

    Attributes:
        configuration: shape (B,).
        cost: cost of its switches; infinite if no configuration within the tolerances is known.
        square: squared error, see SearchTarget.
        bound: lower bound of the cost of all configurations within the tolerances; it never falls.
        until: deadline, by the clock. The stages of the search check it between parts of their work.
        clock: of this search; the stages charge it for their work.

    Args:
        configuration: the first, shape (B,).
        until: the first deadline.
        later: returns the deadline after `extend`, from the difference of cost and bound; None: it stays.
        hurried: called with each check of the deadline. It returns whether an extended search must end as soon as it
            has a configuration, or after UNFOUND; what it raises ends the search at once.
        clock: of this search.
    """

    def __init__(
        self,
        configuration: Configuration,
        until: float,
        later: Callable[[float], float] | None = None,
        hurried: Callable[[], bool] = lambda: False,
        clock: Clock = WALL,
    ) -> None:
        self.configuration, self.until, self._later, self._hurried = configuration, until, later, hurried
        self.clock, self._begun = clock, clock.now()
        self.cost, self.square, self.bound = np.inf, np.inf, 0.0
        self._extended = False

    @property
    def proven(self) -> bool:
        """Whether the bound proves that no cheaper configuration exists."""
        return proves(self.bound, self.cost)

    @property
    def late(self) -> bool:
        return self.remaining() < 0.0

    @property
    def over(self) -> bool:
        """Whether the search should stop: it has a proof, or the deadline has passed."""
        return self.proven or self.late

    def remaining(self) -> float:
        """Returns the time until the deadline [s]."""
        if self._hurried() and self._extended:
            self.until = min(self.until, -np.inf if self.cost < np.inf else self._begun + UNFOUND)
        return self.until - self.clock.now()

    def extend(self) -> bool:
        """Lets the deadline follow the difference of cost and bound; returns whether time is left."""
        self._extended = self._later is not None
        self._postpone()
        return not self.over

    def _postpone(self) -> None:
        """Sets the deadline of an extended search."""
        if self._extended and self._later is not None and self.until > -np.inf and not self.proven:
            self.until = self._later(self.cost - self.bound)

    def offer(self, configuration: Configuration, cost: float, square: float) -> bool:
        """Accepts a configuration if it is cheaper, or as cheap and nearer. Returns whether it was accepted."""
        if (cost, square) < (self.cost, self.square):
            self.configuration, self.cost, self.square = configuration, cost, square
            self._postpone()
            return True
        return False

    def prove(self, bound: float) -> None:
        self.bound = max(self.bound, bound)
        self._postpone()


@dataclass(frozen=True, eq=False)
class Solution:
    """The answer of a search for one goal."""

    configuration: Configuration  # module states, base first, shape (B,)
    tip: Frame  # frame of the tip in the world, shape (4, 4)
    error: float  # distance of the tip from the goal
    # number of actuators that differ from the previous configuration; in a plan the number of all switches of the
    # transition, those of a detour included
    switches: int
    within_tolerance: bool  # whether error and angle are within the tolerances, and the configuration is clear
    seconds: float  # time of the search [s]
    cost: float  # weighted number of `switches`
    # proven lower bound of the cost of all clear configurations within the tolerances, on any way to them; infinite if
    # there are none, 0 if nothing is proven
    bound: float = 0.0
    angle: float = 0.0  # angle between the orientations of tip and goal [rad]; 0 for a goal without orientation
    clear: bool = True  # whether the arm collides with nothing. If not, the search has found no clear configuration.
    dimension: int = 3  # 2 for a planar arm, 3 for a spatial arm
    effort: float | None = None  # work of the search, if it was limited by work; None: it was limited by time
    obstacle: str | None = None  # in which a missed goal is, such as "disc 'pillar'"
    # of a missed goal, see Solver.explained: a collision of a configuration that would reach it without obstacles
    collision: str | None = None

    @property
    def position(self) -> Array:
        """Position of the tip in the world, shape (dimension,)."""
        return self.tip[: self.dimension, 3]

    @property
    def certificate(self) -> Certificate:
        """What is proven: the cost is optimal, it has a lower bound, the goal is unreachable, or nothing."""
        return certificate(self.within_tolerance, self.bound, self.cost)

    @property
    def optimal(self) -> bool | None:
        """Whether the cost is proven optimal; None if nothing is proven."""
        return None if self.certificate == "unknown" else self.certificate == "optimal"

    @property
    def lower_bound(self) -> float | None:
        """The bound, infinite for an unreachable goal; None if nothing is proven."""
        return None if self.certificate == "unknown" else self.bound

    @property
    def reach(self) -> str:
        """Describes a goal that is missed: "is out of reach" if that is proven, else "seems out of reach".

        Also says in which obstacle the goal is, or what collides where the arm would reach it. The tolerance may reach
        out of the obstacle: then it says that no clear tip was found.
        """
        if self.obstacle is not None:
            proven = self.certificate == "unreachable"
            return f"is in {self.obstacle}" + ("" if proven else ", and no clear tip within the tolerance was found")
        missed = "is out of reach" if self.certificate == "unreachable" else "seems out of reach"
        return missed + ("" if self.collision is None else f" without a collision, such as: {self.collision}")

    def _repr_html_(self) -> str:
        return html_table([self])

    def proof(self) -> dict[str, Any]:
        """Returns the certificate as fields for JSON."""
        return proof(self.certificate, self.bound)


def certificate(feasible: bool, bound: float, cost: float) -> Certificate:
    """Returns the certificate of a cost; `feasible`: its configuration is clear and within the tolerances."""
    if feasible and proves(bound, cost):
        return "optimal"
    if bound == np.inf:
        return "unreachable"
    return "bound" if bound > 0 else "unknown"


def gap(kind: Certificate, bound: float, cost: float) -> float | None:
    """Returns the share by which a cost exceeds its lower bound; None if nothing is proven."""
    if kind not in ("optimal", "bound"):
        return None
    return 0.0 if proves(bound, cost) else cost / bound - 1


def proof(kind: Certificate, bound: float) -> dict[str, Any]:
    """Returns the fields `optimal`, `lower_bound` and `certificate` for JSON, which has no infinity."""
    known = kind in ("optimal", "bound")
    optimal = None if kind == "unknown" else kind == "optimal"
    return {"optimal": optimal, "lower_bound": bound if known else None, "certificate": kind}


def html_table(solutions: Sequence[Solution]) -> str:
    """Returns solutions as a table for notebooks."""
    rows = [("configuration", "position", "switches", "error", "certificate")]
    for one in solutions:
        place, state = (" ".join(f"{x:.4g}" for x in array.tolist()) for array in (one.position, one.configuration))
        proven = one.certificate if one.within_tolerance else f"the goal {one.reach}"
        rows.append((state, place, str(one.switches), f"{one.error:.2g}", proven))
    cells = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows)
    return f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"

"""Paths through several goals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.library.goals import Goal
from hyperbit.controller.search.solution import Certificate, Solution, gap, html_table


@dataclass(frozen=True, eq=False)
class Path:
    """Configurations through several goals.

    Attributes:
        goals: the goals.
        positions: points of the path in the world, shape (n, dimension): the goals, and points between them if straight
            lines are followed.
        solutions: one for each point; switches are counted from the previous point.
        waypoints: index of each goal's point, shape (m,).
        certificate: certificate for the cost of the whole path, see Solution.certificate.
        bound: proven lower bound of the cost of all paths through the goals; 0 if nothing is proven.
    """

    goals: tuple[Goal, ...]
    positions: NDArray[np.float64]
    solutions: tuple[Solution, ...]
    waypoints: NDArray[np.int64]
    certificate: Certificate
    bound: float

    def _repr_html_(self) -> str:
        head = f"{len(self.goals)} goals, {self.switches} switches: {self.certificate}"
        return f"<p>{head}</p>{html_table(self.solutions)}"

    @property
    def configurations(self) -> NDArray[np.int64]:
        """Configuration at each point, shape (n, B)."""
        return np.array([solution.configuration for solution in self.solutions])

    @property
    def switches(self) -> int:
        """Number of switches along the path."""
        return sum(solution.switches for solution in self.solutions)

    @property
    def cost(self) -> float:
        """Weighted number of switches along the path."""
        return sum(solution.cost for solution in self.solutions)

    @property
    def lower_bound(self) -> float | None:
        """The lower bound; None if nothing is proven."""
        return None if self.certificate == "unknown" else self.bound

    @property
    def gap(self) -> float | None:
        """Share by which the cost exceeds the lower bound; None if nothing is proven."""
        return gap(self.certificate, self.bound, self.cost)

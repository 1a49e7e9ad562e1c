"""Lengths of the containers of a planner's process: what is over is forgotten."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.simulation.statements.containers import lengths
from tests.simulation.verdict import require

if TYPE_CHECKING:
    from tests.simulation.whole.planner_process import PlannerProcess

ROOMS = ("hyperbit.controller.planning.core", "hyperbit.controller.planning.loop", "hyperbit.controller.gateway")
MOST = 24  # entries of a container when nothing is asked for
HISTORIES = {  # greatest lengths of those that keep what is over
    "Admission.canceled": 256,
    "Admission.unresolved": 256,
    "RepeatedGoals.known": 1_000,
    "Results._told": 10**6,  # one identity for each goal of the process
    "Rate._times": 100,
}
OPAQUE = ("_manipulator", "manipulator", "_arm", "_description", "_densities", "publishers", "_tracker", "_filter")


def check_containers(process: PlannerProcess) -> None:
    """Checks that no container has grown, when all requests are answered and all goals have ended."""
    roots = process.core, process.server, process.outbox, process.goals, process.loop
    for name, length in lengths(roots, ours, OPAQUE):
        require(length <= HISTORIES.get(name, MOST), f"{name} has {length} entries, and nothing is asked for")


def ours(value: object) -> bool:
    """Returns whether an object is of the planner or the gateway."""
    return type(value).__module__.startswith(ROOMS) and not isinstance(value, tuple)

"""The merit of an arm by trying all configurations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hyperbit.controller.design.merit import Judged, Target
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.search.solution import Solution

ROWS = 1 << 16  # configurations at a time


class Tried(NamedTuple):
    """Reach of each target, shape (T,); fewest switches to each, infinite if missed; survival, shape (T, A, 2)."""

    reached: np.ndarray
    switches: np.ndarray
    survives: np.ndarray


def tried(own: Judged, targets: Sequence[Target], solutions: Sequence[Solution | None]) -> Tried:
    """Tries all configurations, from the starts that the solutions tell."""
    chain, clearance = own.manipulator, own.arm.clearance(own.manipulator)
    starts = list(starts_of(solutions, len(chain.modules)))
    count = len(chain.actuators)
    switches, survives = np.full(len(targets), np.inf), np.zeros((len(targets), count, 2), dtype=bool)
    for rows in configurations(chain.states):
        tips = chain.tips(rows)
        for t, target in enumerate(targets):
            near = rows[within(tips, target, own)]
            clear = near[~clearance.blocked(near)] if len(near) else near
            if len(clear) == 0:
                continue
            states = chain.actuator_states(clear)
            differ = states != chain.actuator_states(starts[t])
            switches[t] = min(switches[t], differ.sum(axis=1).min())
            survives[t, :, 0] |= (states == 0).any(axis=0)
            survives[t, :, 1] |= (states == 1).any(axis=0)
    return Tried(np.isfinite(switches), switches, survives)


def starts_of(solutions: Sequence[Solution | None], modules: int) -> Iterator[np.ndarray]:
    """Yields where the search for each target began: at the last that was reached, the first at home."""
    start = np.zeros(modules, dtype=np.int64)
    for found in solutions:
        yield start
        if found is not None and found.within_tolerance:
            start = found.configuration


def configurations(states: np.ndarray) -> Iterator[np.ndarray]:
    total = int(np.prod(states))
    for first in range(0, total, ROWS):
        flat = np.arange(first, min(first + ROWS, total))
        yield np.stack(np.unravel_index(flat, tuple(states)), axis=1)


def within(tips: Frame, target: Target, own: Judged) -> np.ndarray:
    """Which tips (n, 4, 4) are within the tolerances of a target, shape (n,)."""
    away = np.linalg.norm(tips[:, :3, 3] - np.append(target.position, [0.0] * (3 - len(target.position))), axis=1)
    near = away <= (target.tolerance or own.arm.tolerance)
    if target.goal.ndim == 2:
        traces = np.einsum("nij,ij->n", tips[:, :3, :3], target.goal[:3, :3])
        near &= np.arccos(np.clip((traces - 1) / 2, -1, 1)) <= (target.angle_tolerance or own.arm.angle_tolerance)
    return np.asarray(near)

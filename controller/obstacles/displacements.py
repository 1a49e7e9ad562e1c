"""Frames and bodies of a module in mid-travel, with bounds on how fast both change."""

import threading
from functools import lru_cache
from itertools import product

import numpy as np

from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.module import Module
from hyperbit.controller.obstacles.distance import Array, Index

FINE, COARSE = 5, 3  # samples per displacement of a platform: up to three moving actuators; more
ROUNDING = 1e-9  # relative rounding error of a bound
MOST = 6  # actuators of one module that move at once; more have no bound
CAPACITY = 50_000  # cached displacements


class Displacements:
    """Frames and bodies of one module at displacements of its actuators, cached. Thread-safe."""

    def __init__(self, module: Module) -> None:
        self._module, self._lock = module, threading.Lock()
        self._rows: dict[bytes, int] = {}
        self._frames, self._bodies = np.empty((64, 4, 4)), np.empty((64, *module.body.shape[1:]))
        self._rates: dict[bytes, Array] = {}

    def at(self, displacements: Array) -> tuple[Frame, Array]:
        """Returns frames (n, 4, 4) and bodies (n, L, 2, 3) at displacements (n, A), see Module.between."""
        with self._lock:
            keys = [row.tobytes() for row in np.ascontiguousarray(displacements)]
            fresh = {key: n for n, key in enumerate(keys) if key not in self._rows}
            if fresh:
                self._remember(fresh, displacements, dict.fromkeys(keys))
            rows = [self._rows[key] for key in keys]
            return self._frames[rows], self._bodies[rows]

    def _remember(self, fresh: dict[bytes, int], displacements: Array, asked: dict[bytes, None]) -> None:
        if len(self._rows) + len(fresh) > CAPACITY:
            self._rows.clear()
            first = {key: n for n, key in reversed(list(enumerate(row.tobytes() for row in displacements)))}
            fresh = {key: first[key] for key in asked}
        used = len(self._rows)
        if used + len(fresh) > len(self._frames):
            room = 2 * (used + len(fresh))
            self._frames = np.resize(self._frames, (room, *self._frames.shape[1:]))
            self._bodies = np.resize(self._bodies, (room, *self._bodies.shape[1:]))
        here = slice(used, used + len(fresh))
        self._frames[here], self._bodies[here] = self._module.between(displacements[list(fresh.values())])
        self._rows.update(zip(fresh, range(used, used + len(fresh)), strict=True))

    def rates(self, states: Array, moving: Index) -> Array:
        """Returns the greatest rates of each displacement, shape (k, 3).

        The columns are the translation of the frame above, its rotation, and the movement of the body's points. All are
        for a displacement from 0 to 1. The rotation is the chord at unit distance. The bounds are proven if
        `Module.proven`. Otherwise, for platforms, they are sampled: the greatest rate of the samples, plus half of its
        change from one sample to the next in every direction. The states (A,) of the `moving` actuators (k,) have no
        effect.
        """
        fixed = states.copy()
        fixed[moving] = 0.0
        key = fixed.tobytes() + moving.tobytes()
        if key not in self._rates:
            if self._module.proven and len(moving) <= MOST:
                self._rates[key] = self._module.bounds(fixed, moving) * (1 + ROUNDING)
            else:
                self._rates[key] = self._sampled(fixed, moving)
        return self._rates[key]

    def _sampled(self, fixed: Array, moving: Index) -> Array:
        k = len(moving)
        if k > MOST:
            return np.full((k, 3), np.inf)
        samples = FINE if k <= 3 else COARSE
        grid = np.tile(fixed, (samples**k, 1))
        grid[:, moving] = list(product(np.linspace(0.0, 1.0, samples), repeat=k))
        frames, bodies = self.at(grid)
        shape = [samples] * k
        parts = (frames[:, :3, 3], frames[:, :3, :3].reshape(-1, 9) / np.sqrt(2.0), bodies)
        return np.array(
            [[rate(part.reshape(*shape, -1, n), a) for part, n in zip(parts, (3, 9, 3), strict=True)] for a in range(k)]
        )


def rate(values: Array, axis: int) -> float:
    """Returns the greatest rate along one axis of vectors on a regular grid (n, ..., n, m, d)."""
    steps = values.shape[axis] - 1
    own = np.diff(values, axis=axis) * steps
    bound = np.linalg.norm(own, axis=-1).max()
    for other in range(values.ndim - 2):
        bound += np.linalg.norm(np.diff(own, axis=other), axis=-1).max(initial=0.0) / 2
    return float(bound) if np.isfinite(bound) else np.inf


@lru_cache(maxsize=64)
def displacements_of(module: Module) -> Displacements:
    return Displacements(module)

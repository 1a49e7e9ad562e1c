"""A module in mid-stroke, looked up: where it brings the frame above and its body, and how fast both may change."""

import threading
from functools import lru_cache
from itertools import product

import numpy as np

from controller.manipulator.frames import Frame
from controller.manipulator.module import Module
from controller.obstacles.distance import Array, Index

FINE, COARSE = 5, 3  # samples of each stroke of a platform, of up to three that go on at once and of more
ROUNDING = 1e-9  # of a bound: what rounding takes
MOST = 6  # strokes of one module at once; of more nothing is known
KEPT = 50_000  # mid-strokes remembered


class Strokes:
    """Frames and bodies of one module between its states; from any thread."""

    def __init__(self, module: Module) -> None:
        self._module, self._lock = module, threading.Lock()
        self._rows: dict[bytes, int] = {}
        self._frames, self._bodies = np.empty((64, 4, 4)), np.empty((64, *module.body.shape[1:]))
        self._rates: dict[bytes, Array] = {}

    def at(self, strokes: Array) -> tuple[Frame, Array]:
        """Returns frames (n, 4, 4) and bodies (n, L, 2, 3) at strokes (n, A); see Module.between."""
        with self._lock:
            keys = [row.tobytes() for row in np.ascontiguousarray(strokes)]
            fresh = {key: n for n, key in enumerate(keys) if key not in self._rows}
            if fresh:
                self._remember(fresh, strokes, dict.fromkeys(keys))
            rows = [self._rows[key] for key in keys]
            return self._frames[rows], self._bodies[rows]

    def _remember(self, fresh: dict[bytes, int], strokes: Array, asked: dict[bytes, None]) -> None:
        if len(self._rows) + len(fresh) > KEPT:
            self._rows.clear()
            first = {key: n for n, key in reversed(list(enumerate(row.tobytes() for row in strokes)))}
            fresh = {key: first[key] for key in asked}
        used = len(self._rows)
        if used + len(fresh) > len(self._frames):
            room = 2 * (used + len(fresh))
            self._frames = np.resize(self._frames, (room, *self._frames.shape[1:]))
            self._bodies = np.resize(self._bodies, (room, *self._bodies.shape[1:]))
        here = slice(used, used + len(fresh))
        self._frames[here], self._bodies[here] = self._module.between(strokes[list(fresh.values())])
        self._rows.update(zip(fresh, range(used, used + len(fresh)), strict=True))

    def rates(self, states: Array, moving: Index) -> Array:
        """Returns how fast strokes move the frame above, turn it, and move the body's points at most, shape (k, 3).

        They are proven if the module's bounds are, see Module.proven. Those of platforms are sampled: the greatest of
        the samples, and half of what they change from one sample to the next, in every direction. Turning is by how far
        a point goes that is one unit away; all are for a whole stroke.

        Args:
            states: of the module's actuators, shape (A,), those that move in any.
            moving: which do, shape (k,).
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
def strokes_of(module: Module) -> Strokes:
    """Returns the strokes of a module, the same for all that ask."""
    return Strokes(module)

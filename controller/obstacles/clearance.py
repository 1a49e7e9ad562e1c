"""Collision checks of whole configurations: modules against obstacles, and against each other if asked."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.obstacles.collision import ArmBodies, first_collisions
from hyperbit.controller.obstacles.distance import Array, Index, Surroundings
from hyperbit.controller.obstacles.obstacles import Obstacles

# Share of the arm's length that covers rounding: bodies at this distance count as touching. The crossing of two nearly
# parallel lines has half of the digits only.
ROUNDING = 1e-7


class BodyClearance:
    """The bodies of an arm among obstacles. A body is a module's line segments, thickened by a radius.

    Attributes:
        radius: radius of the bodies, as in the arm's file.
        margin: the radius, increased by the rounding error; kernels compare with it.
        self_collision: whether modules that are not neighbours must not touch each other.
        apart: distance at which two modules count as touching; negative without `self_collision`.
        bodies: line segments of each module's states, padded with 0, shape (B, Kmax, Lmax, 2, 3).
        balls: centre and radius of a ball around each body, shape (B, Kmax, 4).
        lines: number of line segments of each module, shape (B,).
        arm_bodies, surroundings: the arm and the obstacles, for kernels.
    """

    def __init__(
        self, manipulator: Manipulator, obstacles: Obstacles, radius: float = 0.0, *, self_collision: bool = False
    ) -> None:
        self.manipulator, self.obstacles = manipulator, obstacles
        self.radius, self.self_collision = radius, self_collision
        self.margin = radius + ROUNDING * manipulator.length
        self.apart = radius + self.margin if self_collision else -1.0
        self.lines = np.array([module.body.shape[1] for module in manipulator.modules])
        self.bodies = np.zeros((*manipulator.frames.shape[:2], self.lines.max(), 2, 3))
        self.balls = np.zeros((*manipulator.frames.shape[:2], 4))
        for i, module in enumerate(manipulator.modules):
            self.bodies[i, : len(module.body), : self.lines[i]] = module.body
            self.balls[i, : len(module.body)] = balls(module.body)
        bodies = self.bodies, self.balls, self.lines
        self.arm_bodies = ArmBodies(manipulator.rotations, manipulator.translations, *bodies)
        shapes = obstacles.kinds, obstacles.axes, obstacles.centres, obstacles.sizes
        self.surroundings = Surroundings(*shapes, float(self.margin), float(self.apart))

    @property
    def free(self) -> bool:
        """Whether there is nothing to avoid."""
        return len(self.obstacles) == 0 and not self.self_collision

    def blocked(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Returns which of configurations (n, B) touch anything, shape (n,)."""
        chosen = np.ascontiguousarray(configurations, dtype=np.int64)
        return np.zeros(len(chosen), dtype=bool) if self.free else np.asarray(self.first_collisions(chosen)[:, 0] >= 0)

    def where(self, configuration: Configuration) -> str | None:
        """Returns the first collision from the base as a sentence, "module 7 is in disc 'pillar'", or None."""
        if self.free:
            return None
        module, obstacle, other = self.first_collisions(np.array([configuration], dtype=np.int64))[0].tolist()
        if module < 0:
            return None
        if obstacle >= 0:
            return f"module {module + 1} is in {self.obstacles.names[obstacle]}"
        return f"modules {other + 1} and {module + 1} touch"

    def cause(self, configuration: Configuration) -> str:
        """Returns the obstacle of the first collision by its name, or "other modules" if the arm touches itself."""
        obstacle = int(self.first_collisions(np.array([configuration], dtype=np.int64))[0, 1])
        return self.obstacles.names[obstacle] if obstacle >= 0 else "other modules"

    def buried(self, point: Array, tolerance: float) -> bool:
        """Returns whether every tip within a distance of a point (3,) in the world is surely inside an obstacle.

        Only a last module whose body contains the tip in every state permits this conclusion.
        """
        if (self.obstacles.depths(point) > self.radius - tolerance).all():
            return False
        last = self.manipulator.modules[-1]
        for frame, lines in zip(last.frames, last.body, strict=True):
            along = lines[:, 1] - lines[:, 0]
            length = np.maximum((along**2).sum(axis=1), 1e-300)
            share = np.clip(((frame[:3, 3] - lines[:, 0]) * along).sum(axis=1) / length, 0.0, 1.0)
            away = np.linalg.norm(lines[:, 0] + share[:, None] * along - frame[:3, 3], axis=1)
            if away.min() > ROUNDING * self.manipulator.length / 2:
                return False
        return True

    def holding(self, point: Array) -> str | None:
        """Returns the obstacle in which a point (3,) of the world is deepest, by its name; None if it is in none."""
        if len(self.obstacles) == 0:
            return None
        depths = self.obstacles.depths(point)[0]
        return self.obstacles.names[int(depths.argmin())] if depths.min() <= 0 else None

    def first_collisions(self, configurations: Index) -> Index:
        """Returns the first collision of each configuration (n, B), shape (n, 3).

        A row has the module, the obstacle that it touches, and the other module that it touches; -1 for none.
        """
        r, b = (np.ascontiguousarray(part) for part in (self.manipulator.base[:3, :3], self.manipulator.base[:3, 3]))
        return np.asarray(first_collisions(r, b, self.arm_bodies, self.surroundings, configurations))


def balls(bodies: Array) -> Array:
    """Returns centre and radius (..., 4) of balls around line segments (..., L, 2, 3)."""
    ends = bodies.reshape(*bodies.shape[:-3], 2 * bodies.shape[-3], 3)
    middle = (ends.min(axis=-2) + ends.max(axis=-2)) / 2
    radius = np.linalg.norm(ends - middle[..., None, :], axis=-1).max(axis=-1)
    return np.concatenate([middle, radius[..., None]], axis=-1)

"""Whether an arm's modules keep clear of regions and, where that is asked for, of each other."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.manipulator.manipulator import Configuration, Manipulator
from controller.obstacles.collision import first_collisions
from controller.obstacles.distance import Array, Index
from controller.obstacles.regions import Regions

# Of the arm's length: what comes so near counts as touching, however sums are rounded. Where two lines that are nearly
# parallel cross is known to half of the digits only.
ROUNDING = 1e-7


class Clearance:
    """An arm's bodies among regions. A body is the line segments of a module's structure, thickened by a radius.

    Attributes:
        manipulator: the arm.
        regions: that no body may touch.
        radius: of the bodies, as the arm's file gives it.
        margin: with which kernels compare: the radius, and what rounding takes.
        self_collision: whether bodies of modules that are not neighbours must stay apart, too.
        apart: how near to each other is too near; less than 0 where that does not matter.
        bodies: of each module's states, padded with 0, shape (B, Kmax, Lmax, 2, 3).
        balls: centre and radius of a ball around each, shape (B, Kmax, 4).
        lines: number of line segments of each module, shape (B,).
    """

    def __init__(
        self, manipulator: Manipulator, regions: Regions, radius: float = 0.0, *, self_collision: bool = False
    ) -> None:
        """Pads the modules' bodies."""
        self.manipulator, self.regions, self.radius, self.self_collision = manipulator, regions, radius, self_collision
        self.margin = radius + ROUNDING * manipulator.length
        self.apart = radius + self.margin if self_collision else -1.0
        self.lines = np.array([module.body.shape[1] for module in manipulator.modules])
        self.bodies = np.zeros((*manipulator.frames.shape[:2], self.lines.max(), 2, 3))
        self.balls = np.zeros((*manipulator.frames.shape[:2], 4))
        for i, module in enumerate(manipulator.modules):
            self.bodies[i, : len(module.body), : self.lines[i]] = module.body
            self.balls[i, : len(module.body)] = balls(module.body)

    @property
    def free(self) -> bool:
        """Whether there is nothing to avoid."""
        return len(self.regions) == 0 and not self.self_collision

    def blocked(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Returns which of configurations (n, B) touch anything, shape (n,)."""
        chosen = np.ascontiguousarray(configurations, dtype=np.int64)
        return np.zeros(len(chosen), dtype=bool) if self.free else np.asarray(self.first_collisions(chosen)[:, 0] >= 0)

    def where(self, configuration: Configuration) -> str | None:
        """Returns what touches first from the base, "module 7 is in disc 'pillar'", or None."""
        if self.free:
            return None
        module, region, other = self.first_collisions(np.array([configuration], dtype=np.int64))[0].tolist()
        if module < 0:
            return None
        if region >= 0:
            return f"module {module + 1} is in {self.regions.names[region]}"
        return f"modules {other + 1} and {module + 1} touch"

    def buried(self, point: Array, tolerance: float) -> bool:
        """Returns whether a tip within a distance of a point (3,) in the world is inside an obstacle for certain.

        That is certain only of last modules whose bodies contain the tip in every state.
        """
        if (self.regions.depths(point) > self.radius - tolerance).all():
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

    def first_collisions(self, configurations: Index) -> Index:
        """Returns module, region and other module that touch first in configurations (n, B), or -1 each; (n, 3)."""
        arm, regions = self.manipulator, self.regions
        return np.asarray(
            first_collisions(
                np.ascontiguousarray(arm.base[:3, :3]),
                np.ascontiguousarray(arm.base[:3, 3]),
                arm.rotations,
                arm.translations,
                self.bodies,
                self.balls,
                self.lines,
                regions.kinds,
                regions.axes,
                regions.centres,
                regions.sizes,
                self.margin,
                self.apart,
                configurations,
            )
        )


def balls(bodies: Array) -> Array:
    """Returns centre and radius (..., 4) of balls that hold the line segments (..., L, 2, 3)."""
    ends = bodies.reshape(*bodies.shape[:-3], -1, 3)
    middle = (ends.min(axis=-2) + ends.max(axis=-2)) / 2
    reach = np.linalg.norm(ends - middle[..., None, :], axis=-1).max(axis=-1)
    return np.concatenate([middle, reach[..., None]], axis=-1)

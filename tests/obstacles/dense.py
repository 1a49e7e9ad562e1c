"""An independent collision check in plain NumPy: dense points along each line segment."""

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from hyperbit.controller.obstacles.obstacles import Obstacles, box, half_space, sphere, together
from tests.arms import any_frames

PARTS = 2000  # of each line segment


@dataclass(frozen=True)
class Disc:
    """A sphere, or a disc of the plane."""

    centre: tuple[float, ...]
    radius: float

    def obstacle(self) -> Obstacles:
        return sphere("disc", self.centre, self.radius)

    def signed(self, points: np.ndarray) -> np.ndarray:
        """Signed distances (n,) of points (n, 3), negative inside."""
        return np.linalg.norm(points[:, : len(self.centre)] - self.centre, axis=1) - self.radius


@dataclass(frozen=True, eq=False)
class Box:
    """A box whose axes are the columns of a frame, or a rectangle of the plane."""

    frame: np.ndarray
    size: tuple[float, ...]

    def obstacle(self) -> Obstacles:
        return box("box", self.frame[: len(self.size), 3], self.size, self.frame[:3, :3])

    def signed(self, points: np.ndarray) -> np.ndarray:
        own = (np.linalg.inv(self.frame) @ np.c_[points, np.ones(len(points))].T)[: len(self.size)].T
        half = np.array(self.size) / 2
        away = np.linalg.norm(own - np.clip(own, -half, half), axis=1)
        return np.where(away > 0, away, -(half - np.abs(own)).min(axis=1))


@dataclass(frozen=True)
class HalfPlane:
    point: tuple[float, ...]
    normal: tuple[float, ...]

    def obstacle(self) -> Obstacles:
        return half_space("half-plane", self.point, self.normal)

    def signed(self, points: np.ndarray) -> np.ndarray:
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        return (points[:, : len(normal)] - self.point) @ normal


Shape = Disc | Box | HalfPlane

sides = st.floats(0.01, 1)


def coordinates(size: int) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*[st.floats(-1, 1)] * size)


def any_shape(size: int, frames: st.SearchStrategy[np.ndarray] = any_frames) -> st.SearchStrategy[Shape]:
    """Obstacles of the plane (2) or of space (3)."""
    normals = coordinates(size).filter(lambda n: np.linalg.norm(n) > 0.1)
    return (
        st.builds(Disc, coordinates(size), sides)
        | st.builds(Box, frames, st.tuples(*[sides] * size))
        | st.builds(HalfPlane, coordinates(size), normals)
    )


def obstacles_of(parts: list[Shape]) -> Obstacles:
    return together([part.obstacle() for part in parts])


def along(lines: np.ndarray, parts: int = PARTS) -> np.ndarray:
    """Points (L * (parts + 1), 3) along line segments (L, 2, 3)."""
    share = np.linspace(0, 1, parts + 1)[None, :, None]
    return (lines[:, None, 0] * (1 - share) + lines[:, None, 1] * share).reshape(-1, 3)


def step(lines: np.ndarray) -> float:
    """Greatest difference between the distance of the nearest dense point and the true distance."""
    return float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).max()) / PARTS / 2


def nearest(lines: np.ndarray, obstacles: list[Shape], parts: int = PARTS) -> float:
    """The least signed distance of points from any obstacle."""
    return min((float(obstacle.signed(along(lines, parts)).min()) for obstacle in obstacles), default=np.inf)

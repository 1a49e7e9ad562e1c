"""The binary platform: a parallel mechanism, a plate on legs of two lengths each.

- Six legs in space, ball joints at both ends: Stewart platform (Gough-Stewart).
- Three legs in space (3-RPS): ball joints above; below, each leg turns in the plane through itself and the z axis.
- Three legs in the plane (3-RPR): revolute joints at both ends.

Leg i ends at t_i = b + R p_i. The pose (R, b) satisfies |t_i - a_i| = length of leg i for all i. Six legs permit up to
40 poses. The pose of a state is found by continuation: all legs go evenly from the middle of their travel to the
lengths of the state. The path must not pass a singular pose. There two poses meet, and the legs do not determine on
which one the plate continues.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.manipulator.frames import Frame, spatial, turned
from hyperbit.controller.manipulator.module import Module, binary_code

Array = NDArray[np.float64]

RESIDUAL = 1e-12  # greatest error of a leg's length, as a share of the middle length
STIFFNESS = 1e-3  # least singular value of the Jacobian; below it a pose error is 1000 times a leg's error
FIRST_STEP, LAST_STEP = 1 / 8, 2.0**-12  # greatest and least step of the continuation
MANY, FEW = 100, 8  # most Newton steps from a guess, and from a near pose
CLOSE = 0.2  # greatest twist of a Newton step, in middle lengths and radians


@dataclass(frozen=True, eq=False)
class Legs:
    """The geometry of a platform, in units of the middle length."""

    base: Array  # lower joints a_i in the frame below, shape (L, 3)
    top: Array  # upper joints p_i in the frame above, shape (L, 3)
    normals: Array  # normals of the planes in which the legs of a 3-RPS turn, shape (L, 3); otherwise shape (0, 3)
    free: tuple[int, ...]  # degrees of freedom of the plate: 0 to 2 along and 3 to 5 about x, y and z

    def joints(self, frames: Frame) -> Array:
        """Returns the upper joints t_i (..., L, 3) in the frame below, for poses (..., 4, 4)."""
        return np.asarray(self.top @ np.swapaxes(frames[..., :3, :3], -1, -2) + frames[..., None, :3, 3])

    def bodies(self, frames: Frame) -> Array:
        """Returns legs, base and plate of poses (n, 4, 4) as line segments (n, 3 L, 2, 3)."""
        ends = self.joints(frames)
        base = np.broadcast_to(self.base, ends.shape)
        lines = (base, ends), (base, np.roll(base, -1, axis=-2)), (ends, np.roll(ends, -1, axis=-2))
        return np.concatenate([np.stack(pair, axis=-2) for pair in lines], axis=-3)

    def misfit(self, frames: Frame, lengths: Array) -> tuple[Array, Array]:
        """Returns the residuals (..., n) of the constraints at poses (..., 4, 4), and their Jacobian (..., n, n)."""
        ends = self.joints(frames)
        legs = ends - self.base
        found = np.linalg.norm(legs, axis=-1)
        swinging = ends[..., : len(self.normals), :]
        directions = np.concatenate([legs / found[..., None], np.broadcast_to(self.normals, swinging.shape)], axis=-2)
        arms = np.concatenate([ends, swinging], axis=-2) - frames[..., None, :3, 3]
        missed = np.concatenate([found - lengths, (self.normals * swinging).sum(axis=-1)], axis=-1)
        return missed, np.concatenate([directions, np.cross(arms, directions)], axis=-1)[..., self.free]

    def solve_pose(self, frame: Frame, lengths: Array, steps: int, longest: float = np.inf) -> Frame | None:
        """Returns the pose (4, 4) for lengths (L,) by Newton's method, or None if it does not converge.

        `frame` (4, 4) is the first guess. The method gives up after `steps`, or if the first step is above `longest`.
        """
        for step in range(steps):
            missed, change = self.misfit(frame, lengths)
            if np.abs(missed).max() < RESIDUAL:
                return frame
            twist = np.zeros(6)
            try:
                twist[list(self.free)] = np.linalg.solve(change, -missed)
            except np.linalg.LinAlgError:
                return None
            size = float(np.linalg.norm(twist))
            if step == 0 and size > longest:
                return None
            frame = moved(frame, twist * (CLOSE / max(size, CLOSE)))
        return None

    def track(self, frame: Frame, lengths: Array) -> Frame:
        """Returns the poses (n, 4, 4) near a pose (4, 4) for lengths (n, L); NaN where the plate is loose."""
        side, frames = self.stiffness(frame)[1], np.tile(frame, (len(lengths), 1, 1))
        for _ in range(FEW):
            missed, change = self.misfit(frames, lengths)
            if abs(missed).max(initial=0.0) < RESIDUAL:
                break
            twists = np.zeros((len(frames), 6))
            twists[:, self.free] = np.linalg.solve(change, -missed[..., None])[..., 0]
            frames[:, :3, :3] = rotations(twists[:, 3:]) @ frames[:, :3, :3]
            frames[:, :3, 3] += twists[:, :3]
        missed, change = self.misfit(frames, lengths)
        change[~np.isfinite(change).all(axis=(1, 2))] = 0.0
        loose = np.linalg.svd(change, compute_uv=False)[:, -1] < STIFFNESS
        converged = abs(missed).max(axis=1) <= RESIDUAL
        frames[loose | ~converged | (np.sign(np.linalg.det(change)) != side)] = np.nan
        return frames

    def stiffness(self, frame: Frame) -> tuple[float, float]:
        """Returns the least singular value of the Jacobian at a pose, and the sign of its determinant."""
        _, change = self.misfit(frame, np.ones(len(self.base)))
        return float(np.linalg.svd(change, compute_uv=False)[-1]), float(np.sign(np.linalg.det(change)))

    def middle(self) -> Frame:
        """Returns the pose (4, 4) with all legs in the middle of their travel and the plate upright over the base.

        Raises ValueError if there is no such pose, or the plate is loose in it.
        """
        up = 1 if len(self.free) == 3 else 2
        shift = self.base.mean(axis=0) - self.top.mean(axis=0)
        aside = np.delete(self.top + shift - self.base, up, axis=1)
        height = np.sqrt(np.maximum(1.0 - (aside**2).sum(axis=1), 0.01)).mean()
        frame = self.solve_pose(spatial(shift + height * np.eye(3)[up]), np.ones(len(self.base)), MANY)
        if frame is None:
            raise ValueError("all legs in the middle of their travel: the plate has no pose near upright")
        if frame[up, up] <= 0 or (self.joints(frame) - self.base)[:, up].mean() <= 0:
            raise ValueError("all legs in the middle of their travel: the plate is turned over or under its base")
        if self.stiffness(frame)[0] < STIFFNESS:
            raise ValueError(
                "all legs in the middle of their travel: the plate is loose, it can move though no leg changes its"
                " length; base and top must not be alike: turn the top's joints against the base's"
            )
        return frame

    def continued(self, frame: Frame, lengths: Array) -> Frame:
        """Returns the pose (4, 4) for lengths (L,) by continuation from the middle pose (4, 4).

        Raises ValueError if there is no such pose, or the plate is loose on the way.
        """
        side = self.stiffness(frame)[1]
        done, step = 0.0, FIRST_STEP
        while done < 1.0:
            share = min(done + step, 1.0)
            following = self.solve_pose(frame, 1.0 + share * (lengths - 1.0), FEW, CLOSE)
            if following is not None and self.firm(following, side):
                frame, done = following, share
            elif step > LAST_STEP:
                step /= 2
            else:
                raise ValueError(f"no assembly: the plate comes loose at {done:.0%} of the way from the legs' middle")
        return frame

    def firm(self, frame: Frame, side: float) -> bool:
        """Returns whether the plate is not loose in a pose (4, 4), and on the given side of singular poses."""
        stiffness, own = self.stiffness(frame)
        return stiffness >= STIFFNESS and own == side


def platform(base: ArrayLike, top: ArrayLike, lengths: tuple[float, float]) -> Module:
    """Returns a platform. Its actuators 1, 2, ... are the legs, in the order of the joints.

    Args:
        base: lower joints in the frame below, shape (6, 3), (3, 3), or (3, 2) in the plane.
        top: upper joints in the frame above, same shape.
        lengths: contracted and extended length of each leg.

    Raises:
        ValueError: the shapes are wrong, or a state has no assembly.
    """
    size = (lengths[0] + lengths[1]) / 2
    legs = legs_of(base, top, size)
    middle, bits = legs.middle(), binary_code(2 ** len(legs.base))
    frames = []
    for own in bits:
        try:
            frames.append(legs.continued(middle, np.array(lengths)[own] / size))
        except ValueError as error:
            extended = ", ".join(str(k + 1) for k in np.flatnonzero(own)) or "none"
            raise ValueError(f"extended legs {extended}: {error}") from None
    names = tuple(str(k + 1) for k in range(len(legs.base)))
    stack = np.array(frames)
    drawn = legs.bodies(stack) * size
    stack[:, :3, 3] *= size

    motion = partial(platform_motion, legs, middle, lengths)
    return Module(stack, bits, names, drawn, planar=len(legs.free) == 3, motion=motion)


def platform_motion(
    legs: Legs, middle: Frame, lengths: tuple[float, float], displacements: Array
) -> tuple[Frame, Array]:
    """Returns frames and bodies of a platform in mid-travel, see Module.motion; `middle` is its middle pose (4, 4)."""
    size = (lengths[0] + lengths[1]) / 2
    there = legs.track(middle, (lengths[0] + displacements * (lengths[1] - lengths[0])) / size)
    bodies = legs.bodies(there) * size
    there[:, :3, 3] *= size
    return there, bodies


def legs_of(base: ArrayLike, top: ArrayLike, size: float) -> Legs:
    """Returns the geometry of a platform from its joints, in units of `size`.

    Raises ValueError if the shapes are not those of a platform, or a leg of a 3-RPS has no plane.
    """
    shape: tuple[int, ...] = np.shape(base)
    if shape not in ((6, 3), (3, 3), (3, 2)) or np.shape(top) != shape:
        raise ValueError(
            f"a platform has 6 or 3 legs in space or 3 in the plane, got joints of shapes {shape} and {np.shape(top)}"
        )
    below, above = (np.pad(np.array(part, dtype=float), ((0, 0), (0, 3 - shape[1]))) for part in (base, top))
    normals = np.zeros((0, 3))
    if shape == (3, 3):
        radii = np.hypot(below[:, 0], below[:, 1])
        if radii.min() < 1e-6 * size:
            raise ValueError("a lower joint of three legs lies on the z axis: its leg has no plane to turn in")
        normals = np.column_stack([-below[:, 1], below[:, 0], np.zeros(3)]) / radii[:, None]
    return Legs(below / size, above / size, normals, (0, 1, 5) if shape == (3, 2) else (0, 1, 2, 3, 4, 5))


def rotations(turns: Array) -> Array:
    """Returns the rotations (n, 3, 3) of rotation vectors (n, 3) [rad]."""
    angles = np.linalg.norm(turns, axis=1)[:, None, None]
    x, y, z = turns.T
    crosses = np.moveaxis(np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]]), -1, 0)
    once, twice = np.sinc(angles / np.pi), np.sinc(angles / 2 / np.pi) ** 2 / 2
    return np.asarray(np.eye(3) + once * crosses + twice * crosses @ crosses)


def moved(frame: Frame, twist: Array) -> Frame:
    """Returns a frame (4, 4) displaced by a twist (6,) in the axes of the frame below."""
    angle = float(np.linalg.norm(twist[3:]))
    result = frame.copy()
    if angle > 0:
        result[:3, :3] = turned(twist[3:], angle)[:3, :3] @ frame[:3, :3]
    result[:3, 3] += twist[:3]
    return result

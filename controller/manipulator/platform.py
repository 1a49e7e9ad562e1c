"""The binary platform: a plate on legs of two lengths each, driven in parallel.

- Six legs in space, ball joints at both ends: Gough's and Stewart's platform.
- Three legs in space, ball joints above; below they swing about axes, in the plane through leg and z axis (3-RPS).
- Three legs in the plane, turning joints at both ends (3-RPR).

Leg i ends at t_i = b + R p_i, and the pose (R, b) is where |t_i - a_i| is the leg's length for all i; of six legs that
may be up to 40 poses. The one taken for a state is that which the plate is led to when all legs go evenly from the
middle of their travel to the state's lengths. It never passes a pose in which the plate is loose, where two poses meet
and the legs do not say which way it goes on.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.manipulator.frames import Frame, spatial, turned
from controller.manipulator.module import Module, binary_code

Array = NDArray[np.float64]

RESIDUAL = 1e-12  # of every leg's length, in shares of the middle length
STIFFNESS = 1e-3  # least: where it is less, a leg's error makes one of the pose a thousand times as large
FIRST_STEP, LAST_STEP = 1 / 8, 2.0**-12  # shares of the way from the middle lengths
MANY, FEW = 100, 8  # Newton's steps from a guess, and from nearby
CLOSE = 0.2  # most that a step moves and turns the plate, in middle lengths and radians


@dataclass(frozen=True, eq=False)
class Legs:
    """The geometry, in units of the middle length.

    Attributes:
        base: lower joints a_i in the frame below, shape (L, 3).
        top: upper joints p_i in the frame above, shape (L, 3).
        normals: of the planes through the z axis in which the legs swing, shape (L, 3), or none, shape (0, 3).
        free: motions that the plate has, of 0 to 2 along and 3 to 5 about x, y and z.
    """

    base: Array
    top: Array
    normals: Array
    free: tuple[int, ...]

    def joints(self, frames: Frame) -> Array:
        """Returns the upper joints t_i (..., L, 3) in the frame below, of frames (..., 4, 4)."""
        return np.asarray(self.top @ np.swapaxes(frames[..., :3, :3], -1, -2) + frames[..., None, :3, 3])

    def body(self, frame: Frame) -> Array:
        """Returns legs, base and plate as line segments (3 L, 2, 3)."""
        ends = self.joints(frame)
        return np.array([*zip(self.base, ends, strict=True), *around(self.base), *around(ends)])

    def misfit(self, frames: Frame, lengths: Array) -> tuple[Array, Array]:
        """Returns what each constraint misses (..., n), and how the plate's free motions change it (..., n, n)."""
        ends = self.joints(frames)
        legs = ends - self.base
        found = np.linalg.norm(legs, axis=-1)
        swinging = ends[..., : len(self.normals), :]
        directions = np.concatenate([legs / found[..., None], np.broadcast_to(self.normals, swinging.shape)], axis=-2)
        arms = np.concatenate([ends, swinging], axis=-2) - frames[..., None, :3, 3]
        missed = np.concatenate([found - lengths, (self.normals * swinging).sum(axis=-1)], axis=-1)
        return missed, np.concatenate([directions, np.cross(arms, directions)], axis=-1)[..., self.free]

    def settled(self, frame: Frame, lengths: Array, steps: int, reach: float = np.inf) -> Frame | None:
        """Returns the pose that so many of Newton's steps find, the first no longer than `reach`, or None."""
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
            if step == 0 and size > reach:
                return None
            frame = moved(frame, twist * (CLOSE / max(size, CLOSE)))
        return None

    def followed(self, frame: Frame, lengths: Array) -> Frame:
        """Returns the poses (n, 4, 4) near one, where legs have lengths (n, L); not numbers where it is loose."""
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
        settled = abs(missed).max(axis=1) <= RESIDUAL
        frames[loose | ~settled | (np.sign(np.linalg.det(change)) != side)] = np.nan
        return frames

    def stiffness(self, frame: Frame) -> tuple[float, float]:
        """Returns how much the least felt motion of the plate changes the legs, and on which side of loose it is."""
        _, change = self.misfit(frame, np.ones(len(self.base)))
        return float(np.linalg.svd(change, compute_uv=False)[-1]), float(np.sign(np.linalg.det(change)))

    def middle(self) -> Frame:
        """Returns the pose with all legs in the middle of their travel, the plate upright over the base.

        Raises:
            ValueError: there is none, or the plate is loose there.
        """
        up = 1 if len(self.free) == 3 else 2
        shift = self.base.mean(axis=0) - self.top.mean(axis=0)
        aside = np.delete(self.top + shift - self.base, up, axis=1)
        height = np.sqrt(np.maximum(1.0 - (aside**2).sum(axis=1), 0.01)).mean()
        frame = self.settled(spatial(shift + height * np.eye(3)[up]), np.ones(len(self.base)), MANY)
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

    def led(self, frame: Frame, lengths: Array) -> Frame:
        """Returns the pose that the plate is led to from its middle pose.

        Raises:
            ValueError: there is none, or it passes a loose one.
        """
        side = self.stiffness(frame)[1]
        done, step = 0.0, FIRST_STEP
        while done < 1.0:
            share = min(done + step, 1.0)
            following = self.settled(frame, 1.0 + share * (lengths - 1.0), FEW, CLOSE)
            if following is not None and self.firm(following, side):
                frame, done = following, share
            elif step > LAST_STEP:
                step /= 2
            else:
                raise ValueError(f"no assembly: the plate comes loose at {done:.0%} of the way from the legs' middle")
        return frame

    def firm(self, frame: Frame, side: float) -> bool:
        """Returns whether the plate is not loose, nor beyond a pose in which it is."""
        stiffness, own = self.stiffness(frame)
        return stiffness >= STIFFNESS and own == side


def platform(base: ArrayLike, top: ArrayLike, lengths: tuple[float, float]) -> Module:
    """Returns a platform; its actuators 1, 2, ... are the legs, in the order of the joints.

    Args:
        base: lower joints in the frame below, shape (6, 3), (3, 3), or (3, 2) for one in the plane.
        top: upper joints in the frame above, likewise.
        lengths: of every leg, contracted and extended.

    Raises:
        ValueError: the shapes are others, or a state has no assembly.
    """
    size = (lengths[0] + lengths[1]) / 2
    legs = legs_of(base, top, size)
    middle, bits = legs.middle(), binary_code(2 ** len(legs.base))
    frames = []
    for own in bits:
        try:
            frames.append(legs.led(middle, np.array(lengths)[own] / size))
        except ValueError as error:
            extended = ", ".join(str(k + 1) for k in np.flatnonzero(own)) or "none"
            raise ValueError(f"extended legs {extended}: {error}") from None
    names = tuple(str(k + 1) for k in range(len(legs.base)))
    drawn = np.array([legs.body(frame) for frame in frames]) * size
    stack = np.array(frames)
    stack[:, :3, 3] *= size

    def motion(strokes: Array) -> tuple[Frame, Array]:
        there = legs.followed(middle, (lengths[0] + strokes * (lengths[1] - lengths[0])) / size)
        bodies = np.array([legs.body(frame) for frame in there]) * size
        there[:, :3, 3] *= size
        return there, bodies

    return Module(stack, bits, names, drawn, planar=len(legs.free) == 3, motion=motion)


def legs_of(base: ArrayLike, top: ArrayLike, size: float) -> Legs:
    """Returns the geometry of a platform's joints, in units of `size`.

    Raises:
        ValueError: the joints' shapes are others than those of a platform, or a leg of three has no plane.
    """
    shape: tuple[int, ...] = np.shape(base)
    if shape not in ((6, 3), (3, 3), (3, 2)) or np.shape(top) != shape:
        raise ValueError(f"6 or 3 legs in space or 3 in the plane are known, not joints {shape} and {np.shape(top)}")
    below, above = (np.pad(np.array(part, dtype=float), ((0, 0), (0, 3 - shape[1]))) for part in (base, top))
    normals = np.zeros((0, 3))
    if shape == (3, 3):
        radii = np.hypot(below[:, 0], below[:, 1])
        if radii.min() < 1e-6 * size:
            raise ValueError("a lower joint of three legs lies on the z axis: its leg has no plane to swing in")
        normals = np.column_stack([-below[:, 1], below[:, 0], np.zeros(3)]) / radii[:, None]
    return Legs(below / size, above / size, normals, (0, 1, 5) if shape == (3, 2) else (0, 1, 2, 3, 4, 5))


def around(joints: Array) -> list[tuple[Array, Array]]:
    """Returns the sides of a plate with these joints (L, 3)."""
    return list(zip(joints, np.roll(joints, -1, axis=0), strict=True))


def rotations(turns: Array) -> Array:
    """Returns the rotations (n, 3, 3) about axes, by their lengths [rad] (n, 3)."""
    angles = np.linalg.norm(turns, axis=1)[:, None, None]
    x, y, z = turns.T
    crosses = np.moveaxis(np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]]), -1, 0)
    once, twice = np.sinc(angles / np.pi), np.sinc(angles / 2 / np.pi) ** 2 / 2
    return np.asarray(np.eye(3) + once * crosses + twice * crosses @ crosses)


def moved(frame: Frame, twist: Array) -> Frame:
    """Returns a frame moved along and turned about the axes below it by a twist (6,)."""
    angle = float(np.linalg.norm(twist[3:]))
    result = frame.copy()
    if angle > 0:
        result[:3, :3] = turned(twist[3:], angle)[:3, :3] @ frame[:3, :3]
    result[:3, 3] += twist[:3]
    return result

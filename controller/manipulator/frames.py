"""Frames (R, b) as homogeneous 4x4 matrices. A planar frame is a spatial frame in the plane z = 0."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Frame = Array


def planar(x: float, y: float, angle: float = 0.0) -> Frame:
    """Returns the 4x4 frame at (x, y), turned counter-clockwise by `angle` [rad] about z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def spatial(position: ArrayLike, quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0)) -> Frame:
    """Returns frames (..., 4, 4) at positions (..., 3), turned by quaternions (..., 4): x, y, z, w of any length."""
    q = np.asarray(quaternion, dtype=float)
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    frames = np.zeros((*q.shape[:-1], 4, 4))
    frames[..., :3, :3] = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    frames[..., :3, 3], frames[..., 3, 3] = position, 1.0
    return frames


def turned(axis: ArrayLike, angle: float) -> Frame:
    """Returns the 4x4 frame turned by `angle` [rad] about `axis` (3,), not 0, by the right-hand rule."""
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    return spatial((0.0, 0.0, 0.0), [*(math.sin(angle / 2) * unit), math.cos(angle / 2)])


def inverse(frames: Frame) -> Frame:
    """Returns the inverses (R^T, -R^T b) of frames (..., 4, 4)."""
    result = np.zeros_like(frames)
    rotation = np.swapaxes(frames[..., :3, :3], -1, -2)
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation, frames[..., :3, 3])
    result[..., 3, 3] = 1.0
    return result


def angle(frame: Frame) -> float:
    """Returns the counter-clockwise angle [rad] of a planar frame (4, 4), in (-pi, pi]."""
    return math.atan2(frame[1, 0], frame[0, 0])


def quaternion(frame: Frame) -> NDArray[np.float64]:
    """Returns the unit quaternion (x, y, z, w), w >= 0, of a frame (4, 4)."""
    r = frame[:3, :3]
    # The largest of the four squared components is the divisor, to avoid cancellation.
    squares = np.array([1 + 2 * r[i, i] - np.trace(r) for i in range(3)] + [1 + np.trace(r)])
    k = int(np.argmax(squares))
    products = np.array(
        [
            [squares[0], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], squares[1], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], squares[2], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]],
        ]
    )
    q = products[k] / np.linalg.norm(products[k])
    return np.asarray(q if q[3] >= 0 else -q)


def angle_between(first: Frame, second: Frame) -> float:
    """Returns the angle [rad] between the orientations of two frames (4, 4), in [0, pi].

    The function is written as a loop because numba compiles it, see frame_kernels.
    """
    trace = 0.0
    turned = np.zeros((3, 3))  # R^T R'
    for a in range(3):
        for b in range(3):
            for c in range(3):
                turned[a, b] += first[c, a] * second[c, b]
        trace += turned[a, a]
    x, y, z = turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]
    return math.atan2(math.sqrt(x * x + y * y + z * z), trace - 1.0)  # twice its sine, twice its cosine

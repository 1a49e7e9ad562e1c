"""An independent model of moving arms in plain NumPy; each actuator starts and ends at its own time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp

from hyperbit.controller.manipulator.frames import planar
from hyperbit.controller.manipulator.joints import revolute
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module, transforms
from hyperbit.controller.manipulator.platform import platform
from hyperbit.controller.manipulator.vgt import vgt
from tests.obstacles.dense import Shape, along, nearest

Moves = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Part:
    """A module, with its frames (n, 4, 4) and lines (n, L, 2, 3) at displacements (n, A)."""

    module: Module
    moves: Moves


def turned(angle: np.ndarray, position: np.ndarray) -> np.ndarray:
    frames = np.tile(np.eye(4), (len(angle), 1, 1))
    frames[:, 0, 0] = frames[:, 1, 1] = np.cos(angle)
    frames[:, 1, 0], frames[:, 0, 1] = np.sin(angle), -np.sin(angle)
    frames[:, :2, 3] = position
    return frames


def corner(p: np.ndarray, q: np.ndarray, from_p: np.ndarray, from_q: np.ndarray) -> np.ndarray:
    """The apex to the left of p -> q, complex numbers, by the law of cosines."""
    side = abs(q - p)
    cosine = (side**2 + from_p**2 - from_q**2) / (2 * side * from_p)
    return p + from_p * np.exp(1j * (np.angle(q - p) + np.arccos(cosine)))


def truss(diagonal: str, width: float, low: float, high: float) -> Part:
    def moves(displacements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        left, across, right = (low + displacements * (high - low)).T
        a, b, w = np.full(len(displacements), -width / 2 + 0j), np.full(len(displacements), width / 2 + 0j), width
        if diagonal == "BC":
            c = corner(a, b, left, across)
            d = corner(c, b, np.full(len(c), w), right)
        else:
            d = corner(a, b, across, right)
            c = corner(a, d, left, np.full(len(a), w))
        middle = (c + d) / 2
        frames = turned(np.angle(d - c), np.c_[middle.real, middle.imag])
        pairs = [(a, c), (b, c) if diagonal == "BC" else (a, d), (b, d), (c, d)]
        lines = np.array([[[p.real, p.imag, 0 * p.real] for p in pair] for pair in pairs])
        return frames, np.moveaxis(lines, -1, 0)

    return Part(vgt(diagonal, width, *[(low, high)] * 3), moves)  # type: ignore[arg-type]


def straight(frames: np.ndarray) -> np.ndarray:
    lines = np.zeros((len(frames), 1, 2, 3))
    lines[:, 0, 1] = frames[:, :3, 3]
    return lines


def hinge(first: float, second: float, length: float) -> Part:
    def moves(displacements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle = first + displacements[:, 0] * (second - first)
        frames = turned(angle, length * np.c_[np.cos(angle), np.sin(angle)])
        return frames, straight(frames)

    return Part(revolute((0, 0, 1), [first, second], planar(length, 0.0)), moves)


def pair(first: np.ndarray, second: np.ndarray) -> Part:
    """A module of two listed frames; in mid-travel it translates linearly and turns about one axis."""
    both = Slerp([0, 1], Rotation.from_matrix([first[:3, :3], second[:3, :3]]))

    def moves(displacements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share = displacements[:, 0]
        frames = np.tile(np.eye(4), (len(share), 1, 1))
        frames[:, :3, :3] = both(share).as_matrix()
        frames[:, :3, 3] = first[:3, 3] + share[:, None] * (second[:3, 3] - first[:3, 3])
        return frames, straight(frames)

    return Part(transforms([first, second], planar=False), moves)


def hexapod(base: Sequence[Sequence[float]], top: Sequence[Sequence[float]], low: float, high: float) -> Part:
    module, below, above = platform(base, top, (low, high)), np.array(base), np.array(top)

    def ends(at: np.ndarray) -> np.ndarray:
        turns = Rotation.from_rotvec(at[:, 3:]).as_matrix()
        return np.asarray(at[:, None, :3] + above @ np.swapaxes(turns, 1, 2))

    def moves(displacements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nearby = np.array([int(np.argmin(abs(module.bits - s).sum(axis=1))) for s in displacements])
        start = module.frames[nearby]
        at = np.c_[start[:, :3, 3], Rotation.from_matrix(start[:, :3, :3]).as_rotvec()]
        wanted = low + displacements * (high - low)
        for _ in range(12):  # Newton's steps, by differences
            missed = np.linalg.norm(ends(at) - below, axis=2) - wanted
            if abs(missed).max() < 1e-12:
                break
            change = np.empty((len(at), 6, 6))
            for k in range(6):
                aside = at + 1e-7 * np.eye(6)[k]
                change[:, :, k] = (np.linalg.norm(ends(aside) - below, axis=2) - wanted - missed) / 1e-7
            at = at - np.linalg.solve(change, missed[..., None])[..., 0]
        assert abs(missed).max() < 1e-10
        frames = np.tile(np.eye(4), (len(at), 1, 1))
        frames[:, :3, :3], frames[:, :3, 3] = Rotation.from_rotvec(at[:, 3:]).as_matrix(), at[:, :3]
        tips, floor = ends(at), np.broadcast_to(below, (len(at), 6, 3))
        lines = [(floor, tips), (floor, np.roll(floor, -1, axis=1)), (tips, np.roll(tips, -1, axis=1))]
        return frames, np.concatenate([np.stack(ends, axis=2) for ends in lines], axis=1)

    return Part(module, moves)


def arm(parts: Sequence[Part], base: np.ndarray | None = None) -> Manipulator:
    return Manipulator([part.module for part in parts], base)


def motion(rng: np.random.Generator, before: np.ndarray, after: np.ndarray, samples: int) -> np.ndarray:
    """Displacements (samples, A) of one transition; each actuator starts and ends at its own time."""
    begin, end = np.sort(rng.random((2, len(before))), axis=0)
    end = np.maximum(end, begin + 0.01)
    times = np.sort(rng.random(samples))[:, None]
    share = np.clip((times - begin) / (end - begin), 0.0, 1.0)
    return np.asarray(before + share * (after.astype(float) - before))


def placed(parts: Sequence[Part], base: np.ndarray, displacements: np.ndarray) -> list[np.ndarray]:
    """Line segments (n, L, 2, 3) of every module in the world at displacements (n, A)."""
    chain, first, lines = np.tile(base, (len(displacements), 1, 1)), 0, []
    for part in parts:
        own = displacements[:, first : first + len(part.module.actuators)]
        first += own.shape[1]
        distinct, which = np.unique(own, axis=0, return_inverse=True)
        frames, body = (values[which] for values in part.moves(distinct))
        lines.append(np.einsum("nab,nlsb->nlsa", chain[:, :3, :3], body) + chain[:, None, None, :3, 3])
        chain = chain @ frames
    return lines


def room(
    parts: Sequence[Part], base: np.ndarray, obstacles: list[Shape], displacements: np.ndarray, points: int, pairs: bool
) -> tuple[float, float]:
    """Least signed distance of modules from obstacles, and of modules from modules that are no neighbours."""
    lines = placed(parts, base, displacements)
    every = np.concatenate([own.reshape(-1, 2, 3) for own in lines])
    apart = np.inf
    if pairs:
        for i in range(len(lines)):
            for j in range(i - 1):
                for first, second in zip(lines[i], lines[j], strict=True):
                    apart = min(apart, cKDTree(along(first, points)).query(along(second, points))[0].min())
    return nearest(every, obstacles, points), apart

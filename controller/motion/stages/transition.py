"""One transition: frames of its modules in every intermediate state, and the deviation of the tip from a line."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import boolean, float64, types, uint8
from numpy.typing import NDArray

from hyperbit.controller.host.kernel import kernel
from hyperbit.controller.manipulator.frame_kernels import compose, set_identity
from hyperbit.controller.manipulator.kernel_types import F1, F2, F3, F4, I1, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Known = NDArray[np.bool_]

COUNTED = 12  # most actuators for which all subsets are enumerated
STARTS = 16  # random starts of the ascent to the greatest deviation, beside the two ends


class MovingModules(NamedTuple):
    """The frames of m modules that move. A module's mask has a bit for each of its switched actuators."""

    # of each module for each mask, composed with its neighbours that do not move, shape (m, 2^bits, 3, 3)
    rotations: Array
    translations: Array  # likewise, shape (m, 2^bits, 3)
    known: Known  # whether the module has a state for the mask, shape (m, 2^bits)


MOVING = named(MovingModules, F4, F3, boolean[:, ::1])


@dataclass(frozen=True, eq=False)
class Transition:
    """One transition: n actuators switch, in m modules."""

    actuators: Index  # indices into the arm's actuators, shape (n,)
    owners: Index  # module of each actuator, shape (n,)
    flags: Index  # bit of each actuator in its module's mask, shape (n,)
    modules: MovingModules  # frames of the modules
    end: Index  # masks after the transition, shape (m,)
    line: Array  # tip before and after, shape (2, 3)
    unknown: float = np.inf  # deviation that is assumed for masks without a state

    def masks(self, stages: list[Index]) -> Index:
        """Returns the masks (m,) after stages, each of indices (k,) into `actuators`."""
        masks = np.zeros_like(self.end)
        for stage in stages:
            np.add.at(masks, self.owners[stage], self.flags[stage])
        return masks

    def deviations(self, masks: Index, stage: Index) -> Array:
        """Returns the deviations (2^k,) after each subset of a stage (k,), from masks (m,); bit j is stage[j]."""
        return np.asarray(subsets(self.modules, self.owners, self.flags, self.line, masks, stage, self.unknown))

    def greatest(self, masks: Index, stage: Index) -> float:
        """Returns the greatest of `deviations`; above COUNTED actuators the greatest found by coordinate ascent."""
        if len(stage) <= COUNTED:
            return float(self.deviations(masks, stage).max())
        modules, every = self.modules, np.arange(self.modules.known.shape[1])
        lower, upper = masks[:, None], (masks + self.masks([stage]))[:, None]
        between = (every & lower == lower) & (every | upper == upper)
        if self.unknown == np.inf and (between & ~modules.known).any():
            return np.inf
        mixed = np.random.default_rng(0).integers(0, 2, (STARTS, len(masks)), dtype=bool)
        starts = [masks.copy(), upper[:, 0].copy(), *np.where(mixed, upper[:, 0], masks)]
        allowed = modules._replace(known=between & modules.known)
        return max(float(ascend(allowed, self.line, masks)) for masks in starts)

    def singles(self, masks: Index) -> Array:
        """Returns the deviations (k, n) after one more actuator, from masks (k, m); infinite if it cannot switch."""
        return np.asarray(singles(self.modules, self.owners, self.flags, self.line, masks))

    def back(self) -> "Transition":
        """Returns the reverse transition, through the same states."""
        rows, masks = np.arange(len(self.end))[:, None], self.end[:, None] ^ np.arange(self.modules.known.shape[1])
        modules = MovingModules(*(np.ascontiguousarray(array[rows, masks]) for array in self.modules))
        return replace(self, modules=modules, line=self.line[::-1].copy())


@kernel("f8(f8[::1], f8[:,::1])", inline="always")
def deviation(point: Array, line: Array) -> float:
    """Returns the distance of a point (3,) from the line segment between two points (2, 3)."""
    dot, square, away = 0.0, 0.0, 0.0
    for i in range(3):
        along = line[1, i] - line[0, i]
        square += along * along
        dot += along * (point[i] - line[0, i])
    part = min(max(dot / square, 0.0), 1.0) if square > 0 else 0.0
    for i in range(3):
        away += (point[i] - line[0, i] - part * (line[1, i] - line[0, i])) ** 2
    return float(np.sqrt(away))


@kernel("void(f8[:,::1], f8[::1], f8[::1], f8[::1])", inline="always")
def carry(r: Array, b: Array, point: Array, out: Array) -> None:
    """Writes b + R p; `out` may be the point itself."""
    x, y, z = point[0], point[1], point[2]
    for i in range(3):
        out[i] = b[i] + r[i, 0] * x + r[i, 1] * y + r[i, 2] * z


@kernel([F1(MOVING, I1, I1, F2, I1, I1, float64)])
def subsets(
    modules: MovingModules, owners: Index, flags: Index, line: Array, masks: Index, stage: Index, unknown: float
) -> Array:
    """Returns the deviation of each subset of a stage; see Transition.deviations."""
    r, b, known = modules
    slots, count = np.full(len(masks), -1), 0
    for j in range(len(stage)):
        slots[owners[stage[j]]] = 0
    # Modules that do not move are composed once: a lead before each moving module, and one after the last.
    lead_r, lead_b = np.empty((len(stage) + 1, 3, 3)), np.empty((len(stage) + 1, 3))
    for k in range(len(stage) + 1):
        set_identity(lead_r[k], lead_b[k])
    moving = np.empty(len(stage), dtype=np.int64)
    for i in range(len(masks)):
        if slots[i] == 0:
            moving[count], slots[i] = i, count
            count += 1
        else:
            at = masks[i]
            compose(lead_r[count], lead_b[count], r[i, at], b[i, at], lead_r[count], lead_b[count])
    result, point, states = np.empty(1 << len(stage)), np.empty(3), np.empty(count, dtype=np.int64)
    for subset in range(len(result)):
        for k in range(count):
            states[k] = masks[moving[k]]
        for j in range(len(stage)):
            if subset >> j & 1:
                states[slots[owners[stage[j]]]] |= flags[stage[j]]
        for a in range(3):
            point[a] = lead_b[count, a]
        valid = True
        for k in range(count - 1, -1, -1):
            i, state = moving[k], states[k]
            valid &= known[i, state]
            carry(r[i, state], b[i, state], point, point)
            carry(lead_r[k], lead_b[k], point, point)
        result[subset] = deviation(point, line) if valid else unknown
    return result


@kernel("void(f8[:,:,:,::1], f8[:,:,::1], i8[::1], f8[:,::1])")
def fill_tails(r: Array, b: Array, masks: Index, tails: Array) -> None:
    """Writes the tip in the frame of each module, shape (m + 1, 3)."""
    tails[len(masks)] = 0.0
    for i in range(len(masks) - 1, -1, -1):
        carry(r[i, masks[i]], b[i, masks[i]], tails[i + 1], tails[i])


@kernel([float64(MOVING, F2, I1)])
def ascend(modules: MovingModules, line: Array, masks: Index) -> float:
    """Changes one mask at a time as long as the deviation grows; returns the deviation of that local maximum.

    Args:
        modules: frames; `known` for masks that are allowed.
        line: see Transition.
        masks: to begin with, shape (m,); overwritten.
    """
    r, b, allowed = modules
    tails, point = np.empty((len(masks) + 1, 3)), np.empty(3)
    head_r, head_b = np.empty((3, 3)), np.empty(3)
    fill_tails(r, b, masks, tails)
    best, before = deviation(tails[0], line), -1.0
    while best > before:
        before = best
        set_identity(head_r, head_b)
        for i in range(len(masks)):
            for mask in range(allowed.shape[1]):
                if allowed[i, mask]:
                    carry(r[i, mask], b[i, mask], tails[i + 1], point)
                    carry(head_r, head_b, point, point)
                    away = deviation(point, line)
                    if away > best:
                        best, masks[i] = away, mask
            compose(head_r, head_b, r[i, masks[i]], b[i, masks[i]], head_r, head_b)
        fill_tails(r, b, masks, tails)
    return float(best)


@kernel([F2(MOVING, I1, I1, F2, types.int64[:, ::1])])
def singles(modules: MovingModules, owners: Index, flags: Index, line: Array, masks: Index) -> Array:
    """Returns the deviation after one more actuator, from each of the masks; see Transition.singles."""
    r, b, known = modules
    result, m = np.full((len(masks), len(owners)), np.inf), len(r)
    heads_r, heads_b, tails, point = np.empty((m + 1, 3, 3)), np.empty((m + 1, 3)), np.empty((m + 1, 3)), np.empty(3)
    set_identity(heads_r[0], heads_b[0])
    for k in range(len(masks)):
        fill_tails(r, b, masks[k], tails)
        for i in range(m):
            mask = masks[k, i]
            compose(heads_r[i], heads_b[i], r[i, mask], b[i, mask], heads_r[i + 1], heads_b[i + 1])
        for j in range(len(owners)):
            i = owners[j]
            mask = masks[k, i] | flags[j]
            if mask != masks[k, i] and known[i, mask]:
                carry(r[i, mask], b[i, mask], tails[i + 1], point)
                carry(heads_r[i], heads_b[i], point, point)
                result[k, j] = deviation(point, line)
    return result


def build_transition(manipulator: Manipulator, start: Configuration, end: Configuration) -> Transition:
    """Returns the transition between configurations (B,)."""
    m, every = manipulator, np.arange(len(manipulator.modules))
    differ = m.bits[every, start] != m.bits[every, end]  # (B, Amax)
    counts = differ.sum(axis=1)
    modules, columns = np.nonzero(differ)
    moving, owners = np.unique(modules, return_inverse=True)
    flags = 1 << (np.cumsum(differ, axis=1)[modules, columns] - 1)
    offsets = np.cumsum([0, *(len(module.actuators) for module in m.modules)])
    size = 1 << int(counts.max())
    rotations, translations = np.tile(np.eye(3), (len(moving), size, 1, 1)), np.zeros((len(moving), size, 3))
    frames = MovingModules(rotations, translations, np.zeros((len(moving), size), dtype=np.bool_))
    before = np.asarray(start, dtype=np.int64)
    fill_frames(m.base, m.rotations, m.translations, m.bits, m.states, before, differ, frames)
    line = np.array([m.tip(start)[:3, 3], m.tip(end)[:3, 3]])
    ended = (1 << counts[moving]) - 1
    return Transition(offsets[modules] + columns, owners, flags, frames, ended, line)


@kernel([types.void(F2, F4, F3, uint8[:, :, ::1], I1, I1, boolean[:, ::1], MOVING)])
def fill_frames(
    base: Array,
    rotations: Array,
    translations: Array,
    bits: NDArray[np.uint8],
    states: Index,
    start: Index,
    differ: Known,
    moving: MovingModules,
) -> None:
    """Writes the frames of the modules that move.

    Args:
        base: frame F_0 in the world, shape (4, 4).
        rotations: configuration sets, shape (B, Kmax, 3, 3).
        translations: configuration sets, shape (B, Kmax, 3).
        bits: actuator states of each module state, shape (B, Kmax, Amax).
        states: K_i, shape (B,).
        start: configuration before, shape (B,).
        differ: which actuators of each module switch, shape (B, Amax).
        moving: written; on entry identities, zeros and false.
    """
    out_r, out_b, known = moving
    lead_r, lead_b, row = base[:3, :3].copy(), base[:3, 3].copy(), -1
    for i in range(len(start)):
        own = start[i]
        if not differ[i].any():
            compose(lead_r, lead_b, rotations[i, own], translations[i, own], lead_r, lead_b)
            continue
        row += 1
        for state in range(states[i]):
            mask, flag, between = 0, 1, True
            for j in range(differ.shape[1]):
                switched = bits[i, state, j] != bits[i, own, j]
                if differ[i, j]:
                    mask |= flag * switched
                    flag <<= 1
                else:
                    between &= not switched
            if between:
                r, b = rotations[i, state], translations[i, state]
                compose(lead_r, lead_b, r, b, out_r[row, mask], out_b[row, mask])
                known[row, mask] = True
        set_identity(lead_r, lead_b)
    if row >= 0:  # modules after the last moving one
        for mask in range(known.shape[1]):
            r, b = out_r[row, mask], out_b[row, mask]
            compose(r, b, lead_r, lead_b, r, b)

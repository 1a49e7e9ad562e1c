"""Builds a transition between two configurations: the frames of each module in every intermediate state."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.manipulator.frame_kernels import compose, set_identity
from controller.manipulator.manipulator import Configuration, Manipulator
from controller.motion.stages.deviation import Array, Index, Known, Transition


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
    known = np.zeros((len(moving), size), dtype=np.bool_)
    before = np.asarray(start, dtype=np.int64)
    fill_links(m.base, m.rotations, m.translations, m.bits, m.states, before, differ, rotations, translations, known)
    line = np.array([m.tip(start)[:3, 3], m.tip(end)[:3, 3]])
    ended = (1 << counts[moving]) - 1
    return Transition(offsets[modules] + columns, owners, flags, rotations, translations, known, ended, line)


@njit(
    "void(f8[:,::1], f8[:,:,:,::1], f8[:,:,::1], u1[:,:,::1], i8[::1], i8[::1], b1[:,::1], f8[:,:,:,::1], f8[:,:,::1],"
    " b1[:,::1])",
    cache=True,
    nogil=True,
)
def fill_links(
    base: Array,
    rotations: Array,
    translations: Array,
    bits: NDArray[np.uint8],
    states: Index,
    start: Index,
    differ: Known,
    out_r: Array,
    out_b: Array,
    known: Known,
) -> None:
    """Writes `rotations`, `translations` and `known` of a Transition from the arm's arrays; see Manipulator.

    Args:
        base: of the arm.
        rotations: of the arm.
        translations: of the arm.
        bits: of the arm.
        states: of the arm.
        start: configuration before, shape (B,).
        differ: which actuators of each module switch, shape (B, Amax).
        out_r: rotations of each moving module for each mask; identities on entry.
        out_b: translations, likewise; zeros on entry.
        known: likewise; false on entry.
    """
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

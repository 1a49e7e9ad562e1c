"""Builds a transition between two configurations: the frames of each module in every intermediate state."""

from typing import NamedTuple

import numpy as np
from numba import boolean, njit, types, uint8
from numpy.typing import NDArray

from hyperbit.controller.manipulator.frame_kernels import compose, set_identity
from hyperbit.controller.manipulator.kernel_types import F2, F3, F4, I1, named
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.motion.stages.deviation import MOVING, Array, Index, Known, MovingModules, Transition


class ModuleStates(NamedTuple):
    """The states of an arm's modules; see Manipulator."""

    base: Array  # frame F_0 in the world, shape (4, 4)
    rotations: Array  # configuration sets, shape (B, Kmax, 3, 3)
    translations: Array  # configuration sets, shape (B, Kmax, 3)
    bits: NDArray[np.uint8]  # actuator states of each module state, shape (B, Kmax, Amax)
    states: Index  # K_i, shape (B,)


MODULE_STATES = named(ModuleStates, F2, F4, F3, uint8[:, :, ::1], I1)


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
    own = ModuleStates(m.base, m.rotations, m.translations, m.bits, m.states)
    fill_frames(own, np.asarray(start, dtype=np.int64), differ, frames)
    line = np.array([m.tip(start)[:3, 3], m.tip(end)[:3, 3]])
    ended = (1 << counts[moving]) - 1
    return Transition(offsets[modules] + columns, owners, flags, frames, ended, line)


@njit([types.void(MODULE_STATES, I1, boolean[:, ::1], MOVING)], cache=True, nogil=True)
def fill_frames(arm: ModuleStates, start: Index, differ: Known, moving: MovingModules) -> None:
    """Writes the frames of the modules that move.

    Args:
        arm: its modules.
        start: configuration before, shape (B,).
        differ: which actuators of each module switch, shape (B, Amax).
        moving: written; on entry identities, zeros and false.
    """
    base, rotations, translations, bits, states = arm
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

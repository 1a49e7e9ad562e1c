"""Stages of a motion program: packed actuator states, groups of jogged actuators, and the delay of the first stage."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # their kernels take seconds to import
    from hyperbit.controller.motion.trajectory import Trajectory

States = NDArray[np.uint8]


def pack_states(states: States) -> list[bytes]:
    """Returns actuator states (k, A) in the executor's packing: actuator a is bit a % 8 of byte a // 8."""
    return [row.tobytes() for row in np.packbits(states, axis=1, bitorder="little")]


def unpack_states(packed: bytes, actuators: int) -> States:
    """Returns actuator states (A,) from the executor's packing."""
    return np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=actuators, bitorder="little")


def delay_of(trajectory: Trajectory, needed: float) -> float:
    """Returns t = 0 of a trajectory without a stamp, as a delay after the executor accepts the program [s].

    The delay gives the first point's actuators the time they need. The times between points stay as they are.

    Args:
        trajectory: the goal.
        needed: time from acceptance until the first point's actuators can have settled [s].
    """
    return max(needed - float(trajectory.times[0]), 0.0)


def in_groups(states: States, target: States, most: int) -> States:
    """Returns stages (k, A) between two actuator states (A,), with at most `most` actuators at once, base first.

    The stages may end in states that are no configuration.
    """
    changes = np.flatnonzero(states != target)
    stages, current = list[States](), states.copy()
    for start in range(0, len(changes), most):
        current = current.copy()
        group = changes[start : start + most]
        current[group] = target[group]
        stages.append(current)
    return np.array(stages or [target])

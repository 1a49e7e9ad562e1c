"""Stages of a motion program: packed states, jogged groups, restaging, and the delay of the first stage."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # their kernels take seconds to import
    from hyperbit.controller.manipulator.manipulator import Manipulator
    from hyperbit.controller.motion.trajectory import Trajectory

States = NDArray[np.uint8]


def packed(states: NDArray[np.generic]) -> bytes:
    """Returns actuator states (A,) in the executor's packing: actuator a is bit a % 8 of byte a // 8."""
    return np.packbits(states.astype(np.bool_), bitorder="little").tobytes()


def pack_states(states: States) -> list[bytes]:
    """Returns actuator states (k, A), each row packed as by `packed`."""
    return [row.tobytes() for row in np.packbits(states, axis=1, bitorder="little")]


def unpack_states(packed: bytes, actuators: int) -> States:
    """Returns actuator states (A,) from the executor's packing."""
    return np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=actuators, bitorder="little")


def delay_of(trajectory: Trajectory, needed: float) -> float:
    """Returns t = 0 of a trajectory without a stamp, as a delay after the executor accepts the program [s].

    The delay gives the first point's actuators the time `needed` to settle [s]. The times between points stay.
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


def restage(manipulator: Manipulator, states: States, stages: States, most: int) -> States:
    """Returns the stages of a transition, planned as `stages` (k, A), from other actuator states (A,).

    Actuators that are already in their last state do not switch. If the states are those of the plan, the planned
    stages are returned. Each stage ends in a configuration. At most `most` actuators switch at once.
    """
    result: list[States] = []
    for stage in np.where(states == stages[-1], states, stages):
        if not is_configuration(manipulator, stage):
            continue
        while np.count_nonzero(states != stage) > most:
            states = step(manipulator, states, stage, most)
            result.append(states)
        if (states != stage).any():
            states = stage
            result.append(states)
    return np.array(result or [stages[-1]])


def step(manipulator: Manipulator, states: States, wanted: States, most: int) -> States:
    """Returns the states (A,) after one stage from `states` towards `wanted`, the states of two configurations.

    Modules switch in order from the base. A module that exceeds the bound alone switches alone, in several stages.
    """
    result, budget, start = states.copy(), most, 0
    for module in manipulator.modules:
        own = slice(start, start + len(module.actuators))
        start = own.stop
        switches = int(np.count_nonzero(states[own] != wanted[own]))
        if switches > budget == most:
            result[own] = module_step(module.bits, states[own], wanted[own], most)
            return result
        if switches <= budget:
            result[own] = wanted[own]
            budget -= switches
    return result


def module_step(codes: States, code: States, wanted: States, most: int) -> States:
    """Returns the first code (a,) on a shortest path from `code` to `wanted` among a module's codes (K, a).

    Raises:
        ValueError: no path has at most `most` switches a step.
    """
    layer = seen = (codes == wanted).all(axis=1)
    near = (codes != code).sum(axis=1) <= most
    while not (layer & near).any():
        layer = ~seen & ((codes[:, None] != codes[layer]).sum(axis=2) <= most).any(axis=1)
        if not layer.any():
            raise ValueError(f"no path from {code.tolist()} to {wanted.tolist()} with {most} actuators at once")
        seen = seen | layer
    options = codes[layer & near]
    return np.asarray(options[np.argmin((options != wanted).sum(axis=1))])


def is_configuration(manipulator: Manipulator, states: States) -> bool:
    try:
        manipulator.configuration(states)
    except ValueError:
        return False
    return True

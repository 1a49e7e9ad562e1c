"""Locked actuators: the reduced arm, whose modules have only the states that the locked actuators permit.

The reduced arm has the same actuators in the same order. Actuator states (A,) are valid for both arms, so they convert
configurations from one arm to the other. The numbers of states of the modules differ.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.armfile.locks import STATES

if TYPE_CHECKING:  # its kernel takes a second to import
    from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator

LockedStates = NDArray[np.int8]  # state in which each actuator is locked, -1 if it is free, shape (A,)


def none_locked(manipulator: Manipulator) -> LockedStates:
    """Returns the locked states (A,) of an arm without locked actuators."""
    return np.full(len(manipulator.actuators), -1, dtype=np.int8)


def require_states(manipulator: Manipulator, locked: LockedStates) -> None:
    """Raises ValueError unless locked states (A,) have the right shape and leave each module a state."""
    permitted_states(manipulator, locked)


def permitted_states(manipulator: Manipulator, locked: LockedStates) -> list[NDArray[np.bool_]]:
    """Returns which states of each module locked states (A,) permit, shape (K,) each. See require_states."""
    if locked.shape != (len(manipulator.actuators),):
        raise ValueError(
            f"the arm has {len(manipulator.actuators)} actuators, got locked states of shape {locked.shape}"
        )
    result, start = [], 0
    for i, module in enumerate(manipulator.modules):
        own = locked[start : start + len(module.actuators)]
        start += len(module.actuators)
        permitted = ((own < 0) | (module.bits == own)).all(axis=1)
        if not permitted.any():
            pairs = zip(module.actuators, own.tolist(), strict=True)
            named = " and ".join(f"{name} is {STATES[state]}" for name, state in pairs if state >= 0)
            raise ValueError(f"module {i + 1} has no state in which {named}")
        result.append(permitted)
    return result


def lock_actuators(manipulator: Manipulator, locked: LockedStates) -> Manipulator:
    """Returns the reduced arm, or the arm itself if no actuator is locked. Raises the errors of require_states."""
    permitted, modules = permitted_states(manipulator, locked), []
    if (locked < 0).all():
        return manipulator
    for module, kept in zip(manipulator.modules, permitted, strict=True):
        frames, bits, body = module.frames[kept], module.bits[kept], module.body[kept]
        modules.append(module if kept.all() else replace(module, frames=frames, bits=bits, body=body))
    return type(manipulator)(modules, manipulator.base)


def transferred(configuration: Configuration, source: Manipulator, target: Manipulator) -> Configuration:
    """Returns a configuration (B,) of one arm as one of another with other locks. Raises ValueError if none."""
    if source is target:
        return configuration
    return target.configuration(source.actuator_states(configuration))

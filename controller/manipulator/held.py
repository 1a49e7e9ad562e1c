"""Actuators that are held in one state, so that their modules have fewer: the arm that is left.

It has the same actuators, in the same order: actuator states (A,) are those of the whole arm, and carry configurations
from one to the other, whose numbers of states differ.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from controller.manipulator.manipulator import Configuration, Manipulator

Held = NDArray[np.int8]  # the state in which each actuator is held, -1 where it is free, shape (A,)

STATES = ("contracted", "extended")


def free(manipulator: Manipulator) -> Held:
    """Returns that no actuator is held."""
    return np.full(len(manipulator.actuators), -1, dtype=np.int8)


def hold(manipulator: Manipulator, held: Held) -> Manipulator:
    """Returns the arm without the states in which a held actuator is in another state; itself if none is held.

    Raises:
        ValueError: a module has no state left.
    """
    if held.shape != (len(manipulator.actuators),):
        raise ValueError(f"the arm has {len(manipulator.actuators)} actuators, got held states of shape {held.shape}")
    if (held < 0).all():
        return manipulator
    modules, start = [], 0
    for i, module in enumerate(manipulator.modules):
        own = held[start : start + len(module.actuators)]
        start += len(module.actuators)
        kept = ((own < 0) | (module.bits == own)).all(axis=1)
        if not kept.any():
            pairs = zip(module.actuators, own.tolist(), strict=True)
            named = " and ".join(f"{name} is {STATES[state]}" for name, state in pairs if state >= 0)
            raise ValueError(f"module {i + 1} has no state in which {named}")
        left = replace(module, frames=module.frames[kept], bits=module.bits[kept], body=module.body[kept])
        modules.append(module if kept.all() else left)
    return Manipulator(modules, manipulator.base)


def carried(configuration: Configuration, source: Manipulator, target: Manipulator) -> Configuration:
    """Returns a configuration (B,) of one arm as that of another, which differs in what is held only.

    Raises:
        ValueError: the other has none with these actuator states.
    """
    if source is target:
        return configuration
    return target.configuration(source.actuator_states(configuration))

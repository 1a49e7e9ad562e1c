"""Restaging: stages from the present actuator states to a planned configuration, within the inrush bound."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # its kernel takes a second to import
    from hyperbit.controller.manipulator.manipulator import Manipulator

States = NDArray[np.uint8]


def restage(manipulator: Manipulator, states: States, stages: States, most: int) -> States:
    """Returns the stages of a transition that was planned from other actuator states.

    Actuators that are already in their last state do not switch. If the states are those of the plan, the planned
    stages are returned. Each stage ends in a configuration.

    Args:
        manipulator: the arm.
        states: present states, of a configuration, shape (A,).
        stages: planned stages, shape (k, A).
        most: actuators that may switch at once.
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
    """Returns whether actuator states (A,) spell a configuration."""
    try:
        manipulator.configuration(states)
    except ValueError:
        return False
    return True

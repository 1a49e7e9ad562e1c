"""Locks that leave each module a state."""

from __future__ import annotations

from hyperbit.controller.program import Snapshot, unpack
from tests.simulation.judge.interface.modules import JudgedModules


def leaves_states(modules: JudgedModules, snapshot: Snapshot, k: int, state: int) -> bool:
    """Returns whether each module has a state if actuator `k` is locked in a state, too.

    A configuration must have all locked actuators in their states. If all actuators are known, the arm must be in a
    configuration; an actuator without an end-stop counts as in its locked state.
    """
    known, measured, sensed = unpack(snapshot.known), unpack(snapshot.measured), unpack(snapshot.sensed)
    bit = 1 << k
    mask = unpack(snapshot.locked) & known | bit
    states = measured & ~bit | state << k
    if not any(not (code ^ states) & mask for code in modules.tips):
        return False
    held = measured if sensed & bit else states
    return known != (1 << len(modules.labels)) - 1 or held in modules.tips

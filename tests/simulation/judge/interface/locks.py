"""Locks that leave each module a state."""

from __future__ import annotations

from hyperbit.controller.program import Snapshot, unpack
from tests.simulation.judge.interface.modules import JudgedModules


def leaves_states(modules: JudgedModules, snapshot: Snapshot, k: int, state: int) -> bool:
    """Returns whether each module has a state if actuator `k` is locked in a state, too.

    A configuration must have all locked actuators in their states. If all actuators are known, the arm must be in a
    configuration; an actuator without an end-stop counts as in its locked state.
    """
    return _leaves(modules, snapshot, k, state, unpack(snapshot.known), unpack(snapshot.measured))


def may_leave_none(modules: JudgedModules, snapshot: Snapshot, k: int, state: int) -> bool:
    """Returns whether the lock may be refused: locked actuators that are not known count as the executor tells them."""
    if not leaves_states(modules, snapshot, k, state):
        return True
    known, measured = unpack(snapshot.known), unpack(snapshot.measured)
    for fault in snapshot.faults:
        if fault.code == "degraded" and not known >> (j := modules.labels.index(fault.source)) & 1:
            known |= 1 << j
            measured = measured & ~(1 << j) | ("extended" in fault.message) << j
    return not _leaves(modules, snapshot, k, state, known, measured)


def _leaves(modules: JudgedModules, snapshot: Snapshot, k: int, state: int, known: int, measured: int) -> bool:
    sensed, bit = unpack(snapshot.sensed), 1 << k
    mask = unpack(snapshot.locked) & known | bit
    states = measured & ~bit | state << k
    if not any(not (code ^ states) & mask for code in modules.tips):
        return False
    held = measured if sensed & bit else states
    return known != (1 << len(modules.labels)) - 1 or held in modules.tips

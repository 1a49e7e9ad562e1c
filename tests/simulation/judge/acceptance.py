"""Whether the contract accepts a program: by mode, epoch, number, stages, locks, inrush and outputs."""

from __future__ import annotations

from hyperbit.controller.program import Program, Stage, unpack
from tests.simulation.judge.account import Account

MODE_REASONS = {"starting": "arm-starting", "fault": "arm-in-fault", "stopped": "arm-stopped"}


def must_decline(a: Account, message: Program) -> set[str]:
    """Returns the reasons for which the contract declines a program now; empty if it is accepted."""
    reasons, shown = set[str](), a.shown
    if a.quitting:
        reasons.add("executor-shutting-down")
    if a.mode in MODE_REASONS:
        reasons.add(MODE_REASONS[a.mode])
    if shown is None or message.epoch != shown.epoch:
        reasons.add("overtaken")
    if a.now > message.until:
        reasons.add("too-late-to-begin")
    if message.program <= a.program_number:
        reasons.add("program-malformed")
    reasons |= misfits(a, message.stages, message.start, -1e12)
    if message.homed and not fits(a, message.homed):
        reasons.add("program-malformed")
    if a.switching:
        reasons.add("switch-not-confirmed")
    if shown is not None and fits(a, message.start) and unpack(message.start) != a.believed:
        reasons.add("moved-since-planned")
    return reasons


def misfits(a: Account, stages: tuple[Stage, ...], start: bytes, earliest: float) -> set[str]:
    """Returns the reasons for which stages do not fit the arm."""
    if not all(fits(a, states) for states in (start, *(stage.states for stage in stages))):
        return {"program-malformed"}
    before, found = unpack(start), set[str]()
    for stage in stages:
        differ = unpack(stage.states) ^ before
        if differ & a.locked:
            found.add("program-locked")
        if differ.bit_count() > a.arm.most or stage.at < earliest:
            found.add("program-malformed")
        before, earliest = unpack(stage.states), stage.at
    return found


def fits(a: Account, states: bytes) -> bool:
    return len(states) == a.arm.size and not unpack(states) >> a.arm.count

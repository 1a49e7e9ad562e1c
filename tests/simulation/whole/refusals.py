"""The causes of refusals: which reason may be given when."""

from __future__ import annotations

from typing import TYPE_CHECKING

from controller.motion.decoding.goal import BEGIN_WITHIN
from controller.refusals.reasons import Reason

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon
    from tests.simulation.whole.history import Asked
    from tests.simulation.world import World

SOON = 0.25  # [s] between a cause and the refusal
PATIENCE = 2.0  # [s] of the core for an answer of the executor


def unfounded(asked: Asked, world: World, daemon: Daemon) -> str | None:
    """Returns the sentence of a refusal for which there is no cause; None if there is one."""
    assert asked.payload is not None
    reason, words, now = Reason(asked.payload["reason"]), str(asked.payload["message"]), world.agenda.now
    waited = now - asked.at
    if (holds := CAUSES.get(reason)) is None:
        return f"{words} (no cause of {reason.value} is known, {daemon.history.counts['asked goal']} goals)"
    return None if holds(asked, world, daemon, now, waited) else words


def _barred(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    """A request that bars others, a new epoch, a lost connection or a cancel of the goal came since its arrival."""
    history = daemon.history
    return max(history.barred_at, history.epoch_at, history.link_down_at) >= asked.at - SOON


def _no_motion(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    """The arm is not ready, or was not a moment ago; or its tables are being rebuilt."""
    history = daemon.history
    snapshot = history.snapshot
    if snapshot is None or snapshot.mode not in ("ready", "executing"):
        return True
    state = history.state
    unready = state is None or state["mode"] not in ("ready", "executing")
    return unready or max(history.mode_at, history.locks_at, history.link_down_at) >= now - SOON


def _unknown(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    """The measured states are no configuration."""
    snapshot = daemon.history.snapshot
    if snapshot is None:
        return False
    measured = int.from_bytes(snapshot.measured, "little")
    outputs = int.from_bytes(snapshot.outputs, "little")
    changed = max(daemon.history.moved_at, daemon.history.mode_at) >= now - SOON
    return changed or measured not in daemon.space.index or outputs not in daemon.space.index


def _silent(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    """The executor was stalled, ended or slow, or the planner was halted, while the request waited."""
    history = daemon.history
    return waited >= PATIENCE and max(world.executor.awake_since, history.link_down_at, daemon.awake_since) > asked.at


def _lost(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    return daemon.history.link_down_at >= now - 1e-9


def _late(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    stamp = getattr(asked.message, "stamp", 0.0)
    return bool(stamp)


def _busy(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    """16 motions wait, or waited until the same round of the loop answered them: it handles several events."""
    others = (*daemon.history.open.values(), *daemon.history.answered)
    return len([other for other in others if other.key in ("goal", "jog") and other is not asked]) >= 16


def _twice(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    return len(daemon.history.by_id.get(asked.message.id or "", [])) > 1


def _moved(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    return daemon.history.moved_at >= asked.at


def _unconfirmed(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    return world.record.declined_in_switch


def _failed(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    return daemon.history.failed_at >= asked.at


def _hung(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    return waited >= BEGIN_WITHIN - SOON


def _closing(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    return daemon.history.quits_at >= asked.at - 2.0 * PATIENCE


def _executor_closing(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    core = world.executor.core
    return core is None or core.ending.begun or core._requests.quitting


def _collides(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    """There are obstacles, or were when the request came."""
    history = daemon.history
    return bool(history.cubes or history.pending_cubes) or history.cubes_at >= asked.at


def _locked(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    return daemon.history.snapshot is not None and any(daemon.history.snapshot.locked)


def _answered(asked: Asked, world: World, daemon: Daemon, now: float, waited: float) -> bool:
    """The search itself has refused the goal; the exact search says why."""
    return True


CAUSES = {
    Reason.OVERTAKEN: _barred,
    Reason.EXECUTOR_SHUTTING_DOWN: _executor_closing,
    Reason.SHUTTING_DOWN: _closing,
    Reason.ARM_STARTING: _no_motion,
    Reason.ARM_IN_FAULT: _no_motion,
    Reason.ARM_STOPPED: _no_motion,
    Reason.ARM_NOT_KNOWN: _no_motion,
    Reason.LOCKS_CHANGING: _no_motion,
    Reason.UNKNOWN_STATE: _unknown,
    Reason.STATE_IN_BETWEEN: _unknown,
    Reason.EXECUTOR_SILENT: _silent,
    Reason.EXECUTOR_BEHIND: _silent,
    Reason.EXECUTOR_LOST: _lost,
    Reason.TOO_LATE_TO_BEGIN: _hung,
    Reason.ARM_MOVED: _hung,
    Reason.OBSTACLES_CHANGING: _hung,
    Reason.MOVED_SINCE_PLANNED: _moved,
    Reason.SWITCH_NOT_CONFIRMED: _unconfirmed,
    Reason.PLANNING_FAILED: _failed,
    Reason.START_COLLIDES: _collides,
    Reason.ARM_IN_OBSTACLE: _collides,
    Reason.ARRIVED_TOO_LATE: _late,
    Reason.PLANNED_TOO_LATE: _late,
    Reason.TOO_FAR_AHEAD: _late,
    Reason.BUSY: _busy,
    Reason.ALREADY_RUNNING: _twice,
    Reason.ACTUATOR_LOCKED: _locked,
    Reason.OUT_OF_REACH: _answered,
    Reason.NO_CONFIGURATION: _answered,
    Reason.BEYOND_LENGTH: _answered,
    Reason.LOCKED_CONFIGURATION: _answered,
    Reason.TIMES_TOO_CLOSE: _answered,
    Reason.TIMES_NOT_INCREASING: _answered,
    Reason.TIME_TOO_SHORT: _answered,
    Reason.WRONG_DIMENSION: _answered,
    Reason.NO_WAYPOINTS: _answered,
}

"""What must hold in the world for each reason of a refusal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise

from hyperbit.controller.program import Snapshot, unpack
from tests.simulation.judge.interface.account import DELAY, InterfaceAccount
from tests.simulation.judge.interface.asked import barring, ends_at, lined, patience, posed, wanted
from tests.simulation.judge.interface.facts import Heard, Request
from tests.simulation.judge.interface.locks import may_leave_none
from tests.simulation.judge.interface.messages import well_formed

EPOCH_IN_FLIGHT = 0.1  # [s] from a new epoch of the executor to the planner, which may still be reading
EXACT = 0.001  # [s]
SILENT = 2.0  # [s] after which an executor without an answer counts as silent
MOST_WAITING, MOST_PLANS, MOST_UNANSWERED = 16, 4, 100  # goals and jogs; plan queries; requests on one key
LONGEST_PLANNING = 60.0  # [s]
COLLISIONS = ("no-clear-path", "no-way", "goal-in-obstacle", "plan-collides")


def _any(a: InterfaceAccount, request: Request, holds: Callable[[Snapshot], bool]) -> bool:
    return any(heard.snapshot is not None and holds(heard.snapshot) for heard in _decided_by(a, request))


def _decided_by(a: InterfaceAccount, request: Request) -> Iterator[Heard]:
    """Returns the snapshots by which a request was decided: the last ones, unless its answer waits for slow peers."""
    held_up = a.congested or a.lately("congested", 0.5) or a.reconnecting
    return a.truths(a.awake - request.awake + DELAY if held_up else DELAY)


def _mode(*modes: str) -> Callable[[InterfaceAccount, Request], bool]:
    def holds(a: InterfaceAccount, request: Request) -> bool:
        return _any(a, request, lambda snapshot: snapshot.mode in modes)

    return holds


def _disconnected(a: InterfaceAccount, request: Request) -> bool:
    return any(heard.snapshot is None for heard in _decided_by(a, request))


def _starting(a: InterfaceAccount, request: Request) -> bool:
    return _disconnected(a, request) or _mode("starting")(a, request) or a.building


def _in_fault(a: InterfaceAccount, request: Request) -> bool:
    return _disconnected(a, request) or _mode("fault")(a, request) or a.build_failed


def known(snapshot: Snapshot) -> int:
    return unpack(snapshot.known)


def _not_known(a: InterfaceAccount, request: Request) -> bool:
    everything = (1 << len(a.modules.labels)) - 1
    return _any(a, request, lambda snapshot: known(snapshot) | unpack(snapshot.homing) != everything)


def _unknown_state(a: InterfaceAccount, request: Request) -> bool:
    """What is measured, or where the outputs are not measured commanded, is no configuration."""
    return _any(a, request, lambda snapshot: planned_from(snapshot) not in a.modules.tips)


def planned_from(snapshot: Snapshot) -> int:
    """Returns the states from which the next goal is planned: unknown ones, and those in motion, as commanded."""
    sure = 0 if snapshot.moving else known(snapshot)
    return unpack(snapshot.measured) & sure | _commanded(snapshot) & ~sure


def _commanded(snapshot: Snapshot) -> int:
    held = unpack(snapshot.locked) & known(snapshot)
    return unpack(snapshot.measured) & held | unpack(snapshot.outputs) & ~held


def _overtaken(a: InterfaceAccount, request: Request) -> bool:
    """A request that bars this one came after it; or a fault, a lost connection or other locks began an epoch."""
    for other in a.requests:
        later = other.number > request.number
        if later and (barring(other) or other.key == "degrade" or (other.key == "cancel" and _names(other, request))):
            return True
    if a.clear():
        return a.had("halted", request.at - EPOCH_IN_FLIGHT) or _locks_pending(a, request)
    return a.had("epoch", request.at - EPOCH_IN_FLIGHT) or a.had("link", request.at - EPOCH_IN_FLIGHT)


def _locks_pending(a: InterfaceAccount, request: Request) -> bool:
    """Locks, which begin an epoch, were asked for before and had no answer yet when the request came."""
    return any(other.key == "degrade" and other.answered_at >= request.at - EPOCH_IN_FLIGHT for other in a.requests)


def _names(cancel: Request, request: Request) -> bool:
    return cancel.goal == request.goal or (request.answer or {}).get("id") == cancel.goal or request.goal is None


def _silent(a: InterfaceAccount, request: Request) -> bool:
    waited = a.now - request.at >= SILENT - 0.1
    since = max(request.at, a.now - 2.0 * SILENT)
    return waited and any(a.had(kind, since) for kind in ("executor still", "executor ended", "still", "link"))


def _behind(a: InterfaceAccount, request: Request) -> bool:
    return a.now - request.at >= SILENT - 0.1


def _lost(a: InterfaceAccount, request: Request) -> bool:
    if a.full_lately and request.key in ("stop", "cancel"):  # sent at once, or not at all
        return True
    return a.had("link", request.at) or _disconnected(a, request)


def _too_long(a: InterfaceAccount, request: Request) -> bool:
    return a.now - request.at >= LONGEST_PLANNING


def _too_late_to_begin(a: InterfaceAccount, request: Request) -> bool:
    waited = a.now - request.at
    planned = request.body.get("deadline")
    over = waited >= patience(request) - EXACT or (planned is not None and waited >= float(planned) - EXACT)
    sent = a.sent_since(request)
    over = over or (sent < request.at - 0.1 and a.now - sent >= patience(request) - 0.5)
    return over and _mode("ready", "executing")(a, request)


def _moved(a: InterfaceAccount, request: Request) -> bool:
    return a.had("moved", request.at - EPOCH_IN_FLIGHT)


def _unconfirmed(a: InterfaceAccount, request: Request) -> bool:
    return a.had("declined switch-not-confirmed", request.at)


def _failed(a: InterfaceAccount, request: Request) -> bool:
    return a.had("task failed", request.at)


def _quits(a: InterfaceAccount, request: Request) -> bool:
    return a.quits


def _executor_quits(a: InterfaceAccount, request: Request) -> bool:
    return a.had("executor quits", request.at - SILENT)


def _busy(a: InterfaceAccount, request: Request) -> bool:
    since = a.now - 0.05 if request.answer is None else request.answered_at  # answers wait in the outbox
    most = {"goal": MOST_WAITING, "jog": MOST_WAITING, "plan": MOST_PLANS}.get(request.key, MOST_UNANSWERED)
    keys = ("goal", "jog") if most == MOST_WAITING else (request.key,)
    waiting = [r for r in a.requests if r.key in keys and r is not request and r.answered_at >= since]
    return len(waiting) >= most


def _running(a: InterfaceAccount, request: Request) -> bool:
    return any(ran.ended is None or ran.heard_at >= a.now - 5.0 for ran in a.ran(request.goal or ""))


def _too_fast(a: InterfaceAccount, request: Request) -> bool:
    """A line is divided into parts of half a tolerance at most, each of which takes a transition."""
    waypoints, tolerance = request.body["waypoints"], float(request.body.get("path_tolerance") or math.inf)
    pairs = pairwise(waypoints)
    return any(
        second["t"] - first["t"]
        < a.longest_transition * (2 * math.dist(first["position"], second["position"]) / tolerance + 1)
        for first, second in pairs
    )


def _line_with_pose(a: InterfaceAccount, request: Request) -> bool:
    return lined(request) and posed(request)


def _malformed(a: InterfaceAccount, request: Request) -> bool:
    return not well_formed(request, a.modules)


def _too_late(a: InterfaceAccount, request: Request) -> bool:
    return bool(request.body.get("stamp")) and (ends_at(request) <= a.wall() or a.had("clock", request.at - 1.0))


def _far_ahead(a: InterfaceAccount, request: Request) -> bool:
    return ends_at(request) - a.wall() > 86_000.0 or a.had("clock", request.at - 1.0)


def _times(a: InterfaceAccount, request: Request) -> bool:
    """Two waypoints, or the begin and the first one, are closer than all stages between them may need."""
    times = [float(w.get("t", 0.0)) for w in request.body["waypoints"]]
    begin = [a.wall() - float(request.body["stamp"])] if request.body.get("stamp") else []
    apart = [after - before for before, after in zip([*begin, *times], times if begin else times[1:], strict=False)]
    return bool(apart) and min(apart) < a.longest_transition


def _out_of_reach(a: InterfaceAccount, request: Request) -> bool:
    """No configuration with the present locks is within the tolerance of a waypoint."""
    sets = wanted(a, request)
    if lined(request):
        return True  # the points between the waypoints are not known

    def none(snapshot: Snapshot) -> bool:
        return a.modules.unreachable(sets, unpack(snapshot.measured), unpack(snapshot.locked))

    return any(heard.snapshot is not None and none(heard.snapshot) for heard in a.truths(a.now - request.at + 0.2))


def _collides(a: InterfaceAccount, request: Request) -> bool:
    """There are obstacles, or a request for some came."""
    return bool(a.known_cubes(request))


def _beyond(a: InterfaceAccount, request: Request) -> bool:
    return any(math.hypot(*w["position"]) > a.length for w in request.body["waypoints"] if "position" in w)


def _start_collides(a: InterfaceAccount, request: Request) -> bool:
    cubes = a.known_cubes(request)
    if request.key != "jog":
        return bool(cubes)
    labels = a.modules.labels
    mask = sum(1 << labels.index(label) for label in request.body["actuators"])
    value = sum(1 << labels.index(k) for k, state in request.body["actuators"].items() if state == "extended")

    def touches(snapshot: Snapshot) -> bool:
        before = _commanded(snapshot)
        return any(cube.touched(before, before & ~mask | value) for cube in cubes)

    return a.had("task failed", request.at) or any(
        h.snapshot is not None and touches(h.snapshot) for h in a.truths(a.now - request.at + 0.2)
    )


def _locked(a: InterfaceAccount, request: Request) -> bool:
    named = {a.modules.labels.index(label) for label in request.body.get("actuators", {})}
    named = named or set(range(len(a.modules.labels)))
    return any(
        h.snapshot is not None and any(unpack(h.snapshot.locked) >> k & 1 for k in named)
        for h in a.truths(a.now - request.at + 0.2)
    )


def _no_configuration(a: InterfaceAccount, request: Request) -> bool:
    """The arm is in no configuration, or in none with the locks of the tables, which follow at rest."""
    return _unknown_state(a, request) or _locked(a, request) or any(state != 255 for state in a.tables)


def _lock_contradicts(a: InterfaceAccount, request: Request) -> bool:
    k, state = a.modules.labels.index(request.body["actuator"]), request.body["state"]
    return _any(a, request, lambda s: bool(unpack(s.sensed) >> k & 1) and unpack(s.measured) >> k & 1 != state)


def _lock_moving(a: InterfaceAccount, request: Request) -> bool:
    return _any(a, request, lambda s: s.moving or s.mode != "ready") or a.had("switched", a.now - 1.0)


def _interlock(a: InterfaceAccount, request: Request) -> bool:
    lately = [h.snapshot for h in a.truths(1.0) if h.snapshot is not None]
    return a.interlock_open() or any(fault.code == "interlock" for snapshot in lately for fault in snapshot.faults)


def _without_state(a: InterfaceAccount, request: Request) -> bool:
    """No configuration has the locked actuators in their states."""
    k, state = a.modules.labels.index(request.body["actuator"]), request.body["state"]
    return _any(a, request, lambda snapshot: may_leave_none(a.modules, snapshot, k, state))


def _unknown_goal(a: InterfaceAccount, request: Request) -> bool:
    return not any(ran.at < a.now - 1.0 and ran.request for ran in a.ran(request.goal or "")) or a.disk_failed


def _not_named(a: InterfaceAccount, request: Request) -> bool:
    """A wildcard may not reach this key, or this cancel of one goal; or does not end in the name of the key."""
    if request.key in ("plan", "arm", "result"):
        return False
    each_arm = request.key == "stop" or (request.key == "cancel" and request.goal is None)
    return "*" in request.name and not (each_arm and request.name.endswith(f"/{request.key}"))


def _plan_canceled(a: InterfaceAccount, request: Request) -> bool:
    return any(r.key == "cancel" and r.goal == request.goal for r in a.requests if r.number > request.number)


GROUNDS: dict[str, Callable[[InterfaceAccount, Request], bool]] = {
    **dict.fromkeys(("not-json", "not-utf8", "no-object", "invalid-fields", "no-waypoints"), _malformed),
    **dict.fromkeys(("not-explained", "unknown-actuator", "wrong-dimension"), _malformed),
    **dict.fromkeys(("no-destination", "two-destinations"), _malformed),
    **dict.fromkeys(("arrived-too-late", "planned-too-late"), _too_late),
    **dict.fromkeys(("times-too-close", "times-not-increasing", "time-too-short"), _times),
    **dict.fromkeys(COLLISIONS, _collides),
    **dict.fromkeys(("moved-since-planned", "arm-moved"), _moved),
    **dict.fromkeys(("planning-failed", "obstacles-not-checked"), _failed),
    **dict.fromkeys(("unknown-state", "state-in-between"), _unknown_state),
    **dict.fromkeys(("executor-lost", "no-executor"), _lost),
    **dict.fromkeys(("actuator-locked", "locked-configuration", "program-locked"), _locked),
    "too-far-ahead": _far_ahead,
    "no-configuration": _no_configuration,
    "overtaken": _overtaken,
    "arm-starting": _starting,
    "arm-in-fault": _in_fault,
    "arm-stopped": _mode("stopped"),
    "arm-not-known": _not_known,
    "locks-changing": lambda a, request: a.building or a.build_failed,
    "executor-silent": _silent,
    "executor-behind": _behind,
    "planning-too-long": _too_long,
    "too-late-to-begin": _too_late_to_begin,
    "switch-not-confirmed": _unconfirmed,
    "executor-shutting-down": _executor_quits,
    "shutting-down": _quits,
    "busy": _busy,
    "obstacles-changing": lambda a, request: a.had("cubes", request.at),
    "already-running": _running,
    "out-of-reach": _out_of_reach,
    "beyond-length": _beyond,
    "start-collides": _start_collides,
    "arm-in-obstacle": _collides,
    "end-stop-contradicts": _lock_contradicts,
    "lock-while-moving": _lock_moving,
    "module-without-state": _without_state,
    "unknown-goal": _unknown_goal,
    "not-named": _not_named,
    "unknown-pose": lambda a, request: request.expected == "unknown-pose",
    "poses-unwritten": lambda a, request: request.expected == "poses-unwritten",
    "line-with-pose": _line_with_pose,
    "line-too-fast": _too_fast,
    "plan-canceled": _plan_canceled,
    "not-simulated": lambda a, request: request.key == "fault" and not a.simulated,
    "no-such-fault": lambda a, request: request.key == "fault" and a.simulated,
    "interlock-open": _interlock,
}

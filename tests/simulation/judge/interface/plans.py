"""Answers to `plan`: the cheapest way from where the arm stood at a moment between query and answer."""

from __future__ import annotations

import math

from hyperbit.controller.program import unpack
from tests.simulation.judge.interface.account import DELAY, InterfaceAccount
from tests.simulation.judge.interface.asked import lined, wanted
from tests.simulation.judge.interface.facts import Payload, Request
from tests.simulation.judge.verdict import require

LEAVES_WITHIN = 0.05  # [s] from the decision to the answer


def judge_plan(a: InterfaceAccount, request: Request, answer: Payload, text: str) -> None:
    """Judges a plan of an arm that stood still, among obstacles that did not change."""
    require(isinstance(answer.get("switches"), int), f"{text} has no switches")
    later = [r for r in a.requests if r.key == "cancel" and r.goal == request.goal and r.number > request.number]
    barred = [r for r in later if request.goal and r.accepted and r.answered_at < a.now - LEAVES_WITHIN]
    require(not barred or a.slow or a.congested, f"{text} comes after the answer to {barred[:1]}")
    if any(a.had(kind, request.at - 0.2) for kind in ("moved", "locks", "cubes")):
        return
    moments = [heard.snapshot for heard in a.truths(a.awake - request.awake + DELAY)]
    snapshots = [snapshot for snapshot in moments if snapshot is not None]
    moves = any(snapshot.moving for snapshot in snapshots)
    if moves or len(snapshots) < len(moments) or not a.clear() or a.bias is not None:
        return
    everything = (1 << len(a.modules.labels)) - 1
    sure = [snapshot for snapshot in snapshots if unpack(snapshot.known) == everything]
    starts = {(unpack(snapshot.measured), unpack(snapshot.locked)) for snapshot in sure}
    whys = {_differs(a, request, answer, *start) for start in starts}
    require("" in whys, f"{text} starts from no state of the arm between query and answer: {whys}")


def _differs(a: InterfaceAccount, request: Request, answer: Payload, start: int, locked: int) -> str:
    """Returns how a plan differs from the cheapest one from a state; "" if it does not."""
    least = a.modules.least(start, locked, a.cubes, wanted(a, request))
    if lined(request):  # the points between the waypoints are not known: they may cost more
        fits = least - 1e-9 <= answer["lower_bound"] <= answer["cost"] + 1e-9
        return "" if fits else f"the least cost from {start:b} without straight lines is {least}"
    if not math.isclose(answer["lower_bound"], least):
        return f"the bound from {start:b} is {least}"
    if answer["cost"] < least - 1e-9:
        return f"the least cost from {start:b} is {least}"
    optimal = math.isclose(answer["cost"], least)
    return "" if (answer["certificate"] == "optimal") == optimal else f"it is optimal from {start:b}: {optimal}"

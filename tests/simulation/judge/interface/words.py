"""Sentences: the reason in `state`, and the message of a result, as the pages and the executor have them."""

from __future__ import annotations

import re

from hyperbit.controller.program import Ended, Snapshot
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Payload, Ran
from tests.simulation.judge.verdict import require

FRESH = 0.3  # [s], awake, from the end of a goal to a reason that tells it
WHY = {
    "more": "actuators that were not in their expected states were switched, too",
    "fewer": "stages that were late were joined",
    "improved": "the plan was improved while the arm moved",
}
AGAIN = "pulses that were not confirmed were given again, or actuators were not in their expected states"
MISSED = re.compile(
    r"the measured tip is (?P<away>unknown|[\d.]+ from the last waypoint)(?: and turned (?P<turned>[\d.]+) rad)?,"
    r" tolerances? (?P<tolerance>[\d.e+-]+)(?: and (?P<angle>[\d.e+-]+))?"
)
UNVERIFIED = "; commanded, not verified"
COLLIDES = re.compile(r"the planned motion would collide: (.*); the arm holds", re.DOTALL)


class Words:
    """Judges sentences."""

    def __init__(self, account: InterfaceAccount) -> None:
        self._a = account

    def differs(self, payload: Payload, snapshot: Snapshot) -> str:
        """Returns how the reason in a state differs from a snapshot's; "" if it does not."""
        mode, reason = payload["mode"], payload["reason"]
        if mode != snapshot.mode:
            begins = {"starting": "the planner's tables are being rebuilt; ", "fault": "the tables for the locked act"}
            return "" if reason.startswith(begins[mode]) else f"the reason begins with {begins[mode]}"
        if mode != "ready":
            return "" if reason == snapshot.reason else f"the reason is {snapshot.reason}"
        a = self._a
        ended = [r for r in a.programs.values() if r.process == a.process and r.heard_at <= a.now and r.seen]
        last = max(ended, key=lambda r: r.heard_at, default=None)
        of_last = last is not None and snapshot.reason.startswith(f"holding; {last.program.name} ")
        sentence = "" if last is None else ending_of(last)
        if last is None or not (of_last or a.awake - last.heard_awake < FRESH):
            return "" if reason == snapshot.reason else f"the reason is {snapshot.reason}"
        told = bool(last.results) and a.awake - last.told_awake > FRESH and not a.had("link", last.heard_at)
        if told and sentence and of_last:
            return "" if reason == sentence else f"the reason is {sentence}"
        if reason == snapshot.reason or (not last.results and reason.startswith("holding; ")):
            return ""
        return "" if sentence and reason == sentence else f"the reason is {snapshot.reason}, or {sentence}"

    def judge_message(self, ran: Ran, ended: Ended | None, payload: Payload, text: str) -> None:
        status, message = payload["status"], payload["message"]
        if status == "succeeded":
            unread = ended is not None and not ended.verified
            message = message.removesuffix(UNVERIFIED) if unread else message
            require((payload["message"] != message) == unread, f"{text}; the executor has verified it: {not unread}")
            self._judge_reached(ran, payload, message, text)
        elif payload["code"] == -5:
            self._judge_missed(ran, payload, text)
        elif ended is not None and ended.status == status and not self._of_planner(message):
            words = ended.message
            require(message == words or message[:1_000] == words, f"{text}; the executor tells {words}")
        require(message, f"{text} has no message")

    def _of_planner(self, message: str) -> bool:
        """Returns whether the planner has ended a goal, before or after the executor did."""
        return COLLIDES.fullmatch(message) is not None or message.startswith("after waypoints[") or self._a.quits

    def _judge_reached(self, ran: Ran, payload: Payload, message: str, text: str) -> None:
        if ran.jog:
            require(message == "switched", f"{text} has other words")
            return
        if ran.planned is None:
            require(message.startswith("reached"), f"{text} has other words")
            return
        told, planned = payload["switches"], ran.planned
        which = ["improved"] if ran.replaced else []
        homed = ran.homed
        which += [] if told == planned + homed else ["more" if told > planned + homed else "fewer"]
        of_homing = f", {homed} of them to home actuators" if homed else ""
        whys = WHY | {"more": AGAIN} if homed else WHY
        sentences = [f"reached; {told} switches instead of {planned + homed}{of_homing}: {whys[k]}" for k in which]
        if told == planned + homed:
            sentences = [f"reached; {told} switches{of_homing} of unknown position" if homed else "reached"]
        require(message in sentences, f"{text} says none of {sentences}")
        as_told = payload["planned_switches"] == planned
        joined = payload["planned_switches"] is None or ran.replaced
        require(as_told or joined, f"{text}; the answer told {planned} switches")

    def _judge_missed(self, ran: Ran, payload: Payload, text: str) -> None:
        """Compares numbers in the message with the fields."""
        message = payload["message"]
        if ran.jog:
            require(message.startswith("not measured in the requested state: "), f"{text} has other words")
            return
        match = MISSED.fullmatch(message)
        if match is None:
            measured = payload["configuration"] or "unknown"
            require(message.startswith(f"the measured configuration is {measured}, not "), f"{text} has other words")
            return
        error, angle = payload["error"], payload["orientation_error"]
        away = "unknown" if error is None else f"{error:.4f} from the last waypoint"
        require(match["away"] == away, f"{text}: {away}")
        require((match["turned"] is None) == (angle is None), f"{text}: turned by {angle}")
        require(angle is None or match["turned"] == f"{angle:.4f}", f"{text}: turned by {angle}")


def ending_of(ran: Ran) -> str:
    """Returns the sentence on the end of a goal or jog; "" if its result has none."""
    if not ran.results:
        return ""
    result = ran.results[0]
    status, code, message = result["status"], result["code"], result["message"]
    if status == "succeeded":
        return "holding; the actuators were switched" if ran.jog else f"holding; goal {ran.goal} was reached"
    if code == -5:
        return f"holding; {message}" if ran.jog else f"holding; goal {ran.goal} was missed: {message}"
    if (collision := COLLIDES.fullmatch(message)) is not None:
        return f"holding; goal {ran.goal} was aborted: the planned motion would collide: {collision[1]}"
    if message.startswith("after waypoints["):
        return f"holding; goal {ran.goal} left its path: {message}"
    return ""

"""What a scenario can compare where it is told: the state, the program, the stream, the log."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hyperbit.controller.planning.core.tasks import FollowSetpoint
from hyperbit.controller.program import unpack

if TYPE_CHECKING:
    from tests.planning.rig.play import Play


def codes(play: Play) -> str:
    return " ".join(fault["code"] for fault in play.desk.state()["faults"]) or "none"


FACTS: dict[str, Callable[[Play], Any]] = {
    "mode": lambda play: play.desk.state()["mode"],
    "reason": lambda play: play.desk.state()["reason"],
    "faults": codes,
    "degraded": lambda play: " ".join(f"{it['actuator']} {it['state']}" for it in play.desk.state()["degraded"]),
    "homing": lambda play: " ".join(play.desk.state()["homing"]),
    "scene": lambda play: play.desk.state()["obstacles"],
    "entries": lambda play: " ".join(kind for kind, _ in play.desk.entries),
    "epoch": lambda play: play.program.epoch,
    "name": lambda play: play.program.name,
    "start": lambda play: f"{unpack(play.program.start):b}",
    "homed": lambda play: f"{unpack(play.program.homed):b}" if play.program.homed else "none",
    "until": lambda play: f"{play.program.until - play.began:g}",
    "last": lambda play: f"{unpack(play.program.stages[-1].states):b}",
    "first": lambda play: play.replaced.first,
    "failures": lambda play: len(play.desk.failures),
    "unread": lambda play: " ".join(play.desk.state()["unread"]),
    "ledger": lambda play: play.desk.diagnostics()["ledger"],
    "stream": lambda play: play.setpoint.stream,
    "commanded": lambda play: "yes" if play.commanded else "no",
    "searches": lambda play: play.desk.started[FollowSetpoint],
    "streams": lambda play: play.desk.diagnostics()["setpoint"]["streams"],
    "refused": lambda play: play.desk.diagnostics()["setpoint"]["refused"],
    "refusal": lambda play: play.desk.diagnostics()["setpoint"]["last_refusal"],
    "log": lambda play: "\n".join(play.desk.logs),
    "closed": lambda play: "yes" if play.desk.core.ended else "no",
    "hurried": lambda play: len(set(play.desk.hurried)),
    "payload": lambda play: json.dumps(play.payload),
}

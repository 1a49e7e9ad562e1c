"""The payloads of `state` and `diagnostics`, when they are published, and what systemd and the log are told."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import msgspec

from controller.journal import fields_of_fault, message_id
from controller.manipulator.notation import format_configuration, pose
from controller.motion.targets import measured_tip
from controller.planning.core.events import Log, Notify, Payload, Publish
from controller.planning.core.parts import Parts
from controller.planning.core.stream import Stream, TipBiasEstimator
from controller.program import Fault

IN_OBSTACLE, UNKNOWN_STATE, EXECUTOR_LOST = "in-obstacle", "unknown-state", "executor-lost"  # codes
UNWRITTEN = "ledger-unwritten"  # code of the ledger's warning

STATE_EVERY, DIAGNOSTICS_EVERY = 0.05, 1.0  # [s]
LEAST_GAP = 0.002  # [s] between two states, at least
SILENCE = 1.2 * STATE_EVERY  # [s] without a change until the next `state`; each snapshot is a change

Faults = dict[tuple[str, str], Fault]  # by code and source


class Measurement(NamedTuple):
    """The fields of `state` that depend on the measured actuator states only.

    Attributes:
        states: measured states, packed, and which are known; None without a snapshot.
        fields: of `state`.
    """

    states: tuple[bytes, bytes] | None
    fields: dict[str, Any]


class Status:
    """Makes and publishes `state` and `diagnostics`.

    Args:
        stream: of set-points.
        bias: tip bias; None: the arm has no tracker.
        planning: returns the number of requests that wait to be planned.
    """

    def __init__(
        self, parts: Parts, stream: Stream, bias: TipBiasEstimator | None, planning: Callable[[], int]
    ) -> None:
        self._parts, self._stream, self._bias, self._planning = parts, stream, bias, planning
        self._warnings: tuple[Fault, ...] = ()
        self._measurement: Measurement | None = None  # the last one
        self._changed, self._published, self._diagnosed = True, -math.inf, -math.inf
        self._status, self._logged = "", Faults()

    def warned(self, warnings: tuple[Fault, ...]) -> None:
        """Sets the active warnings of the shell, which logs them itself; `state` shows them after its own faults."""
        self._warnings, self._changed = warnings, True

    # --- publication

    def report(self, now: float, wall: float, changed: bool) -> None:
        """Publishes what is due, and tells systemd and the log.

        Args:
            now: monotonic time [s].
            wall: the same time [UNIX s].
            changed: whether `state` may have changed since the last call.
        """
        act, self._changed = self._parts.act, self._changed or changed
        if now >= self._state_due():
            self._changed, self._published = False, now
            payload = self.state(now, wall)
            act(Publish("state", payload))
            self._log_faults()
            if (status := f"STATUS={payload['mode']}: {payload['reason']}") != self._status:
                self._status = status
                act(Notify(status))
        if now >= self._diagnosed + DIAGNOSTICS_EVERY:
            self._diagnosed = now
            act(Publish("diagnostics", self.diagnostics(now, wall)))
            act(Notify("WATCHDOG=1"))

    def due(self, now: float) -> float:
        """Returns the time of the next publication [s]."""
        return max(now, min(self._state_due(), self._diagnosed + DIAGNOSTICS_EVERY))

    def _state_due(self) -> float:
        return self._published + (LEAST_GAP if self._changed else SILENCE)

    def _log_faults(self) -> None:
        """Logs faults when they begin and end."""
        active, act = self._faults(), self._parts.act
        for (code, source), fault in active.items():
            if (code, source) not in self._logged:
                act(Log(logging.ERROR, f"{code}: {fault.message}", fields_of_fault(code, source)))
        for code, source in self._logged.keys() - active.keys():
            fields = {**fields_of_fault(code, source), "MESSAGE_ID": message_id("fault-over")}
            act(Log(logging.INFO, f"{code} at {source} is over", fields))
        self._logged = active

    # --- payloads

    def state(self, now: float, wall: float) -> Payload:
        """Returns the payload of `state`; its tip is computed from the measured actuator states."""
        parts, state = self._parts, self._parts.view.state
        (mode, reason), goal, measurement = parts.locks.mode(), parts.programs.current, self._measured()
        report = None if goal is None else goal.report
        age = 0.0 if state is None else max(now - state.snapshot.at, 0.0)
        labels, faults = parts.view.manipulator.actuators, self._faults()
        for warning in self._warnings:
            faults.setdefault((warning.code, warning.source), warning)
        return {
            "stamp": wall - age,
            "mode": mode,
            "reason": reason,
            "configuration": measurement["configuration"],
            "commanded": None if state is None or not state.known else state.states.tolist(),
            "measured": measurement["measured"],
            "tip": measurement["tip"],
            "goal": None if report is None else report.id,
            "waypoint": None if report is None else report.waypoint,
            "target": None if report is None else report.target,
            "obstacles": parts.obstacles.generation,
            "faults": [msgspec.structs.asdict(fault) for fault in faults.values()],
            "degraded": [
                {"actuator": label, "state": locked}
                for label, locked in zip(labels, parts.locks.states.tolist(), strict=True)
                if locked >= 0
            ],
            **({} if self._bias is None else {"bias": self._bias.bias(now).tolist()}),
        }

    def diagnostics(self, now: float, wall: float) -> Payload:
        """Returns the payload of `diagnostics`; fields that need the executor are empty without it."""
        view, latest = self._parts.view, self._parts.view.diagnostics
        age = 0.0 if latest is None else max(now - latest.at, 0.0)
        switches = 0 if latest is None or view.counted is None else max(sum(latest.counts) - view.counted, 0)
        unwritten = next((warning.message for warning in self._warnings if warning.code == UNWRITTEN), "ok")
        return {
            "stamp": wall - age,
            "loop": {} if latest is None else latest.loop,
            "buses": [] if latest is None else latest.buses,
            "boards": [] if latest is None else latest.boards,
            "queues": {"inbox": self._parts.jobs.waiting, "planning": self._planning()},
            "setpoint": self._stream.status(now),
            "switches": switches,
            "counts": [] if latest is None else latest.counts,
            "waits": 0 if latest is None else latest.waits,
            "dropped": 0 if latest is None else latest.dropped,
            "ledger": unwritten,
            "real_time": "off" if latest is None else latest.real_time,
            "executor": "connected" if latest is not None else view.problem,
            **({} if self._bias is None else {"tracker": self._bias.status(now)}),
        }

    def _measured(self) -> dict[str, Any]:
        """Returns `configuration`, `measured` and `tip`; computed again only if the measured states have changed."""
        view = self._parts.view
        states = None if view.state is None else (view.state.snapshot.measured, view.state.snapshot.known)
        if self._measurement is None or self._measurement.states != states:
            manipulator, measured = view.manipulator, view.measured
            tip = measured_tip(manipulator, measured)
            fields = {
                "configuration": None
                if tip is None
                else format_configuration(manipulator, manipulator.configuration(measured)),
                "measured": [None if s < 0 else s for s in measured.tolist()],
                "tip": None if tip is None else pose(manipulator, tip),
            }
            self._measurement = Measurement(states, fields)
        return self._measurement.fields

    def _faults(self) -> Faults:
        """Returns the executor's faults and the planner's own; the first one of each code and source."""
        faults = Faults()
        for fault in self._all_faults():
            faults.setdefault((fault.code, fault.source), fault)
        return faults

    def _all_faults(self) -> Iterator[Fault]:
        parts, state = self._parts, self._parts.view.state
        if state is None:
            mode, reason = parts.locks.mode()
            if mode == "fault":
                yield Fault(EXECUTOR_LOST, "daemon", f"{reason}: the arm holds or does what `on_loss` says")
            return
        yield from (fault for fault in state.snapshot.faults if fault.code != "degraded")
        yield from parts.locks.faults()
        if (unknown := state.unknown_state) is not None:
            words = "goals are refused; switch single actuators with `jog` until the arm is in a configuration"
            yield Fault(UNKNOWN_STATE, "arm", f"{unknown}: {words}")
        if (collision := parts.obstacles.standing) is not None:
            words = "the arm holds; goals are refused until the arm or the obstacle is moved"
            yield Fault(IN_OBSTACLE, "arm", f"{collision}: {words}")

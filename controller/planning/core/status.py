"""The payloads of `state` and `diagnostics`, when they are published, and what systemd and the log are told."""

import logging
import math
from collections.abc import Iterator

import msgspec

from hyperbit.controller.host.journal import fields_of_fault, message_id
from hyperbit.controller.host.process import Log, Notify
from hyperbit.controller.manipulator.notation import format_configuration, pose
from hyperbit.controller.motion.targets import measured_tip
from hyperbit.controller.planning.core.events import Payload, Publish
from hyperbit.controller.planning.core.goals import Goals
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.premises import Premises
from hyperbit.controller.planning.core.programs import Programs
from hyperbit.controller.planning.core.requests import Queries
from hyperbit.controller.planning.core.stream import Stream
from hyperbit.controller.program import Diagnostics, Fault

IN_OBSTACLE, UNKNOWN_STATE, EXECUTOR_LOST = "in-obstacle", "unknown-state", "executor-lost"  # codes
UNWRITTEN = "ledger-unwritten"  # code of the ledger's warning

STATE_EVERY, DIAGNOSTICS_EVERY = 0.05, 1.0  # [s]
LEAST_GAP = 0.002  # [s] between two states, at least
SILENCE = 1.2 * STATE_EVERY  # [s] without a change until the next `state`; each snapshot is a change

Faults = dict[tuple[str, str], Fault]  # by code and source


class Status:
    """Makes and publishes `state` and `diagnostics`."""

    def __init__(
        self, parts: Parts, premises: Premises, programs: Programs, goals: Goals, queries: Queries, stream: Stream
    ) -> None:
        self._parts, self._view, self._moment, self._act = parts, parts.view, parts.moment, parts.act
        self._premises, self._programs = premises, programs
        self._goals, self._queries, self._stream = goals, queries, stream
        self.warnings: tuple[Fault, ...] = ()  # of the shell, which logs them itself
        self._measured_from: tuple[bytes, bytes] | None = None  # packed states of `_measured`, and which are known
        self._measured = self._measure()
        self.changed = True  # whether `state` may have changed since it was published
        self._published = self._diagnosed = -math.inf
        self._status, self._logged = "", Faults()

    # --- publication

    def report(self) -> None:
        """Publishes what is due, and feeds systemd's watchdog."""
        now = self._moment.now
        if now >= self._state_due():
            self.publish_state()
        if now >= self._diagnosed + DIAGNOSTICS_EVERY:
            self._diagnosed = now
            self._act(Publish("diagnostics", self.diagnostics()))
            self._act(Notify("WATCHDOG=1"))

    def publish_state(self) -> None:
        """Publishes `state`, and tells systemd and the log what it shows."""
        self.changed, self._published = False, self._moment.now
        payload = self.state()
        self._act(Publish("state", payload))
        self._log_faults()
        simulated = " (simulated)" if payload["simulated"] else ""
        if (status := f"STATUS={payload['mode']}{simulated}: {payload['reason']}") != self._status:
            self._status = status
            self._act(Notify(status))

    @property
    def due(self) -> float:
        """Time of the next publication [s]."""
        return max(self._moment.now, min(self._state_due(), self._diagnosed + DIAGNOSTICS_EVERY))

    def _state_due(self) -> float:
        return self._published + (LEAST_GAP if self.changed else SILENCE)

    def _log_faults(self) -> None:
        active = self._faults()
        for (code, source), fault in active.items():
            if (code, source) not in self._logged:
                level = logging.WARNING if code == "degraded" else logging.ERROR  # an operator may have locked it
                self._act(Log(level, f"{code}: {fault.message}", fields_of_fault(code, source)))
        for code, source in self._logged.keys() - active.keys():
            fields = {**fields_of_fault(code, source), "MESSAGE_ID": message_id("fault-over")}
            self._act(Log(logging.INFO, f"{code} at {source} is over", fields))
        self._logged = active

    # --- payloads

    def state(self) -> Payload:
        """Returns the payload of `state`; its tip is computed from the measured actuator states."""
        premises, state = self._premises, self._view.state
        (mode, reason), goal = premises.locks.mode(), self._programs.current
        report = None if goal is None else goal.report
        measured_from = None if state is None else (state.snapshot.measured, state.snapshot.known)
        if measured_from != self._measured_from:
            self._measured_from, self._measured = measured_from, self._measure()
        age = 0.0 if state is None else max(self._moment.now - state.snapshot.at, 0.0)
        faults = self._faults(self.warnings)
        return {
            "stamp": self._moment.wall - age,
            "mode": mode,
            "reason": reason,
            "simulated": self._parts.simulated,
            "configuration": self._measured["configuration"],
            "commanded": None if state is None or not state.known else state.states.tolist(),
            "measured": self._measured["measured"],
            "unread": [] if state is None else state.unread,
            "tip": self._measured["tip"],
            "goal": None if report is None else report.id,
            "waypoint": None if report is None else report.waypoint,
            "target": None if report is None else report.target,
            "obstacles": premises.obstacles.generation,
            "faults": [msgspec.structs.asdict(fault) for fault in faults.values()],
            "degraded": [{"actuator": label, "state": locked} for label, locked in premises.locks.listed],
            **({} if premises.tip_bias is None else {"bias": premises.tip_bias.bias().tolist()}),
        }

    def diagnostics(self) -> Payload:
        """Returns the payload of `diagnostics`; fields that need the executor are empty without it."""
        view, tip_bias, now = self._view, self._premises.tip_bias, self._moment.now
        latest = view.diagnostics or Diagnostics(now, {}, [], [], "off", (), 0, 0)
        unwritten = next((warning.message for warning in self.warnings if warning.code == UNWRITTEN), "ok")
        return {
            "stamp": self._moment.wall - max(now - latest.at, 0.0),
            "loop": latest.loop,
            "buses": latest.buses,
            "boards": latest.boards,
            "queues": {"inbox": self._parts.jobs.waiting, "planning": self._goals.waiting + self._queries.waiting},
            "setpoint": self._stream.status(),
            "switches": max(sum(latest.counts) - (view.counted or 0), 0),
            "counts": latest.counts,
            "waits": latest.waits,
            "dropped": latest.dropped,
            "ledger": unwritten,
            "real_time": latest.real_time,
            "executor": view.problem if view.diagnostics is None else "connected",
            **({} if tip_bias is None else {"tracker": tip_bias.status()}),
        }

    def _measure(self) -> Payload:
        """Returns the fields of `state` that depend on the measured actuator states only."""
        manipulator, measured = self._view.manipulator, self._view.measured
        tip = measured_tip(manipulator, measured)
        spelled = None if tip is None else format_configuration(manipulator, manipulator.configuration(measured))
        return {
            "configuration": spelled,
            "measured": [None if s < 0 else s for s in measured.tolist()],
            "tip": None if tip is None else pose(manipulator, tip),
        }

    def _faults(self, warnings: tuple[Fault, ...] = ()) -> Faults:
        """Returns the executor's faults, the planner's own, and warnings; the first one of each code and source."""
        faults = Faults()
        for fault in (*self._all_faults(), *warnings):
            faults.setdefault((fault.code, fault.source), fault)
        return faults

    def _all_faults(self) -> Iterator[Fault]:
        premises, state = self._premises, self._view.state
        if state is None:
            mode, reason = premises.locks.mode()
            if mode == "fault":
                yield Fault(EXECUTOR_LOST, "daemon", f"{reason}: the arm holds or does what `on_loss` says")
            return
        yield from (fault for fault in state.snapshot.faults if fault.code != "degraded")
        yield from premises.locks.faults()
        if (unknown := state.unknown_state) is not None:
            words = "goals are refused; switch single actuators with `jog` until the arm is in a configuration"
            yield Fault(UNKNOWN_STATE, "arm", f"{unknown}: {words}")
        if (collision := premises.obstacles.standing) is not None:
            words = "the arm holds; goals are refused until the arm or the obstacle is moved"
            yield Fault(IN_OBSTACLE, "arm", f"{collision}: {words}")

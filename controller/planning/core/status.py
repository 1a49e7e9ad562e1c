"""The messages on `state` and `diagnostics`, their times of publication, and messages to systemd and the log."""

import logging
import math
from collections.abc import Iterable, Iterator
from typing import Any

from msgspec import UNSET, structs

from hyperbit.controller import program
from hyperbit.controller.host.journal import fields_of_fault, message_id
from hyperbit.controller.host.process import Log, Notify
from hyperbit.controller.manipulator.notation import format_configuration, pose
from hyperbit.controller.messages import state as messages
from hyperbit.controller.messages.parts import Pose
from hyperbit.controller.messages.state import Diagnostics, Lock, LoopTimes, State
from hyperbit.controller.motion.targets import measured_tip
from hyperbit.controller.planning.core.events import Publish
from hyperbit.controller.planning.core.goals import Goals
from hyperbit.controller.planning.core.parts import Parts
from hyperbit.controller.planning.core.premises import Premises
from hyperbit.controller.planning.core.programs import Programs
from hyperbit.controller.planning.core.requests import Queries
from hyperbit.controller.planning.core.stream import Stream
from hyperbit.controller.program import Fault

STATE_EVERY, DIAGNOSTICS_EVERY = 0.05, 1.0  # [s]
LEAST_GAP = 0.002  # [s] between two states, at least
SILENCE = 1.2 * STATE_EVERY  # [s] without a change until the next `state`; each snapshot is a change

WARNINGS = frozenset(  # codes of what stops no motion
    (
        *("bus-passive", "board-limits", "outputs-off", "ledger-damaged", "journal", "in-obstacle", "unknown-state"),
        *("unknown-position", "degraded", "not-commissioned"),
    )
)


class Status:
    def __init__(
        self, parts: Parts, premises: Premises, programs: Programs, goals: Goals, queries: Queries, stream: Stream
    ) -> None:
        self._parts, self._view, self._moment, self._act = parts, parts.view, parts.moment, parts.act
        self._premises, self._programs = premises, programs
        self._goals, self._queries, self._stream = goals, queries, stream
        self.warnings: tuple[Fault, ...] = ()  # of the shell, which logs them itself
        # The fields of `state` that depend only on measured states, and these states, packed.
        self._measured: tuple[tuple[bytes, bytes] | None, dict[str, Any]] | None = None
        self.changed = True  # whether `state` may have changed since it was published
        self._published = self._diagnosed = -math.inf
        self._status = ""
        self._logged: dict[tuple[str, str], Fault] = {}  # by code and source

    def report(self) -> None:
        now = self._moment.now
        if now >= self._state_due():
            self.publish_state()
        if now >= self._diagnosed + DIAGNOSTICS_EVERY:
            self._diagnosed = now
            self._act(Publish("diagnostics", self.diagnostics()))
            self._act(Notify("WATCHDOG=1"))

    def publish_state(self) -> None:
        self.changed, self._published = False, self._moment.now
        state, active = self.state(), by_code(self._faults())
        self._act(Publish("state", state))
        for (code, source), fault in active.items():
            if (code, source) not in self._logged:
                level = logging.WARNING if code in WARNINGS else logging.ERROR
                self._act(Log(level, f"{code}: {fault.message}", fields_of_fault(code, source)))
        for code, source in self._logged.keys() - active.keys():
            fields = {**fields_of_fault(code, source), "MESSAGE_ID": message_id("fault-over")}
            self._act(Log(logging.INFO, f"{code} at {source} is over", fields))
        self._logged = active
        simulated = " (simulated)" if state.simulated else ""
        if (status := f"STATUS={state.mode}{simulated}: {state.reason}") != self._status:
            self._status = status
            self._act(Notify(status))

    @property
    def due(self) -> float:
        return max(self._moment.now, min(self._state_due(), self._diagnosed + DIAGNOSTICS_EVERY))

    def _state_due(self) -> float:
        return self._published + (LEAST_GAP if self.changed else SILENCE)

    # --- messages

    def state(self) -> State:
        """Returns `state`; its tip is computed from the measured actuator states."""
        premises, state, manipulator = self._premises, self._view.state, self._view.manipulator
        (mode, reason), goal = premises.locks.mode(), self._programs.current
        made_from = None if state is None else (state.snapshot.measured, state.snapshot.known)
        if self._measured is None or made_from != self._measured[0]:
            measured = self._view.measured
            tip = measured_tip(manipulator, measured)
            spelled = None if tip is None else format_configuration(manipulator, manipulator.configuration(measured))
            known = [None if s < 0 else s for s in measured.tolist()]
            shown = None if tip is None else Pose(**pose(manipulator, tip))
            self._measured = made_from, {"configuration": spelled, "measured": known, "tip": shown}
        age = 0.0 if state is None else max(self._moment.now - state.snapshot.at, 0.0)
        waypoint, target = (None, None) if goal is None or goal.report is None else goal.report.present()
        return State(
            stamp=self._moment.wall - age,
            mode=mode,
            reason=reason,
            simulated=self._parts.simulated,
            **self._measured[1],
            commanded=None if state is None or not state.known else state.states.tolist(),
            unread=[] if state is None else state.unread,
            homing=[] if state is None else state.homed_first,
            goal=None if goal is None else goal.id,
            waypoint=waypoint,
            target=target,
            progress=None if goal is None else goal.progress(self._moment.wall - self._moment.now),
            obstacles=premises.obstacles.generation,
            faults=[messages.Fault(*structs.astuple(it)) for it in by_code((*self._faults(), *self.warnings)).values()],
            degraded=[Lock(label, locked) for label, locked in premises.locks.listed],
            bias=UNSET if premises.tip_bias is None else premises.tip_bias.bias().tolist(),
        )

    def diagnostics(self) -> Diagnostics:
        """Returns `diagnostics`; fields that need the executor are empty without it."""
        view, tip_bias, now = self._view, self._premises.tip_bias, self._moment.now
        latest = view.diagnostics or program.Diagnostics(now, LoopTimes(), [], [], "off", (), 0, 0)
        return Diagnostics(
            stamp=self._moment.wall - max(now - latest.at, 0.0),
            loop=latest.loop,
            buses=latest.buses,
            boards=latest.boards,
            queues={"inbox": self._parts.jobs.waiting, "planning": len(self._goals.all) + len(self._queries.all)},
            setpoint=self._stream.status(),
            switches=max(sum(latest.counts) - (view.counted or 0), 0),
            counts=list(latest.counts),
            waits=latest.waits,
            dropped=latest.dropped,
            ledger=next((fault.message for fault in self.warnings if fault.code == "ledger-unwritten"), "ok"),
            real_time=latest.real_time,
            executor=view.problem if view.diagnostics is None else "connected",
            tracker=UNSET if tip_bias is None else tip_bias.status(),
        )

    def _faults(self) -> Iterator[Fault]:
        premises, state = self._premises, self._view.state
        if state is None:
            mode, reason = premises.locks.mode()
            if mode == "fault":
                yield Fault("executor-lost", "daemon", f"{reason}: the arm holds or does what `on_loss` says")
            return
        yield from (fault for fault in state.snapshot.faults if fault.code != "degraded")
        yield from premises.locks.faults()
        if (unknown := state.unknown_state) is not None:
            words = "goals are refused; switch single actuators with `jog` until the arm is in a configuration"
            yield Fault("unknown-state", "arm", f"{unknown}: {words}")
        if (collision := premises.obstacles.standing) is not None:
            words = "the arm holds; goals are refused until the arm or the obstacle is moved"
            yield Fault("in-obstacle", "arm", f"{collision}: {words}")


def by_code(faults: Iterable[Fault]) -> dict[tuple[str, str], Fault]:
    first: dict[tuple[str, str], Fault] = {}
    for fault in faults:
        first.setdefault((fault.code, fault.source), fault)
    return first

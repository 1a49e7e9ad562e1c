"""The payloads of `state` and `diagnostics`."""

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from controller.manipulator.manipulator import Manipulator
from controller.manipulator.notation import format_configuration, pose
from controller.planning.arm_state import ArmState
from controller.planning.goal_check import measured_tip
from controller.planning.goals import RunningGoals
from controller.planning.keep_out import KeepOut
from controller.planning.link import ExecutorLink
from controller.planning.locked import LockedActuators
from controller.planning.messages import Payload
from controller.planning.monitor import ArmMonitor
from controller.program import Fault

IN_OBSTACLE, UNKNOWN_STATE, EXECUTOR_LOST = "in-obstacle", "unknown-state", "executor-lost"  # codes


class StatusReport:
    """Makes the payload of `state`. For any thread.

    Args:
        monitor: of the arm.
        link: to the executor.
        goals: the running goals.
        locked: locked actuators.
        keep_out: the obstacles.
        bias: returns the fields on the tip bias; empty without a tracker.
        wall: UNIX time [s].
    """

    def __init__(
        self,
        monitor: ArmMonitor,
        link: ExecutorLink,
        goals: RunningGoals,
        locked: LockedActuators,
        keep_out: KeepOut,
        bias: Callable[[], Payload],
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._monitor, self._link, self._goals, self._locked = monitor, link, goals, locked
        self._keep_out, self._bias, self._wall = keep_out, bias, wall
        # The last check: what it depends on, and its result.
        self._collision_seen: tuple[tuple[int, bytes, bytes], str | None] | None = None

    def state(self) -> Payload:
        """Returns the payload of `state`; its tip is computed from the measured actuator states."""
        manipulator, state = self._monitor.manipulator, self._monitor.state
        (mode, reason), measured, goal = self._monitor.mode(), self._monitor.measured, self._goals.current
        tip = measured_tip(manipulator, measured)
        age = 0.0 if state is None else max(self._monitor.clock() - state.snapshot.at, 0.0)
        locked = self._locked.states
        return {
            "stamp": self._wall() - age,
            "mode": mode,
            "reason": reason,
            "configuration": None if tip is None else configuration_text(manipulator, measured),
            "commanded": None if state is None or not state.known else state.states.tolist(),
            "measured": [None if s < 0 else s for s in measured.tolist()],
            "tip": None if tip is None else pose(manipulator, tip),
            "goal": None if goal is None else goal.report.id,
            "waypoint": None if goal is None else goal.report.waypoint,
            "target": None if goal is None else goal.report.target,
            "obstacles": self._keep_out.current.generation,
            "faults": [
                {"code": f.code, "source": f.source, "message": f.message} for f in distinct(self._faults(state))
            ],
            "degraded": [
                {"actuator": label, "state": at}
                for label, at in zip(manipulator.actuators, locked.tolist(), strict=True)
                if at >= 0
            ],
            **self._bias(),
        }

    def _faults(self, state: ArmState | None) -> Iterable[Fault]:
        """Yields the executor's faults and the planner's own."""
        if state is None:
            mode, reason = self._monitor.mode()
            if mode == "fault":
                yield Fault(EXECUTOR_LOST, "daemon", f"{reason}: the arm holds or does what `on_loss` says")
            return
        yield from (fault for fault in state.snapshot.faults if fault.code != "degraded")
        yield from self._locked.faults()
        if (unknown := state.unknown_state) is not None:
            words = (
                f"{unknown}: goals are refused; switch single actuators with `jog` until the arm is in a configuration"
            )
            yield Fault(UNKNOWN_STATE, "arm", words)
        if (collision := self._collision(state)) is not None:
            words = f"{collision}: the arm holds; goals are refused until the arm or the obstacle is moved"
            yield Fault(IN_OBSTACLE, "arm", words)

    def _collision(self, state: ArmState) -> str | None:
        """Returns the arm's present collision; computed again only if it may have changed."""
        current = self._keep_out.current
        question = current.generation, state.snapshot.measured, state.snapshot.known
        if self._collision_seen is None or self._collision_seen[0] != question:
            self._collision_seen = question, current.collision_at(state.measured)
        return self._collision_seen[1]


class DiagnosticsReport:
    """Makes the payload of `diagnostics`. For any thread.

    Args:
        link: to the executor.
        counted: returns the switches before this planner process; None before the first connection.
        queues: returns the number of waiting requests in each queue.
        setpoint: returns the state of the stream of set-points.
        ledger: returns why the ledger cannot be written; None if it can.
        tracker: returns the fields on the tip bias; empty without a tracker.
        clock: monotonic time [s].
        wall: UNIX time [s].
    """

    def __init__(
        self,
        link: ExecutorLink,
        counted: Callable[[], int | None],
        queues: Callable[[], Mapping[str, int]],
        setpoint: Callable[[], Payload],
        ledger: Callable[[], str | None],
        tracker: Callable[[], Payload],
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._link, self._counted, self._queues = link, counted, queues
        self._setpoint, self._ledger = setpoint, ledger
        self._tracker, self._clock, self._wall = tracker, clock, wall

    def diagnostics(self) -> Payload:
        """Returns the payload of `diagnostics`; fields that need the executor are empty without it."""
        latest, counted = self._link.diagnostics, self._counted()
        age = 0.0 if latest is None else max(self._clock() - latest.at, 0.0)
        switches = 0 if latest is None or counted is None else max(sum(latest.counts) - counted, 0)
        return {
            "stamp": self._wall() - age,
            "loop": {} if latest is None else latest.loop,
            "buses": [] if latest is None else latest.buses,
            "boards": [] if latest is None else latest.boards,
            "queues": dict(self._queues()),
            "setpoint": self._setpoint(),
            "switches": switches,
            "counts": [] if latest is None else latest.counts,
            "waits": 0 if latest is None else latest.waits,
            "dropped": 0 if latest is None else latest.dropped,
            "ledger": self._ledger() or "ok",
            "real_time": "off" if latest is None else latest.real_time,
            "executor": "connected" if latest is not None else self._link.problem,
            **self._tracker(),
        }


def configuration_text(manipulator: Manipulator, measured: np.ndarray[Any, np.dtype[np.int8]]) -> str:
    """Returns the configuration of actuator states (A,) as text."""
    return format_configuration(manipulator, manipulator.configuration(measured))


def distinct(faults: Iterable[Fault]) -> Iterable[Fault]:
    """Yields the first fault of each code and source."""
    seen = set[tuple[str, str]]()
    for fault in faults:
        if (key := (fault.code, fault.source)) not in seen:
            seen.add(key)
            yield fault

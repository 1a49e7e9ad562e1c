"""What the control loop shows of itself: immutable snapshots, and the payloads made of them."""

from dataclasses import asdict, dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from controller.daemon.events import Payload
from controller.manipulator.frames import Frame
from controller.manipulator.held import Held
from controller.manipulator.manipulator import Manipulator
from controller.manipulator.notation import format_configuration, pose
from drivers.faults import Fault
from drivers.status import Status

Mode = Literal["starting", "ready", "executing", "fault", "stopped"]


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The arm at one instant.

    Attributes:
        stamp: UNIX seconds.
        mode: of the daemon.
        reason: a sentence on the mode.
        commanded: actuator states, shape (A,); None before they are known.
        measured: actuator states, -1 unknown, shape (A,).
        goal: id of the running goal.
        waypoint: index of the waypoint last switched to.
        faults: all since the last reset.
        held: the state in which each actuator is held, -1 where it is free, shape (A,).
    """

    stamp: float
    mode: Mode
    reason: str
    commanded: NDArray[np.uint8] | None
    measured: NDArray[np.int8]
    goal: str | None
    waypoint: int | None
    faults: tuple[Fault, ...]
    held: Held


@dataclass(frozen=True)
class LoopStatus:
    """How the control loop keeps time, over the last second: periods and work in seconds."""

    ticks: int
    longest_period: float
    mean_work: float
    longest_work: float
    overruns: int


@dataclass(frozen=True)
class Diagnostics:
    """Health of loop, buses and queues."""

    stamp: float
    loop: LoopStatus
    hardware: Status
    inbox: int
    switches: int
    waits: int
    ledger: str | None


class Telemetry(Protocol):
    """Where snapshots go; must not wait."""

    def show(self, snapshot: Snapshot) -> None:
        """Takes the latest state."""

    def diagnose(self, diagnostics: Diagnostics) -> None:
        """Takes the latest diagnostics."""


def measured_tip(manipulator: Manipulator, measured: NDArray[np.int8]) -> Frame | None:
    """Returns the tip's frame (4, 4) from measured actuator states (A,), None where they tell no configuration."""
    try:
        return manipulator.tip(manipulator.configuration(measured))
    except ValueError:
        return None


def state_payload(manipulator: Manipulator, snapshot: Snapshot) -> Payload:
    """Returns the payload of `state`; the tip is that of the measured actuator states."""
    tip = measured_tip(manipulator, snapshot.measured)
    commanded = snapshot.commanded
    return {
        "stamp": snapshot.stamp,
        "mode": snapshot.mode,
        "reason": snapshot.reason,
        "configuration": None if tip is None else written(manipulator, snapshot.measured),
        "commanded": None if commanded is None else commanded.tolist(),
        "measured": [None if s < 0 else s for s in snapshot.measured.tolist()],
        "tip": None if tip is None else pose(manipulator, tip),
        "goal": snapshot.goal,
        "waypoint": snapshot.waypoint,
        "faults": [asdict(fault) for fault in snapshot.faults],
        "degraded": [
            {"actuator": label, "state": state}
            for label, state in zip(manipulator.actuators, snapshot.held.tolist(), strict=True)
            if state >= 0
        ],
    }


def written(manipulator: Manipulator, actuator_states: NDArray[np.int8]) -> str:
    """Returns the configuration of actuator states (A,) as text."""
    return format_configuration(manipulator, manipulator.configuration(actuator_states))


def diagnostics_payload(diagnostics: Diagnostics, outbox: int, planning: int, setpoint: Payload) -> Payload:
    """Returns the payload of `diagnostics`."""
    return {
        "stamp": diagnostics.stamp,
        "loop": asdict(diagnostics.loop),
        **asdict(diagnostics.hardware),
        "queues": {"inbox": diagnostics.inbox, "outbox": outbox, "planning": planning},
        "setpoint": setpoint,
        "switches": diagnostics.switches,
        "waits": diagnostics.waits,
        "ledger": diagnostics.ledger or "ok",
    }

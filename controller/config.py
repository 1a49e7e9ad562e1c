"""The arm that a YAML file describes, and every fault in it by the path of the field."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from controller.chain import build_frame, build_modules
from controller.manipulator.held import STATES, Held, free, hold
from controller.manipulator.manipulator import Manipulator
from controller.obstacles.clearance import Clearance
from controller.obstacles.notation import build_regions
from controller.obstacles.regions import NONE, Regions, together
from controller.settings import ActuatorSettings, ArmSettings
from controller.strict import InputFaults, check, read_yaml

MOST_PIXELS = 2**19


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm as its file describes it.

    Attributes:
        settings: the file's fields.
        manipulator: the chain.
        wiring: where each actuator is, in the order of `manipulator.actuators`; empty if the file maps none.
        regions: that no module may touch.
    """

    settings: ArmSettings
    manipulator: Manipulator
    wiring: tuple[ActuatorSettings, ...]
    regions: Regions = NONE

    @cached_property
    def held(self) -> Held:
        """The states of the actuators that are declared stuck, shape (A,)."""
        held = free(self.manipulator)
        for k, entry in enumerate(self.wiring):
            if entry.stuck is not None:
                held[k] = STATES.index(entry.stuck)
        return held

    @cached_property
    def left(self) -> Manipulator:
        """The chain without the states that the actuators declared stuck rule out."""
        return hold(self.manipulator, self.held)

    def clearance(self, manipulator: Manipulator | None = None, others: Regions = NONE) -> Clearance:
        """Returns what the chain, or what is left of it, must keep clear of: the file's regions and others."""
        return Clearance(
            manipulator or self.manipulator,
            together([self.regions, others]),
            self.settings.body_radius,
            self_collision=self.settings.self_collision,
        )

    @property
    def pixel(self) -> float:
        """Finest side of a pixel of the densities."""
        return self.settings.workspace.pixel or self.manipulator.length / 400

    @property
    def level_pixels(self) -> int:
        """Most pixels of one intermediate workspace, four bytes each: no level needs more than MOST_PIXELS."""
        share = self.settings.workspace.memory * 2**20 / 4 / (len(self.manipulator.modules) + 1)
        return max(1, min(MOST_PIXELS, int(share)))

    def weights(self, switches: Mapping[str, int] | None = None) -> NDArray[np.float64]:
        """Returns what a switch of each actuator costs, shape (A,).

        Args:
            switches: how often each has switched so far, by label; none if absent.
        """
        modules, settings = len(self.manipulator.modules), self.settings.weights
        place = np.array([int(label.split(".")[0]) - 1 for label in self.manipulator.actuators])
        own = np.linspace(settings.base, 1.0, modules)[place] * ([entry.weight for entry in self.wiring] or 1.0)
        worn = np.array([(switches or {}).get(label, 0) for label in self.manipulator.actuators], dtype=float)
        return np.asarray(own * (1.0 + settings.wear * worn / max(worn.max(), 1.0)))

    @property
    def tolerance(self) -> float:
        """Position tolerance of goals that bring none."""
        return self.settings.tolerance.position

    @property
    def turn(self) -> float:
        """Tolerance of the orientation of goals that bring none [rad]."""
        return self.settings.tolerance.orientation


def load(path: Path) -> Arm:
    """Returns the arm that a YAML file describes.

    Raises:
        InputFaults: the file is missing or wrong; one line per fault, each with the path of its field.
    """
    raw = read_yaml(path)
    faults: list[str] = []
    settings = check(raw, ArmSettings, faults)
    if settings is None:
        raise InputFaults(path, faults)
    if settings.boards.heartbeat_timeout <= 1.5 * settings.boards.heartbeat:
        faults.append(
            f"boards.heartbeat_timeout: {settings.boards.heartbeat_timeout:g} s is too short for heartbeats every"
            f" {settings.boards.heartbeat:g} s; more than 1.5 times that is needed"
        )
    modules = build_modules(settings.modules, path.parent, faults)
    base = build_frame(settings.base, "base", faults)
    if faults or not modules or base is None:
        raise InputFaults(path, faults)
    manipulator = Manipulator(modules, base)
    wiring = map_actuators(settings, manipulator, faults)
    if faults:
        raise InputFaults(path, faults)
    regions = build_regions(settings.obstacles, manipulator.dimension, "obstacles", faults)
    arm = Arm(settings, manipulator, wiring, regions)
    if not faults and (walled := walled_in(arm)) is not None:
        faults.append(f"obstacles: {walled}, whatever its state; the arm could not move")
    try:
        hold(manipulator, arm.held)
    except ValueError as error:
        faults.append(f"actuators: as they are stuck, {error}")
    if faults:
        raise InputFaults(path, faults)
    return arm


def walled_in(arm: Arm) -> str | None:
    """Returns what the first module touches in every state; None if it does not."""
    clearance = arm.clearance(Manipulator(arm.manipulator.modules[:1], arm.manipulator.base))
    states = np.arange(len(arm.manipulator.modules[0].frames))[:, None]
    return clearance.where(states[0]) if clearance.blocked(states).all() else None


def map_actuators(settings: ArmSettings, manipulator: Manipulator, faults: list[str]) -> tuple[ActuatorSettings, ...]:
    """Returns the actuators' wiring in the order of the manipulator's actuators."""
    buses = [bus.name for bus in settings.buses]
    faults += [f"buses[{k}].name: {b!r} is already taken" for k, b in enumerate(buses) if b in buses[:k]]
    found: dict[str, ActuatorSettings] = {}
    taken: dict[tuple[str, str, int, int], str] = {}
    for k, entry in enumerate(settings.actuators):
        path, label = f"actuators[{k}]", f"{entry.module}.{entry.actuator}"
        if entry.module > len(manipulator.modules):
            faults.append(f"{path}.module: {entry.module}, but the arm has modules 1 to {len(manipulator.modules)}")
        elif label not in manipulator.actuators:
            names = ", ".join(manipulator.modules[entry.module - 1].actuators)
            faults.append(f"{path}.actuator: {entry.actuator!r}, but module {entry.module} has {names}")
        elif label in found:
            faults.append(f"{path}: actuator {label} is mapped already")
        else:
            found[label] = entry
        if entry.bus not in buses:
            faults.append(f"{path}.bus: {entry.bus!r} is none of the buses {', '.join(buses) or '(none)'}")
        for kind, bit in (("output", entry.output), ("input", entry.input)):
            if bit is None:
                continue
            where = (kind, entry.bus, entry.node, bit)
            if where in taken:
                faults.append(f"{path}.{kind}: {kind} {bit} of {entry.bus}/{entry.node} is {taken[where]}'s already")
            taken.setdefault(where, label)
    if settings.actuators or settings.buses:
        faults += [f"actuators: {label} is not mapped" for label in manipulator.actuators if label not in found]
    return tuple(found[label] for label in manipulator.actuators if label in found)

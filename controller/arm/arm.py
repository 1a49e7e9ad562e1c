"""Builds the arm from its YAML file, and reports each fault with the path of its field."""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.chain import build_frame, build_modules
from hyperbit.controller.armfile.actuators import longest_travel, map_actuators
from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.places import placed_faults
from hyperbit.controller.armfile.settings import ActuatorSettings, ArmSettings, read_settings
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.manipulator.locked import LockedStates, lock_actuators, none_locked
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import tipped
from hyperbit.controller.obstacles.clearance import BodyClearance
from hyperbit.controller.obstacles.notation import parse_obstacles
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles, together

MOST_PIXELS = 2**19


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm as its file describes it."""

    settings: ArmSettings
    manipulator: Manipulator
    # of each actuator, in the order of `manipulator.actuators`; empty if the file maps none
    wiring: tuple[ActuatorSettings, ...]
    obstacles: Obstacles = NONE  # of the file; no module may touch them
    path: Path | None = None  # of the file; None if the arm was not read from one
    # frame (4, 4) of the tool's tip in the last module's frame; None: the tip is the last module's frame
    tip: NDArray[np.float64] | None = None

    @cached_property
    def locked(self) -> LockedStates:
        """The states of the actuators that the file declares stuck, -1 for the others, shape (A,)."""
        locked = none_locked(self.manipulator)
        for k, entry in enumerate(self.wiring):
            if entry.stuck is not None:
                locked[k] = STATES.index(entry.stuck)
        return locked

    @cached_property
    def reduced(self) -> Manipulator:
        """The chain without the module states that stuck actuators exclude."""
        return lock_actuators(self.manipulator, self.locked)

    @property
    def digest(self) -> str:
        """Digest of the fields of the file and of its tables; comments and layout of the file do not change it."""
        m, digest = self.manipulator, hashlib.sha256(msgspec.json.encode(self.settings))
        for array in (m.base, m.states, m.rotations, m.translations):
            digest.update(array.tobytes())
        return digest.hexdigest()

    def clearance(self, manipulator: Manipulator | None = None, others: Obstacles = NONE) -> BodyClearance:
        """Returns the collision checks of the chain, or of a reduced one, against the file's obstacles and others."""
        return BodyClearance(
            manipulator or self.manipulator,
            together([self.obstacles, others]),
            self.settings.body_radius,
            self_collision=self.settings.self_collision,
        )

    @property
    def pixel(self) -> float:
        """Side of the finest pixel of the densities."""
        return self.settings.workspace.pixel or self.manipulator.length / 400

    @property
    def level_pixels(self) -> int:
        """Greatest number of pixels of one intermediate workspace, of four bytes each; at most MOST_PIXELS."""
        share = self.settings.workspace.memory * 2**20 / 4 / (len(self.manipulator.modules) + 1)
        return max(1, min(MOST_PIXELS, int(share)))

    @property
    def travel_time(self) -> float:
        """Longest time of any actuator from end to end [s]."""
        return longest_travel(self.settings)

    @property
    def tolerance(self) -> float:
        """Default position tolerance of goals."""
        return self.settings.tolerance.position

    @property
    def angle_tolerance(self) -> float:
        """Default orientation tolerance of goals [rad]."""
        return self.settings.tolerance.orientation


def load(path: Path) -> Arm:
    """Returns the arm that a YAML file describes. Raises InputFaults: one line for each fault, with its place."""
    with placed_faults(path):
        settings, faults = read_settings(path)
        return replace(build(settings, path, faults), path=path)


def build(settings: ArmSettings, path: Path, faults: list[str]) -> Arm:
    """Returns the arm that a file's fields describe.

    Args:
        path: of the file, for messages; tables are read from its folder.
        faults: found so far.

    Raises:
        InputFaults: the fields are wrong; one line per fault, each with the path of its field.
    """
    modules = build_modules(settings.modules, path.parent, faults)
    base = build_frame(settings.base, "base", faults)
    tip = None if settings.tip is None else build_frame(settings.tip, "tip", faults)
    if faults or not modules or base is None:
        raise InputFaults(path, faults)
    if tip is not None:
        modules[-1] = tipped(modules[-1], tip)
    manipulator = Manipulator(modules, base)
    wiring = map_actuators(settings, [module.actuators for module in modules], faults)
    if faults:
        raise InputFaults(path, faults)
    obstacles = parse_obstacles(settings.obstacles, manipulator.dimension, "obstacles", faults)
    arm = Arm(settings, manipulator, wiring, obstacles, tip=tip)
    if not faults and (walled := walled_in(arm)) is not None:
        faults.append(f"obstacles: {walled} in every state; the arm could not move")
    try:
        lock_actuators(manipulator, arm.locked)
    except ValueError as error:
        faults.append(f"actuators: as they are stuck, {error}")
    if faults:
        raise InputFaults(path, faults)
    return arm


def walled_in(arm: Arm) -> str | None:
    """Returns the obstacle or module that the first module touches in every state; None if there is none."""
    clearance = arm.clearance(Manipulator(arm.manipulator.modules[:1], arm.manipulator.base))
    states = np.arange(len(arm.manipulator.modules[0].frames))[:, None]
    return clearance.where(states[0]) if clearance.blocked(states).all() else None

"""Arms, loaded from a file or built in code, with locked or free actuators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm import arm as config
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.library.arguments import Count, Number, Numbers, Seed, told, typed
from hyperbit.controller.library.chain import Chain
from hyperbit.controller.library.density import Density, Reach, reach_of
from hyperbit.controller.library.errors import ArmError, GoalError, LockError
from hyperbit.controller.library.modules import Module, build, checked, frame_settings
from hyperbit.controller.library.obstacles import Obstacle, obstacle_settings
from hyperbit.controller.library.saving import save_arm
from hyperbit.controller.manipulator.locked import LockedStates, lock_actuators
from hyperbit.controller.workspace.cache import default_directory, load_or_map
from hyperbit.controller.workspace.coverage import Coverage, coverage_of
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.locked_reach import LockChoices, LockedReach, reach_when_locked
from hyperbit.controller.workspace.orientations import Orientations, orientations_at

Array = NDArray[np.float64]


@typed(ArmError)
class Arm(Chain):
    """An arm made of modules with two-state actuators.

    A configuration is one integer for each module, base first, shape (B,). Lengths have the unit of the arm's
    description. Locked actuators do not change the numbers of the configurations.

    Args:
        modules: entries of the chain, base first, see `vgt`, `revolute`, `prismatic`, `platform` and `transforms`.
        name: letters, digits, "_" and "-".
        unit: unit of all lengths of the arm, "m", "cm", "mm" or "in", for pictures and ROS 2; None: not named.
        base: position (2,) or (3,), or frame (4, 4), of the first module in the world; the origin if None.
        tip: position (2,) or (3,), or frame (4, 4), of the tool's tip in the last module's frame; that frame if None.
        tolerance: greatest distance of the tip from goals that have no tolerance.
        angle_tolerance: greatest angle of the tip from goals that have an orientation and no tolerance [rad].
        obstacles: obstacles in the world; no module may touch them.
        body_radius: half the thickness of the modules' bars, for collision checks.
        self_collision: whether modules that are not neighbours are checked against each other.
        pixel: side of the densities' pixels; 1/400 of the arm's length if None.

    Raises:
        ArmError: a module or another value is invalid.
    """

    def __init__(
        self,
        modules: Sequence[Module],
        *,
        name: str = "arm",
        unit: str | None = None,
        base: Numbers | None = None,
        tip: Numbers | None = None,
        tolerance: Number = 2e-3,
        angle_tolerance: Number = 0.05,
        obstacles: Sequence[Obstacle] = (),
        body_radius: Number = 0.0,
        self_collision: bool = False,
        pixel: Number | None = None,
    ) -> None:
        faults: list[str] = []
        regions = [obstacle_settings(obstacle, faults) for obstacle in obstacles]
        if faults:
            raise ArmError(faults, name)
        fields = {
            "name": name,
            "unit": unit,
            "modules": list(modules),
            "base": frame_settings((0.0, 0.0) if base is None else base, "base"),
            "tip": None if tip is None else frame_settings(tip, "tip"),
            "tolerance": {"position": float(tolerance), "orientation": float(angle_tolerance)},
            "obstacles": regions,
            "body_radius": float(body_radius),
            "self_collision": bool(self_collision),
            "workspace": {} if pixel is None else {"pixel": float(pixel)},
        }
        settings = checked(ArmSettings, msgspec.to_builtins(fields), name, {"tolerance.orientation": "angle_tolerance"})
        self._set_arm(build(settings, Path(name)))

    @classmethod
    def _of(cls, arm: config.Arm, locked_states: LockedStates | None = None) -> Arm:
        """Returns the arm of a file with locked states (A,); with the file's locked states if None."""
        self = cls.__new__(cls)
        self._set_arm(arm, locked_states)
        return self

    def _set_arm(self, arm: config.Arm, locked_states: LockedStates | None = None) -> None:
        self._arm = arm
        self._locked_states = arm.locked if locked_states is None else locked_states
        self._reduced = arm.reduced if locked_states is None else lock_actuators(arm.manipulator, locked_states)

    def __repr__(self) -> str:
        kind = "planar" if self.dimension == 2 else "spatial"
        locked = "".join(f", {label} {state}" for label, state in self.locked.items())
        return f"Arm({self.name!r}: {kind}, {len(self.states)} modules, {len(self.actuators)} actuators{locked})"

    def _repr_html_(self) -> str:
        from hyperbit.controller.library.plot import html

        return html(repr(self), self)

    def __getstate__(self) -> dict[str, Any]:
        """Returns what is pickled: all but the densities, which the cache folder has."""
        return {name: value for name, value in vars(self).items() if name != "_densities"}

    @property
    def name(self) -> str:
        """Name of the arm, also used in its daemon's Zenoh keys."""
        return self._arm.settings.name

    @property
    def unit(self) -> str | None:
        """Unit of all lengths, "m", "cm", "mm" or "in"; None if the arm's file names none."""
        return self._arm.settings.unit

    @property
    def tolerance(self) -> float:
        """Default position tolerance of goals, a length."""
        return self._arm.tolerance

    @property
    def angle_tolerance(self) -> float:
        """Default orientation tolerance of goals [rad]."""
        return self._arm.angle_tolerance

    @property
    def weights(self) -> Array:
        """Cost of a switch of each actuator, shape (A,)."""
        return weights_of(self._arm)

    @property
    def locked(self) -> dict[str, str]:
        """Locked actuators by label, each "contracted" or "extended"."""
        states = zip(self.actuators, self._locked_states.tolist(), strict=True)
        return {label: STATES[state] for label, state in states if state >= 0}

    def lock(self, states: Mapping[str, str | None]) -> Arm:
        """Returns a copy of the arm with locked actuators; this arm does not change.

        Args:
            states: "contracted" or "extended" by label, None to unlock; other actuators are unchanged.

        Raises:
            LockError: a label or a state is unknown, or a module has no state with these actuator states.
        """
        locked_states = self._locked_states.copy()
        for label, state in states.items():
            if label not in self.actuators:
                raise LockError(f"the arm has no actuator {label!r}; the first is {self.actuators[0]!r}")
            if state is not None and state not in STATES:
                raise LockError(f"{label}: 'contracted', 'extended' or None is needed, got {state!r}")
            locked_states[self.actuators.index(label)] = -1 if state is None else STATES.index(state)
        try:
            return Arm._of(self._arm, locked_states)
        except ValueError as error:
            raise LockError(str(error)) from None

    def save(self, path: str | Path) -> None:
        """Writes the arm's file, which `load` reads and `hyperbit check` accepts; an existing file is replaced.

        Fields with their defaults are left out, and tables are written out. Locked actuators become `stuck`.

        Raises:
            ArmError: the file cannot be written, or a table of the arm's file is gone.
            LockError: actuators are locked, and the arm maps none to boards: an arm's file names them there.
        """
        save_arm(self._arm, self._locked_states, Path(path))

    def density(self) -> Density:
        """Returns the density of the tip's positions; locked actuators are respected."""
        return Density(self._densities, self._reduced)

    def reach(self, radius: Number | None = None) -> Reach:
        """Returns the map of positions that the tip reaches, as an array; locked actuators are respected.

        Args:
            radius: greatest distance of the tip from a reached position; the arm's tolerance if None.

        Raises:
            GoalError: the radius is not positive.
        """
        return reach_of(self._densities, self._reduced, self._radius(radius))

    def coverage(self, radius: Number | None = None, *, seed: Seed = 0) -> Coverage:
        """Returns area or volume within a radius of the tips, and redundancy over it; locked actuators are respected.

        Args:
            radius: greatest distance of the tip from a covered position; the arm's tolerance if None.
            seed: seed of the random positions.

        Raises:
            GoalError: the radius is not positive.
        """
        return coverage_of(self._reduced, self._densities, self._radius(radius), seed=seed)

    def orientations(self, point: Numbers, radius: Number | None = None, *, seed: Seed = 0) -> Orientations:
        """Returns the density of orientations at a point; locked actuators are respected.

        Args:
            point: position in the world, shape (dimension,).
            radius: greatest distance of the tip from the point; the arm's tolerance if None.
            seed: seed of the random draws; short arms are enumerated instead.

        Raises:
            GoalError: the point has a wrong number of coordinates, or the radius is not positive.
        """
        position = np.asarray(point, dtype=float)
        if position.shape != (self.dimension,):
            raise GoalError(f"point: shape ({self.dimension},) is needed, got shape {position.shape}")
        return orientations_at(self._reduced, self._densities, position, self._radius(radius), seed=seed)

    def locked_reach(self, locks: Count = 1, samples: Count = 100, *, seed: Seed = 0) -> LockedReach:
        """Returns reach and redundancy with further locked actuators: worst, mean and each choice.

        Args:
            locks: number of actuators to lock; 1 tries all choices.
            samples: most random choices, if `locks` is above 1.
            seed: seed of the random choices.

        Raises:
            LockError: the arm has too few actuators to lock.
        """
        try:
            choices = LockChoices(locks, samples, seed)
            return reach_when_locked(self._reduced, self._densities, self.tolerance, choices)
        except ValueError as error:
            raise LockError(f"locks: {error}") from None

    def _radius(self, radius: Number | None) -> float:
        """Returns a distance from the tip as a float; the arm's tolerance for None."""
        own = self.tolerance if radius is None else float(radius)
        if not 1e-9 <= own <= self.length:
            most = f"the arm's length {self.length:g}"
            raise GoalError(f"radius: a number from 1e-9 to {most} is needed, got {told(radius)}")
        return own

    @cached_property
    def _densities(self) -> Densities:
        """Densities, computed at first use and stored in the cache folder."""
        return load_or_map(self._reduced, self._arm.pixel, self._arm.level_pixels, default_directory())

"""Arms, loaded from a file or built in code, with locked or free actuators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.arm import arm as config
from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.library.density import Density
from hyperbit.controller.library.errors import ArmError, ConfigurationError, GoalError, LockError
from hyperbit.controller.library.goals import Number
from hyperbit.controller.library.modules import Module, build, checked, frame_settings
from hyperbit.controller.library.obstacles import Obstacle, obstacle_settings
from hyperbit.controller.library.saving import save_arm
from hyperbit.controller.manipulator.locked import LockedStates, lock_actuators, transferred
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration
from hyperbit.controller.workspace.cache import default_directory, load_or_map
from hyperbit.controller.workspace.coverage import Coverage, coverage_of
from hyperbit.controller.workspace.densities import Densities
from hyperbit.controller.workspace.locked_reach import LockChoices, LockedReach, reach_when_locked
from hyperbit.controller.workspace.orientations import Orientations, orientations_at

Array = NDArray[np.float64]


class Arm:
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
        base: ArrayLike | None = None,
        tip: ArrayLike | None = None,
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
            "self_collision": self_collision,
            "workspace": {} if pixel is None else {"pixel": float(pixel)},
        }
        settings = checked(ArmSettings, msgspec.to_builtins(fields), name)
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
    def dimension(self) -> int:
        """2 for a planar arm, 3 for a spatial arm."""
        return self._whole.dimension

    @property
    def states(self) -> NDArray[np.int64]:
        """Number of states of each module, shape (B,)."""
        return self._whole.states.copy()

    @property
    def actuators(self) -> tuple[str, ...]:
        """Label of each actuator, "<module>.<name>", modules counted from 1 at the base; length A."""
        return self._whole.actuators

    @property
    def length(self) -> float:
        """Upper bound on the distance of the tip from the base."""
        return self._whole.length

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

    @cached_property
    def home(self) -> Configuration:
        """First configuration, shape (B,), read-only: state 0 of each module, or its first state that locks allow."""
        return self._to_whole(np.zeros(len(self._reduced.modules), dtype=np.int64))

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

    def frame(self, configuration: ArrayLike | str) -> Array:
        """Returns the tip's frame in the world, shape (4, 4), of a configuration (B,).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        return self._whole.tip(self.parse(configuration))

    def frames(self, configurations: ArrayLike) -> Array:
        """Returns the tips' frames in the world, shape (n, 4, 4), of configurations (n, B).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        rows, states = np.atleast_2d(np.asarray(configurations)), self._whole.states
        valid = rows.ndim == 2 and rows.shape[1] == len(states) and np.issubdtype(rows.dtype, np.integer)
        if not valid or ((rows < 0) | (rows >= states)).any():
            rows = np.array([self.parse(row) for row in rows])  # names the wrong row, or reads text
        return self._whole.tips(rows)

    def position(self, configuration: ArrayLike | str) -> Array:
        """Returns the tip's position in the world, shape (dimension,), of a configuration (B,).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        return self.frame(configuration)[: self.dimension, 3]

    def actuator_states(self, configuration: ArrayLike | str) -> NDArray[np.uint8]:
        """Returns the state of each actuator, 0 contracted or 1 extended, shape (A,), of a configuration (B,).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        return self._whole.actuator_states(self.parse(configuration))

    def configuration(self, actuator_states: ArrayLike) -> Configuration:
        """Returns the configuration (B,) of actuator states (A,), 0 contracted or 1 extended.

        Raises:
            ConfigurationError: no configuration has these states.
        """
        try:
            return self._whole.configuration(actuator_states)
        except ValueError as error:
            raise ConfigurationError(str(error)) from None

    def parse(self, configuration: ArrayLike | str) -> Configuration:
        """Returns a configuration (B,), given as an array or in the text form of `hyperbit plan`.

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        try:
            if isinstance(configuration, str):
                return parse_configuration(self._whole, configuration)
            given = np.asarray(configuration)
            if given.shape != self._whole.states.shape or not np.issubdtype(given.dtype, np.integer):
                count = len(self._whole.states)
                raise ValueError(f"integers of shape ({count},) are needed, got {given.dtype} of shape {given.shape}")
            return parse_configuration(self._whole, ",".join(map(str, given.tolist())))
        except ValueError as error:
            raise ConfigurationError(str(error)) from None

    def format(self, configuration: ArrayLike | str) -> str:
        """Returns a configuration (B,) as text: digits, or numbers with commas if a module has more than ten states."""
        return format_configuration(self._whole, self.parse(configuration))

    def switches(self, first: ArrayLike | str, second: ArrayLike | str) -> int:
        """Returns the number of actuators that differ between two configurations (B,)."""
        return self._whole.switches(self.parse(first), self.parse(second))

    def sample(self, count: int, seed: int = 0) -> NDArray[np.int64]:
        """Returns random configurations with the locked actuator states, shape (count, B); the same for each seed."""
        drawn = np.random.default_rng(seed).integers(0, self._reduced.states, (count, len(self._reduced.modules)))
        return np.array([self._to_whole(row) for row in drawn], dtype=np.int64).reshape(count, -1)

    def density(self) -> Density:
        """Returns the density of the tip's positions; locked actuators are respected."""
        return Density(self._densities, self._reduced)

    def coverage(self, radius: Number | None = None, *, seed: int = 0) -> Coverage:
        """Returns area or volume within a radius of the tips, and redundancy over it; locked actuators are respected.

        Args:
            radius: greatest distance of the tip from a covered position; the arm's tolerance if None.
            seed: seed of the random positions.

        Raises:
            GoalError: the radius is not positive.
        """
        own = self.tolerance if radius is None else float(radius)
        if not 0 < own < np.inf:
            raise GoalError(f"a radius above 0 is needed, got {radius!r}")
        return coverage_of(self._reduced, self._densities, own, seed=seed)

    def orientations(self, point: ArrayLike, radius: Number | None = None, *, seed: int = 0) -> Orientations:
        """Returns the density of orientations at a point; locked actuators are respected.

        Args:
            point: position in the world, shape (dimension,).
            radius: greatest distance of the tip from the point; the arm's tolerance if None.
            seed: seed of the random draws; short arms are enumerated instead.

        Raises:
            GoalError: the point has a wrong number of coordinates, or the radius is not positive.
        """
        position, own = np.asarray(point, dtype=float), self.tolerance if radius is None else float(radius)
        if position.shape != (self.dimension,) or not np.isfinite(position).all() or not 0 < own < np.inf:
            raise GoalError(f"a point of shape ({self.dimension},) and a radius above 0 are needed")
        return orientations_at(self._reduced, self._densities, position, own, seed=seed)

    def locked_reach(self, locks: int = 1, samples: int = 100, *, seed: int = 0) -> LockedReach:
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
            raise LockError(str(error)) from None

    @property
    def _whole(self) -> Manipulator:
        return self._arm.manipulator

    @cached_property
    def _densities(self) -> Densities:
        """Densities, computed at first use and stored in the cache folder."""
        return load_or_map(self._reduced, self._arm.pixel, self._arm.level_pixels, default_directory())

    def _to_reduced(self, configuration: ArrayLike | str) -> Configuration:
        """Returns a configuration (B,) in the numbering of the reduced arm. Raises ConfigurationError if none."""
        whole = self.parse(configuration)
        try:
            return transferred(whole, self._whole, self._reduced)
        except ValueError as error:
            raise ConfigurationError(f"as actuators are locked, {error}") from None

    def _to_whole(self, configuration: Configuration) -> Configuration:
        """Returns a configuration (B,) of the reduced arm in the numbering of the whole arm, read-only."""
        found = transferred(configuration, self._reduced, self._whole).copy()
        found.flags.writeable = False
        return found

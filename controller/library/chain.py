"""Configurations of an arm, and where they put its modules."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm import arm as config
from hyperbit.controller.library.arguments import Configurations, Numbers, Seed, array_of, typed
from hyperbit.controller.library.errors import ConfigurationError
from hyperbit.controller.manipulator.locked import LockedStates, transferred
from hyperbit.controller.manipulator.manipulator import Configuration, Manipulator
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration

Array = NDArray[np.float64]


@typed(ConfigurationError)
class Chain:
    """The modules of an arm: their configurations, and forward kinematics."""

    _arm: config.Arm
    _locked_states: LockedStates
    _reduced: Manipulator  # has the states that the locked actuators permit

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

    @cached_property
    def home(self) -> Configuration:
        """First configuration, shape (B,), read-only: state 0 of each module, or its first state that locks allow."""
        return self._to_whole(np.zeros(len(self._reduced.modules), dtype=np.int64))

    def frame(self, configuration: Configurations) -> Array:
        """Returns the tip's frame in the world, shape (4, 4), of a configuration (B,).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        return self._whole.tip(self.parse(configuration))

    def frames(self, configurations: Configurations) -> Array:
        """Returns the tips' frames in the world, shape (n, 4, 4), of configurations (n, B).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        return self._tips(np.atleast_2d(self._rows(configurations)))

    def module_frames(self, configuration: Configurations) -> Array:
        """Returns the frames of all modules in the world, base first and tip last, shape (B+1, 4, 4).

        Args:
            configuration: shape (B,); of many, shape (n, B), the result has shape (n, B+1, 4, 4).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        return self._whole.chain(self._rows(configuration))

    def outlines(self, configuration: Configurations) -> Array:
        """Returns the lines of all modules in the world, from end to end, shape (L, 2, dimension).

        Collision checks see these lines, with the arm's `body_radius` around them.

        Args:
            configuration: shape (B,); of many, shape (n, B), the result has shape (n, L, 2, dimension).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        return self._whole.body(self._rows(configuration))[..., : self.dimension]

    @property
    def outline_modules(self) -> NDArray[np.int64]:
        """Index in a configuration, from 0, of the module of each line of `outlines`, shape (L,)."""
        counts = [module.body.shape[1] for module in self._whole.modules]
        return np.repeat(np.arange(len(counts)), counts)

    def position(self, configuration: Configurations) -> Array:
        """Returns the tip's position in the world, shape (dimension,), of a configuration (B,).

        Args:
            configuration: shape (B,); of many, shape (n, B), the result has shape (n, dimension).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        return self._tips(self._rows(configuration))[..., : self.dimension, 3]

    def actuator_states(self, configuration: Configurations) -> NDArray[np.uint8]:
        """Returns the state of each actuator, 0 contracted or 1 extended, shape (A,), of a configuration (B,).

        Args:
            configuration: shape (B,); of many, shape (n, B), the result has shape (n, A).

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        return self._whole.actuator_states(self._rows(configuration))

    def configuration(self, actuator_states: Numbers) -> Configuration:
        """Returns the configuration (B,) of actuator states (A,), 0 contracted or 1 extended.

        Raises:
            ConfigurationError: no configuration has these states.
        """
        try:
            return self._whole.configuration(np.asarray(actuator_states))
        except ValueError as error:
            raise ConfigurationError(f"actuator_states: {error}") from None

    def parse(self, configuration: Configurations) -> Configuration:
        """Returns a configuration (B,), given as an array or in the text form of `hyperbit plan`.

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        row = self._rows(configuration)
        if row.ndim != 1:
            count = len(self._whole.states)
            raise ConfigurationError(f"configuration: one of shape ({count},) is needed, got shape {row.shape}")
        return row

    def format(self, configuration: Configurations) -> str:
        """Returns a configuration (B,) as text: digits, or numbers with commas if a module has more than ten states."""
        return format_configuration(self._whole, self.parse(configuration))

    def switches(self, first: Configurations, second: Configurations) -> Any:
        """Returns the number of actuators that differ between two configurations (B,).

        Args:
            first: shape (B,), or (n, B).
            second: shape (B,), or (n, B). If one of both is (n, B), the result is an array (n,).

        Raises:
            ConfigurationError: the arm has no such configuration, or the numbers of configurations differ.
        """
        before, after = self.actuator_states(first), self.actuator_states(second)
        if before.ndim == after.ndim == 2 and len(before) != len(after):
            raise ConfigurationError(f"second: {len(before)} configurations are needed, got {len(after)}")
        count = (before != after).sum(axis=-1)
        return count if count.ndim else int(count)

    def sample(self, count: int, seed: Seed = 0) -> NDArray[np.int64]:
        """Returns random configurations with the locked actuator states, shape (count, B); the same for each seed."""
        drawn = np.random.default_rng(seed).integers(0, self._reduced.states, (count, len(self._reduced.modules)))
        return np.array([self._to_whole(row) for row in drawn], dtype=np.int64).reshape(drawn.shape)

    @property
    def _whole(self) -> Manipulator:
        return self._arm.manipulator

    def _tips(self, rows: NDArray[np.int64]) -> Array:
        """Returns the tips' frames (..., 4, 4) of configurations (..., B)."""
        return self._whole.tips(rows.reshape(-1, rows.shape[-1])).reshape(*rows.shape[:-1], 4, 4)

    def _rows(self, given: Configurations) -> NDArray[np.int64]:
        """Returns one configuration (B,) or many (n, B), each an array or a text.

        Raises:
            ConfigurationError: the arm has no such configuration.
        """
        try:
            if isinstance(given, str):
                return parse_configuration(self._whole, given)
            rows, states = array_of(given), self._whole.states
            if rows.dtype.kind == "U" and rows.ndim == 1:
                return np.array([parse_configuration(self._whole, text) for text in rows], dtype=np.int64)
            if rows.ndim not in (1, 2) or rows.shape[-1] != len(states) or not np.issubdtype(rows.dtype, np.integer):
                forms = f"({len(states)},) or (n, {len(states)})"
                raise ValueError(
                    f"configuration: integers of shape {forms} are needed, got {rows.dtype} of shape {rows.shape}"
                )
            wrong = ((rows < 0) | (rows >= states)).reshape(-1, len(states)).any(axis=1)
            for row in rows.reshape(-1, len(states))[wrong]:
                parse_configuration(self._whole, ",".join(map(str, row.tolist())))  # names the module
            return rows.astype(np.int64, order="C")
        except ValueError as error:
            raise ConfigurationError(str(error)) from None

    def _to_reduced(self, configuration: Configurations) -> Configuration:
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

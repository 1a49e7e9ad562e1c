"""A macroscopically-serial manipulator: modules 1 to B on a base frame, from base to tip (section 2.1)."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.module import Module

Configuration = NDArray[np.int64]


class Manipulator:
    """The chain and its forward kinematics. Arrays over modules are padded to the largest number of states, Kmax.

    Attributes:
        modules: base first.
        base: frame F_0 in the world, shape (4, 4).
        planar: whether base and modules stay in the plane z = 0; positions then have two coordinates for users.
        states: number of states K_i of each module, shape (B,).
        rotations: R of each module's states, shape (B, Kmax, 3, 3).
        translations: b of each module's states, shape (B, Kmax, 3).
        bits: actuator states of each module's states, shape (B, Kmax, Amax).
    """

    def __init__(self, modules: Sequence[Module], base: Frame | None = None) -> None:
        """Builds the padded arrays. Raises ValueError if there is no module."""
        if not modules:
            raise ValueError("a manipulator needs at least one module, got none")
        self.modules = tuple(modules)
        self.base = np.eye(4) if base is None else np.array(base, dtype=float, order="C")
        self.planar = all(m.planar for m in self.modules) and bool(np.allclose(self.base[2], [0, 0, 1, 0]))
        self.states = np.array([len(m.frames) for m in self.modules])
        self.frames = np.tile(np.eye(4), (len(self.modules), self.states.max(), 1, 1))
        most = max(len(m.actuators) for m in self.modules)
        self.bits = np.zeros((*self.frames.shape[:2], most), dtype=np.uint8)
        for i, module in enumerate(self.modules):
            self.frames[i, : len(module.frames)] = module.frames
            self.bits[i, : len(module.bits), : len(module.actuators)] = module.bits
        self.rotations = np.ascontiguousarray(self.frames[:, :, :3, :3])
        self.translations = np.ascontiguousarray(self.frames[:, :, :3, 3])

    @property
    def dimension(self) -> int:
        return 2 if self.planar else 3

    @cached_property
    def actuators(self) -> tuple[str, ...]:
        """All actuators as "<module>.<name>", modules counted from 1 at the base; the order of all state vectors."""
        return tuple(f"{i + 1}.{name}" for i, module in enumerate(self.modules) for name in module.actuators)

    @cached_property
    def length(self) -> float:
        """An upper bound of the distance from base to tip, by the triangle inequality."""
        steps = np.linalg.norm(self.translations, axis=2)
        return float(steps.max(axis=1).sum())

    def tips(self, configurations: ArrayLike) -> Frame:
        """Returns the tip frames (n, 4, 4) of configurations (n, B)."""
        from hyperbit.controller.manipulator.frame_kernels import tips  # programs that only draw do without numba

        return np.asarray(tips(self.base, self.frames, np.require(configurations, np.int64, ("C", "W"))))

    def tip(self, configuration: ArrayLike) -> Frame:
        """Returns the tip frame (4, 4) of one configuration (B,)."""
        from hyperbit.controller.manipulator.frame_kernels import tip

        return np.asarray(tip(self.base, self.frames, np.require(configuration, np.int64, ("C", "W"))))

    def chain(self, configuration: ArrayLike) -> Frame:
        """Returns the frames F_0 to F_B (..., B+1, 4, 4) of configurations (..., B)."""
        rows = np.asarray(configuration)
        chain = [np.broadcast_to(self.base, (*rows.shape[:-1], 4, 4))]
        for i in range(len(self.modules)):
            chain.append(chain[-1] @ self.frames[i, rows[..., i]])
        return np.stack(chain, axis=-3)

    def body(self, configuration: ArrayLike) -> NDArray[np.float64]:
        """Returns the line segments (..., n, 2, 3) of the arm's structure in the world, of configurations (..., B)."""
        rows, chain = np.asarray(configuration), self.chain(configuration)
        parts = list[NDArray[np.float64]]()
        for i, module in enumerate(self.modules):
            turned, moved = chain[..., i, None, :3, :3], chain[..., i, None, None, :3, 3]
            parts.append(module.body[rows[..., i]] @ np.swapaxes(turned, -1, -2) + moved)
        return np.concatenate(parts, axis=-3)

    def actuator_states(self, configuration: ArrayLike) -> NDArray[np.uint8]:
        """Returns the actuator states (..., A) of configurations (..., B)."""
        return np.asarray(self.bits[self._rows, np.asarray(configuration)][..., self._filled])

    def configuration(self, actuator_states: ArrayLike) -> Configuration:
        """Returns the configuration (B,) of actuator states (A,). Raises ValueError if there is none."""
        states = np.asarray(actuator_states)
        if states.shape != (len(self.actuators),):
            raise ValueError(f"the arm has {len(self.actuators)} actuator states, got an array of shape {states.shape}")
        result, start = list[int](), 0
        if (wrong := np.flatnonzero((states != 0) & (states != 1))).size:
            label = self.actuators[wrong[0]]
            raise ValueError(f"an actuator's state is 0 or 1, got {states[wrong[0]]!r} of actuator {label}")
        whole = states.astype(np.int64).tobytes()
        for i, codes in enumerate(self._codes):
            end = start + len(self.modules[i].actuators)
            state = codes.get(whole[8 * start : 8 * end])
            if state is None:
                raise ValueError(f"module {i + 1} has no state in which {excluded(self.modules[i], states[start:end])}")
            result.append(state)
            start = end
        return np.array(result, dtype=np.int64)

    def per_module(self, values: ArrayLike) -> NDArray[np.float64]:
        """Returns values (A,) of the actuators by module, padded with 0, shape (B, Amax)."""
        result = np.zeros(self._filled.shape)
        result[self._filled] = values
        return result

    def switches(self, first: ArrayLike, second: ArrayLike) -> int:
        """Returns the number of actuators that differ between two configurations (B,)."""
        rows = self._rows
        return int(np.count_nonzero(self.bits[rows, np.asarray(first)] != self.bits[rows, np.asarray(second)]))

    @cached_property
    def _rows(self) -> NDArray[np.int64]:
        return np.arange(len(self.modules))

    @cached_property
    def _filled(self) -> NDArray[np.bool_]:
        """Mask of the places of arrays (B, Amax) that are not padding."""
        return np.array([len(m.actuators) for m in self.modules])[:, None] > np.arange(self.bits.shape[2])

    @cached_property
    def _codes(self) -> list[dict[bytes, int]]:
        """For each module: its first state by code. A code is the actuator states as bytes of int64."""
        every = [module.bits.astype(np.int64) for module in self.modules]
        return [{code.tobytes(): k for k, code in reversed(list(enumerate(codes)))} for codes in every]


def excluded(module: Module, states: NDArray[np.generic]) -> str:
    """Returns in words the actuator states (A,) that no state of a module has, such as "left is extended"."""
    alone = [not (module.bits[:, k] == state).any() for k, state in enumerate(states)]  # no state has it: it is locked
    named = zip(module.actuators, states, alone, strict=True)
    return " and ".join(f"{name} is {STATES[bool(state)]}" for name, state, odd in named if odd or not any(alone))

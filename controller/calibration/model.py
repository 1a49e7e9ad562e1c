"""A model of an arm: its tips as a function of the numbers of its file, with derivatives."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.chain import build_modules
from hyperbit.controller.armfile.modules import ModuleSettings
from hyperbit.controller.calibration.parameters import (
    Description,
    Key,
    Parameter,
    changed,
    entries_of,
    frame_of,
    moved,
    places_of,
    replaced,
    value_at,
)
from hyperbit.controller.calibration.platforms import pose_derivatives, tracked
from hyperbit.controller.calibration.samples import Samples
from hyperbit.controller.manipulator.frames import Frame

Array = NDArray[np.float64]
Place = tuple[Key, ...]  # of a part in the description

NUDGE = 1e-6  # step of finite differences, as a share of a parameter's prior


class Model:
    """An arm's description with P parameters that may change.

    A part is the base, an entry of modules, also one in a group, or the tip if there is one. It has one kind of module,
    or two kinds that alternate, each with frames (K, 4, 4).

    Attributes:
        description: description of the arm, as in the file or with another base.
    """

    def __init__(self, description: Description, parameters: Sequence[Parameter]) -> None:
        self.description, self.parameters = description, tuple(parameters)
        self._first = {where: frames_of(part) for where, part in parts(description).items()}
        self._alike: dict[tuple[Key, ...], list[int]] = {}
        for p, parameter in enumerate(self.parameters):
            self._alike.setdefault(parameter.where, []).append(p)
        self._places: list[tuple[Place, int]] = [(("base",), 0)]
        self._places += [(where, k % len(self._first[where])) for where, k in places_of(description)]
        self._places += [(("tip",), 0)] * ("tip" in description)

    def changed(self, steps: Array) -> Description:
        return changed(self.description, self.parameters, steps)

    def tips(self, samples: Samples, steps: Array) -> Frame:
        """Returns the tips (n, 4, 4) of the samples' configurations.

        Raises ValueError if there is no such arm: a truss does not close, or a platform has no assembly.
        """
        return self._chain(samples, self._frames(self.changed(steps)))[-1]

    def computed(self, configurations: NDArray[np.int64], *, oriented: bool) -> Samples:
        """Returns configurations (n, B) as samples with the tips that the description gives them."""
        still = np.tile(np.eye(4), (len(configurations), 1, 1))
        samples = Samples(configurations, still, oriented, np.arange(len(configurations)))
        return replace(samples, tips=self.tips(samples, np.zeros(len(self.parameters))))

    def residuals(self, samples: Samples, steps: Array) -> Array:
        """Returns the residuals (n, C), computed minus measured: coordinates, then rotations if they were measured.

        A rotation residual is the sine of the angle between both, times the axis; a planar arm has only its z. Raises
        ValueError like `tips`.
        """
        tips = self.tips(samples, steps)
        return self._compared(samples, tips - samples.tips, tips)

    def jacobian(self, samples: Samples, steps: Array) -> Array:
        """Returns the derivatives (n, C, P) of the residuals by the parameters. Raises ValueError like `tips`."""
        description = self.changed(steps)
        stacks = self._frames(description)
        chain, chosen = self._chain(samples, stacks), self._chosen(samples)
        after = [np.tile(np.eye(4), (len(samples.tips), 1, 1))]
        for i in range(len(self._places) - 1, 0, -1):
            part, kind = self._places[i]
            after.insert(0, stacks[part][kind][chosen[:, i]] @ after[0])
        columns = []
        for parameter in self.parameters:
            change = np.zeros_like(samples.tips)
            slopes = self._slopes(description, parameter, steps, stacks[parameter.part])
            for i, (part, kind) in enumerate(self._places):
                if part == parameter.part:
                    change += chain[i] @ slopes[kind][chosen[:, i]] @ after[i]
            columns.append(self._compared(samples, change, change))
        return np.stack(columns, axis=2)

    def _compared(self, samples: Samples, moved: Array, turned: Array) -> Array:
        """Returns residuals (n, C) from differences and frames (n, 4, 4), or derivatives of both."""
        planar = not isinstance(self.description["base"]["orientation"], list)
        coordinates = moved[:, : 2 if planar else 3, 3]
        if not samples.oriented:
            return coordinates
        product = np.swapaxes(samples.tips[:, :3, :3], 1, 2) @ turned[:, :3, :3]
        skew = (product - np.swapaxes(product, 1, 2)) / 2
        turns = skew[:, [2, 0, 1], [1, 2, 0]]
        return np.hstack([coordinates, turns[:, 2:] if planar else turns])

    def _chosen(self, samples: Samples) -> NDArray[np.int64]:
        """Returns the states (n, C) of the base, always 0, of the modules, and of the tip, always 0."""
        return np.pad(samples.configurations, ((0, 0), (1, int("tip" in self.description))))

    def _chain(self, samples: Samples, stacks: dict[Place, list[Frame]]) -> list[Frame]:
        """Returns the frames (n, 4, 4) below each place of the chain, and the tips."""
        chain, chosen = [np.tile(np.eye(4), (len(samples.tips), 1, 1))], self._chosen(samples)
        for i, (part, kind) in enumerate(self._places):
            chain.append(chain[-1] @ stacks[part][kind][chosen[:, i]])
        return chain

    def _frames(self, description: Description) -> dict[Place, list[Frame]]:
        return {where: frames_of(part, self._first[where]) for where, part in parts(description).items()}

    def _slopes(self, description: Description, parameter: Parameter, steps: Array, stacks: list[Frame]) -> list[Array]:
        """Returns the derivatives (K, 4, 4) of the frames of a part's kinds by one of its parameters."""
        first, alike = value_at(self.description, parameter.where), self._alike[parameter.where]

        def nudged(by: float) -> Description:
            value = first  # rotations do not commute, so all of this orientation are applied in order
            for p in alike:
                value = moved(value, self.parameters[p].axis, steps[p] + by * (self.parameters[p] is parameter))
            return parts(replaced(description, parameter.where, value))[parameter.part]

        part = parts(description)[parameter.part]
        if part.get("type") == "platform":
            return [pose_derivatives(part, nudged, stack) for stack in stacks]
        return slopes(lambda by: frames_of(nudged(by)), NUDGE * parameter.prior)


def slopes(frames_at: Callable[[float], list[Frame]], step: float) -> list[Array]:
    """Returns the derivatives (K, 4, 4) of several stacks of frames by central differences."""
    return [(more - less) / (2 * step) for less, more in zip(frames_at(-step), frames_at(step), strict=True)]


def parts(description: Description) -> dict[Place, Description]:
    """Returns base, entries of modules, and tip if there is one, by their places."""
    frames: dict[Place, Description] = {(name,): description[name] for name in ("base", "tip") if name in description}
    return {**frames, **entries_of(description)}


def frames_of(part: Description, near: list[Frame] | None = None) -> list[Frame]:
    """Returns the frames (K, 4, 4) of each kind of module in a part; `near`: those of a similar part.

    Raises ValueError if there is no such module.
    """
    if "type" not in part:
        return [frame_of(part)[None]]
    if part["type"] == "platform" and near is not None:
        return [tracked(part, near[0])]
    faults: list[str] = []
    try:
        two = msgspec.convert({**part, "count": min(part["count"], 2)}, ModuleSettings)
    except msgspec.ValidationError as error:  # a length below 0, or an angle of more than a turn
        raise ValueError(str(error)) from None
    modules = build_modules([two], Path(), faults)  # tables are written out, so no file is read
    if faults:
        raise ValueError(faults[0])
    return [module.frames for module in modules[: 2 if part["type"] == "vgt" else 1]]

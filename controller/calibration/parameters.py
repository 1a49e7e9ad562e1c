"""The numbers of an arm's file that calibration changes, with prior standard deviations.

They are the numbers of modules that have a unit, and those of the base and of the tip if the file has one. Modules of
one entry share their parameters, also in the repetitions of a group. The axes of joints do not change; the link behind
a joint may turn instead.
"""

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import getitem
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.saving import frame_fields
from hyperbit.controller.armfile.choices import RADIANS
from hyperbit.controller.armfile.modules import ChainEntry, GroupSettings, ModuleSettings, chain, places
from hyperbit.controller.armfile.names import shortened
from hyperbit.controller.armfile.places import counted, path_text
from hyperbit.controller.armfile.units import numbers_of
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.vgt import ACTUATORS

Key = str | int
Description = dict[
    str, Any
]  # the `base`, `modules` and `tip`, if there is one, of a file, all frames planar or all spatial, as plain values

# Prior standard deviations: of lengths relative to the mean length of a module, and of angles [rad].
LENGTHS, ANGLES = 0.05, 0.05


@dataclass(frozen=True)
class Parameter:
    """One number, or one axis of a spatial orientation."""

    where: tuple[Key, ...]  # keys and indices from the top of the file
    prior: float  # standard deviation
    axis: int | None = None  # axis of the frame about which it turns, 0 to 2; None: a number to add to

    @property
    def part(self) -> tuple[Key, ...]:
        """Place of the base, of the tip, or of an entry of modules, also one in a group."""
        end = 0
        while self.where[end] == "modules":
            end += 2
        return self.where[: max(end, 1)]

    @property
    def path(self) -> str:
        path = path_text(self.where)
        return path if self.axis is None else f"{path} about {'xyz'[self.axis]}"


def described(arm: Arm, *, each: bool) -> Description:
    """Returns the base and modules of an arm's file, with tables written out.

    If `each`, each module of each repetition has an entry, and each leg of a truss its own lengths.
    """
    planar, first, where = arm.manipulator.planar, dict[str, int](), places(arm.settings.modules)
    for k, entry in enumerate(where):
        first.setdefault(entry.path, k)
    if each:
        flat = chain(arm.settings.modules)
        entries = [single(plain_entry(arm, it, first), k) for it in flat for k in range(it.settings.count)]
    else:
        entries = list[Description]()
        for g, it in enumerate(arm.settings.modules):
            own = [plain_entry(arm, where[k], first) for path, k in first.items() if path.startswith(f"modules[{g}]")]
            group = isinstance(it, GroupSettings)
            entries += [{"type": "group", "count": it.count, "modules": own}] if group else own
    tip = {} if arm.tip is None else {"tip": frame_fields(arm.tip, planar=planar)}
    return {"base": frame_fields(arm.manipulator.base, planar=planar), "modules": entries, **tip}


def plain_entry(arm: Arm, entry: ChainEntry, first: Mapping[str, int]) -> Description:
    """Returns an entry as plain values, with a table written out; `first`: its first module, by path."""
    planar, modules, group = arm.manipulator.planar, arm.manipulator.modules, entry.settings
    plain: Description = msgspec.json.decode(msgspec.json.encode(group))
    if plain["type"] == "transforms":
        stack, place = modules[first[entry.path]].frames, first[entry.path]
        if arm.tip is not None and place == len(modules) - 1:
            stack = stack @ frames.inverse(arm.tip)
        states = [frame_fields(frame, planar=planar) for frame in stack]
        plain = {"type": "transforms", "count": group.count, "states": states}
    if "link" in plain:
        plain["link"] = frame_fields(frame_of(plain["link"]), planar=planar)
    return plain


def single(entry: Description, k: int) -> Description:
    """Returns a copy of an entry for its module k, from 0."""
    own = {**copy.deepcopy(entry), "count": 1}
    if own["type"] == "vgt":
        own["first_diagonal"] = ("BC", "AD")[(k + (own["first_diagonal"] == "AD")) % 2]
        if isinstance(own["lengths"], list):
            own["lengths"] = {name: list(own["lengths"]) for name in ACTUATORS}
    return own


def frame_of(settings: Description) -> Frame:
    """Returns the frame (4, 4) of the fields of a file."""
    position, orientation = settings["position"], settings["orientation"]
    if isinstance(orientation, list):
        return frames.spatial([*position, 0.0][:3], orientation)
    return frames.planar(position[0], position[1], orientation) if len(position) == 2 else frames.spatial(position)


def parameters(description: Description, length: float, modules: int) -> tuple[Parameter, ...]:
    """Returns all parameters of an arm, from its length and number of modules.

    The base has a wide prior, so that changes that modules could explain as well go to the base.
    """
    found = list(of_frame(("base",), description["base"], length, np.pi))
    if "tip" in description:
        found += of_frame(("tip",), description["tip"], LENGTHS * length / modules, ANGLES)
    for where, entry in entries_of(description).items():
        size = LENGTHS * length / modules
        own = {name: value for name, value in entry.items() if name not in ("link", "states")}
        found += [
            Parameter(place, ANGLES if unit == RADIANS else size)
            for place, _, unit in numbers_of(ModuleSettings, own, where)
        ]
        if "link" in entry:
            found += of_frame((*where, "link"), entry["link"], size, ANGLES)
        for k, state in enumerate(entry.get("states", [])):
            found += of_frame((*where, "states", k), state, size, ANGLES)
    return tuple(found)


def entries_of(description: Description) -> dict[tuple[Key, ...], Description]:
    """Returns the entries of modules by their places, those of groups once, base first."""
    found: dict[tuple[Key, ...], Description] = {}
    for g, entry in enumerate(description["modules"]):
        if entry["type"] != "group":
            found["modules", g] = entry
        else:
            found |= {("modules", g, "modules", j): own for j, own in enumerate(entry["modules"])}
    return found


def places_of(description: Description) -> list[tuple[tuple[Key, ...], int]]:
    """Returns the place of the entry of each module of the chain, and the module's number in the entry, from 0."""
    found, own = list[tuple[tuple[Key, ...], int]](), entries_of(description)
    for g, entry in enumerate(description["modules"]):
        group = entry["type"] == "group"
        parts = [place for place in own if place[1] == g]
        for _ in range(entry["count"] if group else 1):
            found += [(place, k) for place in parts for k in range(own[place]["count"])]
    return found


def chosen_parameters(every: Sequence[Parameter], parts: Sequence[str] | None) -> tuple[Parameter, ...]:
    """Returns those of the base, and those of the named parts; None: all.

    A part is the beginning of a path whose positions count from 1, such as "tip", "modules[2]" or "modules[1].link".
    Raises ValueError if a part has no parameter.
    """
    if parts is None:
        return tuple(every)
    found = {part: [it for it in every if within(counted(it.path), part)] for part in parts}
    for part, own in found.items():
        if not own:
            known = dict.fromkeys(counted(path_text(it.part)) for it in every)
            raise ValueError(f"{part!r} has no numbers to fit; parts are {shortened(list(known))}")
    named = {it for own in found.values() for it in own}
    return tuple(it for it in every if it.part == ("base",) or it in named)


def within(path: str, part: str) -> bool:
    """Returns whether a path is that of a part, or of something in it."""
    return path.startswith(part) and path[len(part) : len(part) + 1] in ("", ".", "[", " ")


def of_frame(where: tuple[Key, ...], frame: Description, length: float, angle: float) -> Iterator[Parameter]:
    """Yields the parameters of a frame: coordinates and an angle, or coordinates and three rotations."""
    yield from (Parameter((*where, "position", k), length) for k in range(len(frame["position"])))
    axes: list[int | None] = [0, 1, 2] if isinstance(frame["orientation"], list) else [None]
    yield from (Parameter((*where, "orientation"), angle, axis) for axis in axes)


def value_at(description: Description, where: Sequence[Key]) -> Any:
    return reduce(getitem, where, description)  # type: ignore[arg-type]


def changed(description: Description, chosen: Sequence[Parameter], steps: ArrayLike) -> Description:
    """Returns a description with the chosen parameters changed by steps (P,)."""
    for parameter, step in zip(chosen, np.asarray(steps).tolist(), strict=True):
        new = moved(value_at(description, parameter.where), parameter.axis, step)
        description = replaced(description, parameter.where, new)
    return description


def moved(value: Any, axis: int | None, step: float) -> Any:
    """Returns a number plus a step, or an orientation turned by a step [rad] about one of its axes."""
    if axis is None:
        return float(value + step)
    turn = frames.turned(np.eye(3)[axis], step)
    return frames.quaternion(frames.spatial((0, 0, 0), value) @ turn).tolist()


def replaced(value: Any, where: Sequence[Key], part: Any) -> Any:
    """Returns a copy of a value with another part at a place; the rest is shared."""
    if not where:
        return part
    result = value.copy()
    result[where[0]] = replaced(value[where[0]], where[1:], part)
    return result

"""Builds the modules of an arm's file, type by type; each fault names the path of its field."""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from hyperbit.controller.arm.tables import read_table
from hyperbit.controller.armfile.fields import Diagonal
from hyperbit.controller.armfile.modules import (
    EntrySettings,
    FrameSettings,
    ModuleSettings,
    PlatformSettings,
    PrismaticSettings,
    RevoluteSettings,
    TransformsSettings,
    VgtLengths,
    VgtSettings,
    chain,
)
from hyperbit.controller.armfile.strict import UNIT
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.joints import prismatic, revolute, summed
from hyperbit.controller.manipulator.module import Module, binary_code, transforms
from hyperbit.controller.manipulator.platform import platform
from hyperbit.controller.manipulator.vgt import ACTUATORS, vgt

PLATFORMS: dict[tuple[int, ...], str] = {(6, 3): "six in space", (3, 3): "three in space", (3, 2): "three in the plane"}


def build_modules(entries: Sequence[EntrySettings], folder: Path, faults: list[str]) -> list[Module]:
    """Returns the valid modules of the chain from `modules` of the file; `folder` is that of the tables.

    Repetitions share their modules. A sentence is appended to `faults` for each wrong field.
    """
    modules: list[Module] = []
    known: dict[tuple[str, bool], list[Module]] = {}  # by the path of the entry, and whether it begins with a bar
    below: ModuleSettings | None = None
    for path, _, settings in chain(entries):
        base_bar = isinstance(settings, VgtSettings) and below is not None and not isinstance(below, VgtSettings)
        if (path, base_bar) not in known:
            again = (path, not base_bar) in known  # its faults are told
            known[path, base_bar] = build_entry(settings, path, folder, [] if again else faults, base_bar=base_bar)
        modules += known[path, base_bar]
        below = settings
    return modules


def build_entry(
    settings: ModuleSettings, path: str, folder: Path, faults: list[str], *, base_bar: bool = False
) -> list[Module]:
    """Returns the modules of one entry, none if it is wrong; `base_bar`: a truss on a module without a bar there."""
    match settings:
        case VgtSettings():
            own = build_vgt(settings, path, faults)
        case RevoluteSettings() | PrismaticSettings():
            own = build_joint(settings, path, faults)
        case PlatformSettings():
            own = build_platform(settings, path, faults)
        case TransformsSettings():
            own = build_transforms(settings, path, folder, faults)
    made = [own[k % len(own)] for k in range(settings.count)] if own else []
    if made and base_bar and isinstance(settings, VgtSettings):
        made[0] = build_vgt(settings, path, [], base_bar=True)[0]
    return made


def build_frame(settings: FrameSettings, path: str, faults: list[str]) -> frames.Frame | None:
    """Returns the frame (4, 4); appends a fault and returns None if it is invalid."""
    angle, position = settings.orientation, settings.position
    if isinstance(angle, list):
        if abs(math.hypot(*angle) - 1.0) > UNIT:
            faults.append(f"{path}.orientation: a quaternion x, y, z, w of length 1 is needed, got {angle}")
            return None
        return frames.spatial([*position, 0.0][:3], angle)
    if len(position) == 3:
        if angle != 0.0:
            faults.append(f"{path}.orientation: a spatial frame needs a quaternion x, y, z, w, got the angle {angle:g}")
            return None
        return frames.spatial(position)
    return frames.planar(position[0], position[1], angle)


def build_vgt(group: VgtSettings, path: str, faults: list[str], *, base_bar: bool = False) -> list[Module]:
    """Returns the two kinds of truss that alternate; none if there are faults."""
    legs = group.lengths if isinstance(group.lengths, VgtLengths) else VgtLengths(*[group.lengths] * 3)
    lengths = (legs.left, legs.diagonal, legs.right)
    for name, (contracted, extended) in zip(ACTUATORS, lengths, strict=True):
        if contracted >= extended:
            faults.append(f"{path}.lengths: {name} is {contracted:g} contracted, so not {extended:g} extended")
    order: list[Diagonal] = ["BC", "AD"] if group.first_diagonal == "BC" else ["AD", "BC"]
    try:
        return [vgt(diagonal, group.width, *lengths, base_bar=base_bar) for diagonal in order]
    except ValueError as error:
        faults.append(f"{path}.lengths: {error}")
        return []


def build_joint(group: RevoluteSettings | PrismaticSettings, path: str, faults: list[str]) -> list[Module]:
    before = len(faults)
    if math.hypot(*group.axis) < 1e-9:
        faults.append(f"{path}.axis: a direction is needed, got {group.axis}")
    link = build_frame(group.link, f"{path}.link", faults)
    turns = isinstance(group, RevoluteSettings)
    field, listed = ("angles", group.angles) if isinstance(group, RevoluteSettings) else ("lengths", group.lengths)
    if (listed is None) == (group.cylinders is None):
        faults.append(f"{path}: either {field} or cylinders are needed, got {'both' if listed else 'neither'}")
    values = listed or []
    if turns:
        twice = [a for k, a in enumerate(values) if a in values[:k]]
        faults += [f"{path}.angles: {angle:g} occurs twice" for angle in twice]
    else:
        falling = [(a, b) for a, b in pairwise(values) if a >= b]
        faults += [f"{path}.lengths: {b:g} after {a:g}, but each must be greater than the last" for a, b in falling]
    same = [pair for pair in group.cylinders or [] if pair[0] == pair[1]]
    faults += [f"{path}.cylinders: {a:g} contracted and extended, so the cylinder does nothing" for a, _ in same]
    if len(faults) > before or link is None:
        return []
    axis, kind = [*group.axis, 0.0][:3], revolute if turns else prismatic
    if group.cylinders is None:
        return [kind(axis, values, link)]
    return [kind(axis, summed(group.cylinders), link, binary_code(1 << len(group.cylinders)))]


def build_platform(group: PlatformSettings, path: str, faults: list[str]) -> list[Module]:
    before, (contracted, extended) = len(faults), group.lengths
    if contracted >= extended:
        faults.append(f"{path}.lengths: {contracted:g} contracted, so not {extended:g} extended")
    shapes = [(len(joints), *sorted({len(point) for point in joints})) for joints in (group.base, group.top)]
    for name, shape in zip(("base", "top"), shapes, strict=True):
        if shape not in PLATFORMS:
            sizes = " and ".join(map(str, shape[1:]))
            known = ", ".join(f"{n} of {size} coordinates" for n, size in PLATFORMS)
            faults.append(f"{path}.{name}: {shape[0]} joints of {sizes} coordinates, but platforms have {known}")
    if len(faults) == before and shapes[0] != shapes[1]:
        faults.append(f"{path}.top: {PLATFORMS[shapes[1]]}, but the joints of base are {PLATFORMS[shapes[0]]}")
    if len(faults) > before:
        return []
    try:
        return [platform(group.base, group.top, group.lengths)]
    except ValueError as error:
        faults.append(f"{path}: {error}")
        return []


def build_transforms(group: TransformsSettings, path: str, folder: Path, faults: list[str]) -> list[Module]:
    """Returns the module of listed or tabulated frames; none if there are faults."""
    if (group.states is None) == (group.table is None):
        faults.append(f"{path}: either states or table is needed, got {'both' if group.table else 'neither'}")
        return []
    if group.table is not None:
        table = read_table(folder, group.table, f"{path}.table", faults)
        return [] if table is None else [transforms(table.frames, planar=table.planar)]
    listed = group.states or []
    each = [build_frame(state, f"{path}.states[{k}]", faults) for k, state in enumerate(listed)]
    stack = [frame for frame in each if frame is not None]
    if len(stack) < len(listed):
        return []
    flat = all(len(s.position) == 2 and not isinstance(s.orientation, list) for s in listed)
    return [transforms(stack, planar=flat)]

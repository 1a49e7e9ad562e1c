"""The chain of modules from a daemon's description of its arm, for programs that do not read the arm's file.

The description has the unit of the arm's file. ROS 2 and Foxglove want metres.
"""

from typing import Any

import numpy as np
from msgspec.structs import replace

from hyperbit.controller.armfile.units import metres_of
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module
from hyperbit.controller.messages.arm import Description, ModuleKind
from hyperbit.controller.messages.parts import Region


def described(arm: Description) -> Manipulator:
    """Returns the chain of an arm from its description, with its `drawing`.

    Raises ValueError or LookupError if a part is missing, or the parts are not of one arm.
    """
    names: list[list[str]] = [[] for _ in arm.frames]
    for label in arm.actuators:
        module, _, name = label.partition(".")
        names[int(module) - 1].append(name)
    planar, modules = arm.dimension == 2, list[Module]()
    for frames, kind, own in zip(arm.frames, structure_of(arm), names, strict=True):
        bits, body = np.array(kind.bits, dtype=np.uint8), np.array(kind.body, dtype=float)
        modules.append(Module(np.array(frames, dtype=float), bits, tuple(own), body, planar))
    return Manipulator(modules, base_of(arm))


def structure_of(arm: Description) -> list[ModuleKind]:
    """Returns the kind of each module (B,). Raises ValueError or LookupError if the description has none."""
    if not arm.drawing:
        raise ValueError("the description of the arm has no drawing")
    return [arm.drawing.kinds[kind] for kind in arm.drawing.modules]


def base_of(arm: Description) -> Frame:
    """Returns the frame of the base (4, 4). Raises ValueError if the description has none."""
    if arm.base is None:
        raise ValueError("the description of the arm has no base")
    return np.array(arm.base, dtype=float)


def in_metres(arm: Description) -> Description:
    """Returns a description with chain, drawing and obstacles in metres.

    Raises LookupError, TypeError or ValueError if its unit is unknown, or an obstacle has another form.
    """
    metres = metres_of(arm.unit)
    if metres == 1.0:
        return arm

    def placed(frames: Any) -> Any:
        array = np.array(frames, dtype=float)
        array[..., :3, 3] *= metres
        return array.tolist()

    drawing = arm.drawing
    if drawing:
        kinds = [ModuleKind(kind.bits, (np.array(kind.body, dtype=float) * metres).tolist()) for kind in drawing.kinds]
        drawing = replace(drawing, kinds=kinds)
    return replace(
        arm,
        unit="m",
        length=arm.length * metres,
        base=placed(base_of(arm)),
        frames=[placed(frames) for frames in arm.frames],
        drawing=drawing,
        obstacles=[scaled(it, metres) for it in arm.obstacles],
        sent_obstacles=[scaled(it, metres) for it in arm.sent_obstacles],
    )


def scaled(region: Region, factor: float) -> Region:
    """Returns an obstacle with its lengths times a factor; directions, angles and names stay."""
    lengths = ("centre", "size", "point", "radius")
    return {
        shape: {key: (np.array(it) * factor).tolist() if key in lengths else it for key, it in body.items()}
        if isinstance(body, dict)
        else body
        for shape, body in region.items()
    }

"""The description of the arm, and its parts on request."""

import base64
import hashlib
import math
import zlib
from importlib.metadata import version

import msgspec
import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.settings import files_beside
from hyperbit.controller.host.files import read_file
from hyperbit.controller.manipulator.notation import format_configuration
from hyperbit.controller.messages.arm import ArmFile, Density, Description, ModuleKind, Structure, Tolerances
from hyperbit.controller.workspace.densities import Densities


def description(arm: Arm) -> Description:
    manipulator = arm.manipulator
    return Description(
        name=arm.settings.name,
        version=version("hyperbit"),
        dimension=2 if manipulator.planar else 3,
        unit=arm.settings.unit,
        length=manipulator.length,
        states=manipulator.states.tolist(),
        frames=[module.frames.tolist() for module in manipulator.modules],
        base=manipulator.base.tolist(),
        tip=np.eye(4).tolist() if arm.tip is None else arm.tip.tolist(),
        actuators=list(manipulator.actuators),
        contracted=format_configuration(manipulator, [0] * len(manipulator.modules)),
        tolerance=Tolerances(arm.tolerance, arm.angle_tolerance),
        travel_time=arm.travel_time,
        on_stop=arm.settings.on_stop,
        on_loss=arm.settings.boards.on_loss,
        inrush=arm.settings.inrush,
        rest_time=arm.settings.rest_time,
        method=arm.settings.method,
        obstacles=[msgspec.to_builtins(entry) for entry in arm.settings.obstacles],
        body_radius=arm.settings.body_radius,
        self_collision=arm.settings.self_collision,
        boards=[msgspec.to_builtins(entry) for entry in arm.wiring],
    )


def drawing(arm: Arm) -> Structure:
    kinds = list(dict.fromkeys(arm.manipulator.modules))
    told = [ModuleKind(kind.bits.tolist(), kind.body.tolist()) for kind in kinds]
    return Structure([kinds.index(module) for module in arm.manipulator.modules], told)


def file(arm: Arm) -> ArmFile | None:
    """Returns the present file of the arm, with the tables that it names; None if it cannot be read."""
    if arm.path is None:
        return None
    try:
        data = read_file(arm.path)
        tables = {name: read_file(arm.path.parent / name).decode("utf-8-sig") for name in files_beside(arm.settings)}
        text = data.decode()
    except (OSError, UnicodeDecodeError):
        return None
    return ArmFile(name=arm.path.name, sha256=hashlib.sha256(data).hexdigest(), text=text, tables=tables)


def density(densities: Densities, *, planar: bool) -> Density:
    values = densities.level(0)
    most = float(values.max(initial=0.0))
    shades = 1 + np.round(254 * np.maximum(values, 0.0) / max(most, 1e-9))
    shades[values < 0] = 0
    return Density(
        shape=list(shades.shape),
        first=densities.references[0].tolist(),
        pixel=float(densities.pixels[0]),
        greatest=most - math.log(densities.volume(0, planar=planar)),
        values=base64.b64encode(zlib.compress(shades.astype(np.uint8).tobytes(), 1)).decode(),
    )

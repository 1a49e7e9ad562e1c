"""Warnings about an arm's file: values that are allowed, but probably mistakes."""

import statistics

import numpy as np
from msgspec import to_builtins

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.actuators import travel_times
from hyperbit.controller.armfile.choices import RADIANS, degrees_hint
from hyperbit.controller.armfile.modules import places
from hyperbit.controller.armfile.places import path_text, place
from hyperbit.controller.armfile.settings import ArmSettings, BoxSettings
from hyperbit.controller.armfile.strict import fault_list
from hyperbit.controller.armfile.terminals import actuator_bits
from hyperbit.controller.armfile.units import numbers_of
from hyperbit.controller.manipulator.module import Module

BIT_RATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)  # of CiA 301 [bit/s]
FAR = 20.0  # lengths of the arm, from which on an obstacle is likely to be in another unit
LARGEST_USUAL_ANGLE = 4.72  # [rad], three quarters of a turn
ODD_RATIO = 100.0  # of the size of a module to that of the others: millimetres among metres, or centimetres


def file_warnings(arm: Arm) -> list[str]:
    """Returns the warnings about an arm's file, each with path and line of the file if the arm was read from one."""
    found = [
        *size_warnings(arm),
        *length_warnings(arm),
        *angle_warnings(arm.settings),
        *pulse_warnings(arm.settings),
        *island_warnings(arm.settings),
        *bit_rate_warnings(arm.settings),
    ]
    if arm.path is None or not found:
        return found
    return [fault_list(str(arm.path), [warning.text], [warning.line]) for warning in place(arm.path, found)]


def size_warnings(arm: Arm) -> list[str]:
    """Returns a warning for each entry of `modules` that is far larger or smaller than the median module."""
    where = places(arm.settings.modules)
    sizes = [size(module) for module in arm.manipulator.modules]
    every = [own for own in sizes if own > 0]
    if not every:
        return []
    first: dict[str, float] = {}  # size of the first module of each entry
    for entry, own in zip(where, sizes, strict=True):
        first.setdefault(entry.path, own)
    usual, found = statistics.median_low(every), list[str]()
    for path, own in first.items():
        if own > 0 and not 1 / ODD_RATIO < own / usual < ODD_RATIO:
            ratio = f"{own / usual:.3g} times larger" if own > usual else f"{usual / own:.3g} times smaller"
            text = f"{own:.4g} long, {ratio} than the arm's median module of {usual:.4g}; check the unit of its lengths"
            found.append(f"{path}: {text}")
    return found


def size(module: Module) -> float:
    """Returns the greatest distance of a module's body or end from its base."""
    ends, bodies = np.asarray(module.frames)[:, :3, 3], module.body.reshape(-1, 3)
    return float(np.linalg.norm(np.concatenate([ends, bodies]), axis=1).max())


def length_warnings(arm: Arm) -> list[str]:
    """Returns a warning for each length of half the arm's or more, and for each obstacle many lengths away."""
    settings, length, found = arm.settings, arm.manipulator.length, list[str]()
    lengths = {
        "tolerance.position": settings.tolerance.position,
        "body_radius": settings.body_radius,
        "workspace.pixel": settings.workspace.pixel,
    }
    if arm.tip is not None:
        lengths["tip.position"] = float(np.linalg.norm(arm.tip[:3, 3]))
    if settings.tracker is not None:
        lengths |= {"tracker.noise": settings.tracker.noise, "tracker.clamp": settings.tracker.clamp}
    for path, own in lengths.items():
        if length > 0 and own is not None and own >= length / 2:
            found.append(f"{path}: {own:g}, but the whole arm is {length:.4g} long; check the unit")
    base = arm.manipulator.base[: arm.manipulator.dimension, 3]
    for k, obstacle in enumerate(settings.obstacles):
        for name, it in (("disc", obstacle.disc), ("sphere", obstacle.sphere), ("box", obstacle.box)):
            if it is None:
                continue
            size = max(it.size) if isinstance(it, BoxSettings) else it.radius
            away = float(np.linalg.norm(np.array(it.centre) - base))
            if length > 0 and max(size, away - size) > FAR * length:
                text = f"{size:g} large and {away:.4g} from the arm's base, but the whole arm is {length:.4g} long"
                found.append(f"obstacles[{k}].{name}: {text}; check the unit")
    return found


def angle_warnings(settings: ArmSettings) -> list[str]:
    """Returns a warning for each angle that is likely to be in degrees."""
    return [
        f"{path_text(keys)}: {angle:g} rad are more than three quarters of a turn{degrees_hint(angle)}"
        for keys, angle, unit in numbers_of(ArmSettings, to_builtins(settings))
        if unit == RADIANS and abs(angle) > LARGEST_USUAL_ANGLE
    ]


def pulse_warnings(settings: ArmSettings) -> list[str]:
    """Returns a warning for each pulse that is longer than the travel of its actuator."""
    found = []
    for k, entry in enumerate(settings.actuators):
        longest = max(travel_times(settings, entry))
        if entry.pulse is not None and entry.pulse > longest:
            text = f"{entry.pulse:g} s, but the actuator travels for {longest:g} s at most"
            found.append(f"actuators[{k}].pulse: {text}; check pulse and travel_time")
    return found


def island_warnings(settings: ArmSettings) -> list[str]:
    """Returns a warning for each valve of an island whose outputs are not those of one place, an even and the next."""
    islands, found = {(it.bus, it.node) for it in settings.boards.nodes if it.island}, list[str]()
    for k, entry in enumerate(settings.actuators):
        if (entry.bus, entry.node) not in islands:
            continue
        bits = {name: bit.bit for name, bit in actuator_bits(entry).items() if name.startswith("output")}
        even = bits["output"] & ~1
        place = f"the place of outputs {even} and {even + 1} of the island {entry.bus}/{entry.node}"
        if "output_off" not in bits and bits["output"] != even:
            text = f"{bits['output']} is the second solenoid of {place}; a valve with one solenoid has the even output"
            found.append(f"actuators[{k}].output: {text}, {even}")
        elif "output_off" in bits and bits["output_off"] & ~1 != even:
            text = f"{bits['output_off']} is not in {place}, where output {bits['output']} is; a valve has one place"
            found.append(f"actuators[{k}].output_off: {text}")
    return found


def bit_rate_warnings(settings: ArmSettings) -> list[str]:
    """Returns a warning for each bus whose bit rate CiA 301 does not list."""
    listed = ", ".join(f"{rate // 1000}" for rate in BIT_RATES)
    return [
        f"buses[{k}].bitrate: {bus.bitrate} bit/s is unusual for CANopen, which has {listed} kbit/s"
        for k, bus in enumerate(settings.buses)
        if bus.bitrate not in BIT_RATES
    ]

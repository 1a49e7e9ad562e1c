"""Warnings about an arm's file: values that are allowed, but probably mistakes."""

import statistics

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.actuators import travel_times
from hyperbit.controller.armfile.places import place
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.armfile.strict import fault_list
from hyperbit.controller.manipulator.module import Module

BIT_RATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)  # of CiA 301 [bit/s]
ODD_RATIO = 100.0  # ratio of a module's size to the others': a mix of millimetres, centimetres and metres


def file_warnings(arm: Arm) -> list[str]:
    """Returns the warnings about an arm's file, each with path and line of the file if the arm was read from one."""
    found = [*size_warnings(arm), *pulse_warnings(arm.settings), *bit_rate_warnings(arm.settings)]
    if arm.path is None or not found:
        return found
    return [fault_list(str(arm.path), [warning.text], [warning.line]) for warning in place(arm.path, found)]


def size_warnings(arm: Arm) -> list[str]:
    """Returns a warning for each entry of `modules` that is far larger or smaller than the median module."""
    sizes, start = list[float](), 0
    for group in arm.settings.modules:
        sizes.append(size(arm.manipulator.modules[start]))
        start += group.count
    every = [own for own, group in zip(sizes, arm.settings.modules, strict=True) if own > 0 for _ in range(group.count)]
    if not every:
        return []
    usual, found = statistics.median_low(every), list[str]()
    for g, own in enumerate(sizes):
        if own > 0 and not 1 / ODD_RATIO < own / usual < ODD_RATIO:
            ratio = f"{own / usual:.3g} times larger" if own > usual else f"{usual / own:.3g} times smaller"
            text = f"{own:.4g} long, {ratio} than the arm's median module of {usual:.4g}; check the unit of its lengths"
            found.append(f"modules[{g}]: {text}")
    return found


def size(module: Module) -> float:
    """Returns the greatest distance of a module's body or end from its base."""
    ends, bodies = np.asarray(module.frames)[:, :3, 3], module.body.reshape(-1, 3)
    return float(np.linalg.norm(np.concatenate([ends, bodies]), axis=1).max())


def pulse_warnings(settings: ArmSettings) -> list[str]:
    """Returns a warning for each pulse that is longer than the travel of its actuator."""
    found = []
    for k, entry in enumerate(settings.actuators):
        longest = max(travel_times(settings, entry))
        if entry.pulse is not None and entry.pulse > longest:
            text = f"{entry.pulse:g} s, but the actuator travels for {longest:g} s at most"
            found.append(f"actuators[{k}].pulse: {text}; check pulse and travel_time")
    return found


def bit_rate_warnings(settings: ArmSettings) -> list[str]:
    """Returns a warning for each bus whose bit rate CiA 301 does not list."""
    listed = ", ".join(f"{rate // 1000}" for rate in BIT_RATES)
    return [
        f"buses[{k}].bitrate: {bus.bitrate} bit/s is unusual for CANopen, which has {listed} kbit/s"
        for k, bus in enumerate(settings.buses)
        if bus.bitrate not in BIT_RATES
    ]

"""Random arms for the planner's core: an executor's arm with modules whose configurations can be listed."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import msgspec
import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.executor.arm.arm import ExecutedArm
from hyperbit.controller.manipulator.frames import planar
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module, binary_code, lines

TOLERANCE = 0.001
NEVER = 0.3  # share of the modules without some states whose last actuator never extends


def draw_planned_arm(random: Random, drawn: ExecutedArm) -> tuple[ExecutedArm, Arm]:
    """Returns an arm as executor and planner know it; `drawn` has the wiring."""
    modules, left = list[Module](), len(drawn.actuators)
    while left:
        count = min(left, random.randint(1, 3))
        modules.append(draw_module(random, count))
        left -= count
    manipulator = Manipulator(modules)
    labels = manipulator.actuators
    channels = [replace(channel, actuator=label) for channel, label in zip(drawn.wiring.channels, labels, strict=True)]
    locked = drawn.locked if contracts(modules, drawn.locked) else 0
    executed = replace(
        drawn,
        wiring=replace(drawn.wiring, channels=tuple(channels)),
        locked=locked,
        locked_states=locked,
        planner_timeout=random.choice([0.5, 1.0, 2.0]),
    )
    return executed, Arm(draw_settings(random, executed), manipulator, ())


def draw_module(random: Random, count: int) -> Module:
    """Returns a module with a configuration for some codes of its actuators, for 0 at least."""
    codes = binary_code(1 << count)
    if count > 1 and random.random() < 0.5:
        most = len(codes) // 2 if random.random() < 0.3 else 1
        never = codes[:, -1] == 0
        codes = codes[never] if random.random() < NEVER else codes[: len(codes) - random.randint(1, most)]
    frames = [
        planar(random.uniform(0.2, 1.0), random.uniform(-0.5, 0.5), random.uniform(-0.8, 0.8))
        for _ in range(len(codes))
    ]
    stack = np.array(frames)
    return Module(stack, codes, tuple(str(k + 1) for k in range(count)), lines(stack), planar=True)


def contracts(modules: list[Module], mask: int) -> bool:
    """Returns whether each module has a configuration with the actuators of a mask in state 1."""
    for module in modules:
        count = len(module.actuators)
        wanted = np.array([mask >> k & 1 for k in range(count)], np.uint8)
        if not (module.bits >= wanted).all(axis=1).any():
            return False
        mask >>= count
    return True


def draw_settings(random: Random, arm: ExecutedArm) -> ArmSettings:
    """Returns the fields of the arm's file that the planner's core uses."""
    travels = [max(channel.travel) for channel in arm.wiring.channels if channel.travel is not None]
    fields = {
        "name": arm.name,
        "modules": [{"type": "prismatic", "axis": [1.0, 0.0], "lengths": [0.0, 1.0]}],
        "tolerance": {"position": TOLERANCE},
        "travel_time": max([arm.timing.travel_time, *travels]),
        "rest_time": arm.rest,
        "inrush": arm.inrush,
        "planner_timeout": arm.planner_timeout,
        "body_radius": random.choice([0.0, 0.02]),
        "workspace": {"pixel": 0.05},
        "method": random.choice([*["minimum-switch"] * 5, "ipop-previous"]),
    }
    if random.random() < 0.3:
        fields["tracker"] = {"noise": 1e-5, "clamp": 1e-3, "hold": 5.0}
    return msgspec.convert(fields, ArmSettings)

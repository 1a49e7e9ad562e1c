"""Arms with known errors, and simulated measurements of their tips."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.calibration.model import Model
from hyperbit.controller.calibration.parameters import described, parameters
from hyperbit.controller.calibration.samples import Samples
from hyperbit.controller.manipulator import frames

NOISE, TURN = 1e-4, 1e-3  # of a coordinate, and of an angle [rad]

TRUSSES = [{"type": "vgt", "count": 5, "width": 0.2, "lengths": [0.2, 0.25]}]
JOINTS = [
    {"type": "revolute", "count": 4, "angles": [-0.4, 0.1, 0.5], "link": {"position": [0, 0.2]}},
    {"type": "prismatic", "count": 1, "axis": [0, 1], "lengths": [0.1, 0.2], "link": {"position": [0.05, 0.0]}},
]
PLATFORMS = [
    {
        "type": "platform",
        "count": 2,
        "base": [[0.15, 0, 0], [-0.075, 0.13, 0], [-0.075, -0.13, 0]],
        "top": [[0.1, 0, 0], [-0.05, 0.087, 0], [-0.05, -0.087, 0]],
        "lengths": [0.18, 0.22],
    }
]
FRAMES = [
    {
        "type": "transforms",
        "count": 3,
        "states": [
            {"position": [0, 0, 0.2], "orientation": [0.2, 0, 0, 0.9798]},
            {"position": [0.02, 0, 0.22], "orientation": [0, 0.2, 0, 0.9798]},
            {"position": [0, 0.03, 0.21]},
        ],
    }
]
TOOLED = [{"type": "vgt", "count": 4, "width": 0.2, "lengths": [0.2, 0.25]}]  # with this tip:
TIP = {"position": [0.05, 0.2], "orientation": 0.3}
SERIES = [
    {"type": "revolute", "count": 3, "cylinders": [[-0.3, 0.1], [-0.1, 0.4]], "link": {"position": [0, 0.2]}},
    {"type": "prismatic", "axis": [0, 1], "cylinders": [[0.1, 0.15], [0.0, 0.1]]},
]
GROUPS = [
    {
        "type": "group",
        "count": 3,
        "modules": [
            {"type": "prismatic", "axis": [0, 1], "cylinders": [[0, 0.05], [0, 0.1]], "link": {"position": [0, 0.1]}},
            {"type": "revolute", "angles": [-0.4, 0.5], "link": {"position": [0, 0.1]}},
            {"type": "vgt", "count": 2, "width": 0.2, "lengths": [0.2, 0.25]},
        ],
    }
]
ARMS = {
    "trusses": TRUSSES,
    "joints": JOINTS,
    "platforms": PLATFORMS,
    "frames": FRAMES,
    "mixed": TRUSSES + JOINTS,
    "tooled": TOOLED,
    "series": SERIES,
    "groups": GROUPS,
}


def arm_of(folder: Path, modules: list[dict], **more: object) -> Arm:
    file = folder / "arm.yaml"
    more |= {"tip": TIP} if modules is TOOLED else {}
    file.write_text(yaml.safe_dump({"name": "a", "modules": modules, "tolerance": {"position": 0.002}, **more}))
    return load(file)


def erring(arm: Arm, rng: np.random.Generator, *, each: bool = False, size: float = 5e-4, base: float = 0.01) -> Model:
    """The real arm: all lengths, angles and coordinates have errors of `size`, the base of `base`."""
    description = described(arm, each=each)
    chosen = parameters(description, arm.manipulator.length, len(arm.manipulator.modules))
    steps = rng.normal(size=len(chosen)) * [base if p.part == ("base",) else size for p in chosen]
    return Model(Model(description, chosen).changed(steps), chosen)


def measured(
    arm: Arm, real: Model, rng: np.random.Generator, count: int, *, oriented: bool = True, noise: float = 1.0
) -> Samples:
    manipulator = arm.manipulator
    configurations = np.column_stack([rng.integers(0, k, count) for k in manipulator.states])
    lines = np.arange(count) + 2
    still = Samples(configurations, np.tile(np.eye(4), (count, 1, 1)), oriented, lines)
    tips = real.tips(still, np.zeros(len(real.parameters)))
    d = manipulator.dimension
    tips[:, :d, 3] += rng.normal(size=(count, d)) * NOISE * noise
    for k in range(count):
        turn = rng.normal(size=3) * TURN * noise * ([0, 0, 1] if manipulator.planar else [1, 1, 1])
        tips[k, :3, :3] @= frames.turned([0, 0, 1], turn[2])[:3, :3]
        if not manipulator.planar:
            tips[k, :3, :3] @= frames.turned([0, 1, 0], turn[1])[:3, :3] @ frames.turned([1, 0, 0], turn[0])[:3, :3]
        if not oriented:
            tips[k, :3, :3] = np.eye(3)
    return Samples(configurations, tips, oriented, lines)

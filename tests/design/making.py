"""Random arms and targets whose every configuration can be tried."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hyperbit.controller.arm.arm import build
from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.armfile.strict import InputFaults, check
from hyperbit.controller.design.merit import Judged, Target, judged

CORNERS = ((1.0, 0.0), (-0.5, 0.866), (-0.5, -0.866))


def judged_fields(fields: dict[str, Any]) -> Judged:
    faults: list[str] = []
    settings = check(fields, ArmSettings, faults)
    assert settings is not None, faults
    return judged(build(settings, Path("arm"), faults))


def random_arm(random: np.random.Generator, bits: int) -> Judged:
    """A planar or spatial arm of at most 2^bits configurations, some among obstacles."""
    while True:
        kind = random.integers(3)
        short = random.uniform(0.18, 0.25)
        lengths = [short, short + random.uniform(0.03, 0.07)]
        if kind == 0:
            modules = [{"type": "vgt", "count": bits // 3, "width": random.uniform(0.18, 0.3), "lengths": lengths}]
        elif kind == 1:
            cylinders = random.uniform(-0.5, 0.5, (2, 2)).tolist()
            link = {"position": [0, random.uniform(0.1, 0.3)]}
            modules = [{"type": "revolute", "cylinders": cylinders, "link": link, "count": bits // 2}]
        else:
            joints = [[0.15 * x, 0.15 * y, 0.0] for x, y in CORNERS]
            modules = [{"type": "platform", "base": joints, "top": joints, "lengths": lengths, "count": bits // 3}]
        fields: dict[str, Any] = {"name": "random", "modules": modules, "tolerance": {"position": 0.01}}
        if random.random() < 0.5:
            round_one = "sphere" if kind == 2 else "disc"
            centre = random.uniform(0.3, 0.8, 3 if kind == 2 else 2).tolist()
            fields["obstacles"] = [{round_one: {"centre": centre, "radius": 0.15}}]
        try:
            return judged_fields(fields)
        except InputFaults:
            continue


def random_targets(random: np.random.Generator, own: Judged, count: int) -> list[Target]:
    """Targets near tips of random configurations, some of them out of reach, some poses, with weights."""
    chain, found = own.manipulator, list[Target]()
    for k in range(count):
        tip = chain.tip(random.integers(0, chain.states))
        tip[: chain.dimension, 3] += random.normal(0, 0.01 if k % 3 else 0.1, chain.dimension)
        goal = tip if k % 4 == 3 else tip[: chain.dimension, 3]
        found.append(Target(goal, 0.02, 0.3 if goal.ndim == 2 else None, float(random.uniform(0.5, 3))))
    return found

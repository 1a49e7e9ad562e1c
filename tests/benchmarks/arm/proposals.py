"""Error of calibrated arms by the number of tips: in proposed configurations, and in random ones.

Each length, coordinate and angle of an arm has an error of 1 % of a module's length, or 0.01 rad; each coordinate of a
tip is measured to 0.1 % of a module's length. The error is that of positions of the tip, without noise, in
configurations that were not measured: random ones, and ones whose tips are spread evenly over the workspace.

Usage: python -m tests.benchmarks.arm.proposals
"""

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.calibration.calibration import models
from hyperbit.controller.calibration.fit import distances, fit
from hyperbit.controller.calibration.model import Model
from hyperbit.controller.calibration.parameters import described, parameters
from hyperbit.controller.calibration.proposals import Design
from hyperbit.controller.calibration.samples import Samples
from tests.benchmarks.harness import CommandLine, show, write_figures
from tests.calibration.making import ARMS, arm_of

ERROR, NOISE = 0.01, 1e-3
COUNTS, REPEATED, UNSEEN = (18, 24, 36, 48, 72, 96), 8, 400


def proposed(arm: Arm, model: Model, count: int) -> NDArray[np.int64]:
    design, found = Design(arm, model), []
    while len(found) < count and (wanted := design.propose()) is not None:
        design.add(wanted[None])
        found.append(wanted)
    return np.array(found)


def evenly(arm: Arm, model: Model) -> NDArray[np.int64]:
    return Design(arm, model, seed=7).pool[:UNSEEN]


def errors(arm: Arm, random: np.random.Generator) -> NDArray[np.float64]:
    """Errors in units of the noise: (2 ways to choose, 2 sets of unseen configurations, numbers of tips)."""
    description, length = described(arm, each=False), arm.manipulator.length
    size, dimension = length / len(arm.manipulator.modules), arm.manipulator.dimension
    numbers = parameters(description, length, len(arm.manipulator.modules))
    model = Model(description, numbers)
    drawn = [np.column_stack([random.integers(0, k, n) for k in arm.manipulator.states]) for n in (COUNTS[-1], UNSEEN)]
    chosen = (drawn[0], proposed(arm, model, COUNTS[-1]))
    result = np.zeros((REPEATED, 2, 2, len(COUNTS)))
    for own in result:
        turns = np.array([it.where[-1] == "orientation" or "angles" in it.where for it in numbers])
        steps = random.normal(size=len(numbers)) * np.where(turns, ERROR, ERROR * size)
        real = Model(model.changed(steps), numbers)
        unseen = [real.computed(rows, oriented=False) for rows in (drawn[1], evenly(arm, model))]
        for rows, told in zip(chosen, own, strict=True):
            seen = real.computed(rows, oriented=False)
            seen.tips[:, :dimension, 3] += random.normal(size=(len(rows), dimension)) * NOISE * size
            for k, count in enumerate(COUNTS):
                some = seen.only(np.arange(len(rows)) < count)
                fitted, _ = models(arm, some, description, numbers)
                found = fit(fitted, some, length)
                told[:, k] = [rms(fitted, each, found.steps) / (NOISE * size) for each in unseen]
    return np.median(result, axis=0)


def rms(model: Model, samples: Samples, steps: NDArray[np.float64]) -> float:
    return float(np.sqrt((distances(model, samples, steps) ** 2).mean()))


def main() -> None:
    given, rows = CommandLine(__doc__).parse(), []
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1, "blas"):
        for kind in ("trusses", "joints", "series"):
            found = errors(arm_of(Path(folder), ARMS[kind]), np.random.default_rng(1))
            for way, of_way in zip(("random", "proposed"), found, strict=True):
                for where, figures in zip(("random", "even"), of_way, strict=True):
                    rows.append((kind, way, where, *(f"{x:.2f}" for x in figures)))
    show("errors over the noise of a tip", ("arm", "measured", "unseen", *map(str, COUNTS)), rows)
    write_figures(given.json, rows)


if __name__ == "__main__":
    main()

"""An arm's calibration: the base set upright first, then all numbers fitted, and tried on samples held out."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from controller.calibration.fit import CannotFit, Fit, angles, distances, fit
from controller.calibration.model import Array, Model
from controller.calibration.parameters import (
    Description,
    Parameter,
    described,
    frame_of,
    parameters,
    value_at,
    written,
)
from controller.calibration.samples import Samples
from controller.config import Arm
from controller.manipulator.frames import Frame

FOLDS = 5
FEWEST = 10  # samples
MOST_PARAMETERS = 1000
DIGITS = 10  # written


@dataclass(frozen=True)
class Residuals:
    """Distances, or angles [rad], between computed and measured tips: root mean square, 95 % and worst."""

    rms: float
    most: float
    worst: float


@dataclass(frozen=True)
class Misfit:
    """Residuals of positions and, where they were measured, of orientations."""

    position: Residuals
    orientation: Residuals | None


@dataclass(frozen=True, eq=False)
class Change:
    """One parameter.

    Attributes:
        parameter: where it stands.
        before: the value in the file, or the quaternion; in a file that gives every module an entry.
        after: the new one.
        deviation: its standard deviation now.
        told: whether the samples tell more of it than the file.
    """

    parameter: Parameter
    before: Any
    after: Any
    deviation: float
    told: bool


@dataclass(frozen=True, eq=False)
class Calibration:
    """What was found.

    Attributes:
        samples: how many there are.
        aside: lines of those set aside.
        before: misfit of the arm as in the file, over the samples kept, as all that follow.
        after: of the calibrated one.
        held_out: of arms fitted to four fifths of the samples, over the fifth that each has not seen.
        noise: standard deviation of a coordinate, and of a turn [rad] if there are any.
        loose: how many directions in the space of parameters are held by the file, not by the samples.
        changes: of all parameters.
        description: `base` and `modules` of the new file.
    """

    samples: int
    aside: tuple[int, ...]
    before: Misfit
    after: Misfit
    held_out: Misfit
    noise: Array
    loose: int
    changes: tuple[Change, ...]
    description: Description

    @property
    def better(self) -> bool:
        """Whether samples that it has not seen are met better than by the file."""
        return self.held_out.position.rms < self.before.position.rms


def calibrated(arm: Arm, samples: Samples, *, each: bool) -> Calibration:
    """Returns the calibration of an arm.

    Args:
        arm: as its file has it.
        samples: what was measured.
        each: give every module, and every leg of a truss, numbers of its own.

    Raises:
        CannotFit: there are too few samples, too many parameters, or no arm like the file's suits them.
    """
    if len(samples.tips) < FEWEST:
        raise CannotFit(f"{len(samples.tips)} samples, at least {FEWEST} are needed")
    length = arm.manipulator.length
    in_file = described(arm, each=each)
    chosen = parameters(in_file, length, len(arm.manipulator.modules))
    if len(chosen) > MOST_PARAMETERS:
        raise CannotFit(f"{len(chosen)} numbers would be fitted, at most {MOST_PARAMETERS} can be")
    model = Model({**in_file, "base": base_under(arm, samples)}, chosen)
    found = fit(model, samples, length)
    new = rounded(model.changed(found.steps))
    original = Model(in_file, chosen)
    kept, still = samples.only(found.kept), np.zeros(len(chosen))
    return Calibration(
        samples=len(samples.tips),
        aside=tuple(samples.lines[~found.kept].tolist()),
        before=misfit([(original, kept, still)]),
        after=misfit([(Model(new, chosen), kept, still)]),
        held_out=misfit(held_out(model, samples, length, found)),
        noise=found.noise,
        loose=found.loose,
        changes=tuple(
            Change(p, value_at(in_file, p.where), value_at(new, p.where), float(deviation), bool(told > 0.5))
            for p, deviation, told in zip(chosen, found.deviations, found.told, strict=True)
        ),
        description=new,
    )


def base_under(arm: Arm, samples: Samples) -> Description:
    """Returns the base that brings the computed tips nearest to the measured ones, or the file's if that is nearer.

    A tracker's world may be any; from afar least squares may end anywhere. By Kabsch, twice: the second time over the
    nearer half of the samples, as some may be far off.
    """
    manipulator, measured = arm.manipulator, samples.tips[:, :3, 3]
    tips = manipulator.tips(samples.configurations)[:, :3, 3]
    best, chosen = np.eye(4), np.ones(len(tips), dtype=bool)
    nearest = np.median(np.linalg.norm(tips - measured, axis=1))
    for _ in range(2):
        moved = frame_of(written(onto(tips[chosen], measured[chosen]), planar=manipulator.planar))
        away = np.linalg.norm(tips @ moved[:3, :3].T + moved[:3, 3] - measured, axis=1)
        chosen = away <= np.median(away)
        if np.median(away) < nearest:
            best, nearest = moved, np.median(away)
    return written(best @ manipulator.base, planar=manipulator.planar)


def onto(points: Array, others: Array) -> Frame:
    """Returns the frame (4, 4) that moves points (n, 3) nearest to others (n, 3), after Kabsch 1976."""
    middle, other = points.mean(axis=0), others.mean(axis=0)
    u, _, v = np.linalg.svd((points - middle).T @ (others - other))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    frame = np.eye(4)
    frame[:3, :3] = (u @ flip @ v).T
    frame[:3, 3] = other - frame[:3, :3] @ middle
    return frame


def held_out(model: Model, samples: Samples, length: float, found: Fit) -> list[tuple[Model, Samples, Array]]:
    """Returns models fitted without some samples, each with those, and the parameters' changes."""
    fold = np.arange(len(samples.tips)) % FOLDS
    result = []
    for k in range(FOLDS):
        if (unseen := found.kept & (fold == k)).any():
            steps = fit(model, samples.only(fold != k), length, found.steps).steps
            result.append((model, samples.only(unseen), steps))
    return result


def misfit(compared: list[tuple[Model, Samples, Array]]) -> Misfit:
    """Returns the residuals of models with changes over samples, all together."""
    position = np.concatenate([distances(*each) for each in compared])
    if not compared[0][1].oriented:
        return Misfit(summed_up(position), None)
    return Misfit(summed_up(position), summed_up(np.concatenate([angles(*each) for each in compared])))


def summed_up(values: Array) -> Residuals:
    """Returns what is told of distances or angles (n,)."""
    return Residuals(float(np.sqrt((values**2).mean())), float(np.percentile(values, 95)), float(values.max()))


def rounded(value: Any) -> Any:
    """Returns a value with its numbers cut to DIGITS digits."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    if isinstance(value, list):
        return [rounded(part) for part in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value

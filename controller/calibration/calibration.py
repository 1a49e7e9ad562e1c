"""Calibration of an arm: the base by Kabsch's algorithm, then all numbers by least squares with cross-validation.

Cross-validation fits the arm without each fold, starting from the file's numbers, and evaluates the fit on the fold.
Samples of one configuration are in one fold, because a repeated measurement is no independent test. The result is
compared with a fit of the base alone. A tracker in another frame changes only the base. So the modules' new numbers are
better only if they predict the folds better than that fit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.arm.saving import frame_fields
from hyperbit.controller.calibration.enough import FEWEST, check_enough
from hyperbit.controller.calibration.fit import CannotFit, Fit, angles, distances, fit, plausible
from hyperbit.controller.calibration.model import Array, Model
from hyperbit.controller.calibration.parameters import (
    Description,
    Parameter,
    chosen_parameters,
    described,
    frame_of,
    parameters,
    value_at,
)
from hyperbit.controller.calibration.samples import Samples
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.studies.shares import Run, Spread, alone

FOLDS = 5
MOST_PARAMETERS = 1000
DIGITS = 10  # digits of numbers in the new file


@dataclass(frozen=True)
class Residuals:
    """Distances, or angles [rad], between computed and measured tips: root mean square, 95th percentile, maximum."""

    rms: float
    most: float
    worst: float


@dataclass(frozen=True)
class PoseResiduals:
    """Residuals of positions and, if measured, of orientations."""

    position: Residuals
    orientation: Residuals | None


@dataclass(frozen=True, eq=False)
class ParameterChange:
    parameter: Parameter
    before: Any  # value, or quaternion, in the file
    after: Any  # new value or quaternion
    deviation: float  # standard deviation of the new value
    determined: bool  # whether the samples contribute more information than the file


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration. Residuals are over the samples that are no outliers."""

    samples: int
    outliers: tuple[int, ...]  # lines of the outliers
    before: PoseResiduals  # residuals of the arm in the file
    base_only: PoseResiduals  # residuals of the arm with only the base fitted
    after: PoseResiduals  # residuals of the calibrated arm
    held_out: PoseResiduals  # cross-validated residuals: arms fitted to four folds, evaluated on the fifth
    held_out_base_only: PoseResiduals  # cross-validated residuals with only the base fitted
    # whether `held_out` beats `held_out_base_only`, or the file if only the base is fitted: in mean square, by more
    # than two standard errors
    better: bool
    noise: Array  # standard deviation of a coordinate, and of an angle [rad] if orientations were measured
    undetermined: int  # number of directions in parameter space that the file determines, not the samples
    changes: tuple[ParameterChange, ...]
    description: Description  # `base` and `modules` of the new file


class FitPair(NamedTuple):
    every: Fit
    base: Fit


class FitJob(NamedTuple):
    """The fits of a calibration: to all samples, and without each fold. A share is the mask (n,) of the samples to fit.

    BLAS runs in one thread: with more, its sums are in another order, and a fit takes longer.
    """

    arm: Arm
    samples: Samples
    in_file: Description
    chosen: Sequence[Parameter]

    def prepare(self) -> Run:
        """Returns a function that fits the arm to the samples of a mask."""
        return self._run

    def _run(self, mask: NDArray[np.bool_]) -> Iterator[FitPair]:
        import scipy.linalg  # noqa: F401 - loads scipy's own BLAS before it is limited

        seen, length = self.samples.only(mask), self.arm.manipulator.length
        model, base_model = models(self.arm, seen, self.in_file, self.chosen)
        with threadpool_limits(1, "blas"):
            yield FitPair(fit(model, seen, length), fit(base_model, seen, length))


def calibrated(
    arm: Arm, samples: Samples, *, each: bool, parts: Sequence[str] | None = None, spread: Spread = alone
) -> Calibration:
    """Returns the calibration of an arm, with fits computed by `spread`.

    If `each`, each module of each repetition, and each leg of a truss, has its own parameters. Beside the base only
    `parts` are fitted, see chosen_parameters; None: all.

    Raises:
        CannotFit: there are too few samples or too many parameters, or most samples are far from the arm.
    """
    if len(samples.tips) < FEWEST:
        raise CannotFit(f"{len(samples.tips)} samples, at least {FEWEST} are needed")
    length = arm.manipulator.length
    in_file = described(arm, each=each)
    try:
        chosen = chosen_parameters(parameters(in_file, length, len(arm.manipulator.modules)), parts)
    except ValueError as error:
        raise CannotFit(str(error)) from None
    if len(chosen) > MOST_PARAMETERS:
        raise CannotFit(f"{len(chosen)} numbers would be fitted, at most {MOST_PARAMETERS} can be")
    fold = folds(samples.configurations)
    model, base_model = models(arm, samples, in_file, chosen)
    check_enough(model, samples, fold, arm.manipulator)
    masks = [np.ones(len(fold), dtype=bool), *(fold != k for k in range(FOLDS))]
    (found, base_found), *by_fold = spread(FitJob(arm, samples, in_file, chosen), masks)
    new = rounded(model.changed(found.steps))
    original = Model(in_file, chosen)
    kept, still = samples.only(found.kept), np.zeros(len(chosen))
    unseen, unseen_base = held_out(arm, samples, in_file, chosen, fold, by_fold)
    rival = unseen_base
    if all(it.part == ("base",) for it in chosen):
        rival = [(original, seen, still) for _, seen, _ in unseen]
    return Calibration(
        samples=len(samples.tips),
        outliers=tuple(samples.lines[~found.kept].tolist()),
        before=pose_residuals([(original, kept, still)]),
        base_only=pose_residuals([(base_model, kept, base_found.steps)]),
        after=pose_residuals([(Model(new, chosen), kept, still)]),
        held_out=pose_residuals(unseen),
        held_out_base_only=pose_residuals(unseen_base),
        better=better(unseen, rival),
        noise=found.noise,
        undetermined=found.undetermined,
        changes=tuple(
            ParameterChange(
                p, value_at(in_file, p.where), value_at(new, p.where), float(deviation), bool(determined > 0.5)
            )
            for p, deviation, determined in zip(chosen, found.deviations, found.determined, strict=True)
        ),
        description=new,
    )


def base_under(arm: Arm, samples: Samples) -> Description:
    """Returns the base that brings computed and measured tips nearest, or the file's base if it is nearer.

    The tracker's frame is arbitrary, and least squares need a near start. Kabsch's algorithm runs twice, the second
    time on the nearer half of the samples, because of outliers.
    """
    manipulator, measured = arm.manipulator, samples.tips[:, :3, 3]
    tips = manipulator.tips(samples.configurations)[:, :3, 3]
    best, chosen = np.eye(4), np.ones(len(tips), dtype=bool)
    nearest = np.median(np.linalg.norm(tips - measured, axis=1))
    for _ in range(2):
        moved = frame_of(frame_fields(onto(tips[chosen], measured[chosen]), planar=manipulator.planar))
        away = np.linalg.norm(tips @ moved[:3, :3].T + moved[:3, 3] - measured, axis=1)
        chosen = away <= np.median(away)
        if np.median(away) < nearest:
            best, nearest = moved, np.median(away)
    return frame_fields(best @ manipulator.base, planar=manipulator.planar)


def onto(points: Array, others: Array) -> Frame:
    """Returns the frame (4, 4) that moves points (n, 3) onto others (n, 3) by least squares (Kabsch 1976)."""
    middle, other = points.mean(axis=0), others.mean(axis=0)
    u, _, v = np.linalg.svd((points - middle).T @ (others - other))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    frame = np.eye(4)
    frame[:3, :3] = (u @ flip @ v).T
    frame[:3, 3] = other - frame[:3, :3] @ middle
    return frame


def models(arm: Arm, samples: Samples, in_file: Description, chosen: Sequence[Parameter]) -> tuple[Model, Model]:
    """Returns two models to fit: one with all parameters, one with those of the base only."""
    description = {**in_file, "base": base_under(arm, samples)}
    return Model(description, chosen), Model(
        description, [parameter for parameter in chosen if parameter.part == ("base",)]
    )


def folds(configurations: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the fold of each sample (n,), the same for equal configurations (B,). Raises CannotFit if too few."""
    _, group, sizes = np.unique(configurations, axis=0, return_inverse=True, return_counts=True)
    if len(sizes) < FOLDS:
        raise CannotFit(f"{len(sizes)} different configurations, at least {FOLDS} are needed")
    drawn = np.random.default_rng(0).permutation(len(sizes))
    fold, filled = np.empty(len(sizes), dtype=np.int64), np.zeros(FOLDS, dtype=np.int64)
    for k in drawn[np.argsort(-sizes[drawn], kind="stable")]:  # the largest first, each to the emptiest fold
        fold[k] = filled.argmin()
        filled[fold[k]] += sizes[k]
    return fold[group.ravel()]


Compared = list[tuple[Model, Samples, Array]]


def held_out(
    arm: Arm,
    samples: Samples,
    in_file: Description,
    chosen: Sequence[Parameter],
    fold: NDArray[np.int64],
    fits: Sequence[FitPair],
) -> tuple[Compared, Compared]:
    """Returns the models fitted without each fold, with fold and changes; for all parameters and for the base only.

    A sample of the fold is an outlier for both models only if both fits find it to be one.
    """
    length, every, base_only = arm.manipulator.length, Compared(), Compared()
    for k, (found, base_found) in enumerate(fits):
        seen, unseen = samples.only(fold != k), samples.only(fold == k)
        model, base_model = models(arm, seen, in_file, chosen)
        near = plausible(model, unseen, length, found) | plausible(base_model, unseen, length, base_found)
        if near.any():
            every.append((model, unseen.only(near), found.steps))
            base_only.append((base_model, unseen.only(near), base_found.steps))
    if not every:
        raise CannotFit("no fit predicts the samples of the other folds; check configurations and units of the samples")
    return every, base_only


def better(compared: Compared, others: Compared) -> bool:
    """Returns whether models have a smaller mean squared distance than others, by more than two standard errors."""
    first, second = (np.concatenate([distances(*each) for each in part]) ** 2 for part in (compared, others))
    gain = second - first
    return bool(gain.mean() > 2 * gain.std() / np.sqrt(len(gain)))


def pose_residuals(compared: Compared) -> PoseResiduals:
    """Returns the residuals of models with changes over their samples, all together."""
    position = np.concatenate([distances(*each) for each in compared])
    if not compared[0][1].oriented:
        return PoseResiduals(summed_up(position), None)
    return PoseResiduals(summed_up(position), summed_up(np.concatenate([angles(*each) for each in compared])))


def summed_up(values: Array) -> Residuals:
    return Residuals(float(np.sqrt((values**2).mean())), float(np.percentile(values, 95)), float(values.max()))


def rounded(value: Any) -> Any:
    """Returns a value with its numbers rounded to DIGITS digits."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    if isinstance(value, list):
        return [rounded(part) for part in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value

"""Least squares over the numbers of an arm's file, with samples that are far off set aside.

Each residual counts in standard deviations of its noise, which is estimated from the residuals themselves, and each
parameter's change in those of what the file says of it. So what the samples do not determine, as where a joint may turn
one way and the link behind it the other, stays near the file's value.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import gammaincinv

from controller.calibration.model import Array, Model
from controller.calibration.samples import Samples
from controller.manipulator import frames

GATE = 1 - 1e-6  # of samples that are only noisy, so many are kept
ROUNDS = 8  # most, in which noise and samples set aside are found
STEPS = 100  # most, of one least squares
FINEST = 1e-6  # least noise, against the arm's length, and as an angle [rad]: no tracker is better
SPREAD = 1.4826  # standard deviation of normal noise, against the median of its absolute value


class CannotFit(ValueError):
    """The samples do not suffice, or the arm cannot be as they say."""


@dataclass(frozen=True, eq=False)
class Fit:
    """What was found.

    Attributes:
        steps: changes of the parameters, shape (P,).
        deviations: standard deviations of the parameters now, shape (P,).
        told: share of what is known of each parameter that the samples told, 0 to 1, shape (P,).
        loose: directions in the space of parameters of which the samples tell less than the file does.
        kept: samples that are not set aside, shape (n,).
        noise: standard deviation of a coordinate, and of a turn [rad], of which there is none for positions only.
    """

    steps: Array
    deviations: Array
    told: Array
    loose: int
    kept: NDArray[np.bool_]
    noise: Array


class Problem:
    """The least squares over one set of samples; parameters in standard deviations of what the file says of them."""

    def __init__(self, model: Model, samples: Samples, length: float) -> None:
        self.model, self.samples = model, samples
        self.priors = np.array([parameter.prior for parameter in model.parameters])
        dimension = 3 if isinstance(model.description["base"]["orientation"], list) else 2
        columns = model.residuals(samples, np.zeros(len(self.priors))).shape[1]
        self.kinds = (np.arange(columns) >= dimension).astype(int)  # 0 coordinates, 1 turns
        self._finest = np.array([FINEST * length, FINEST])[: self.kinds[-1] + 1]

    def residuals(self, x: Array) -> Array:
        """Returns computed minus measured (n, C)."""
        return self.model.residuals(self.samples, np.asarray(x * self.priors))

    def jacobian(self, x: Array) -> Array:
        """Returns their derivatives (n, C, P)."""
        return np.asarray(self.model.jacobian(self.samples, x * self.priors) * self.priors)

    def scales(self, residuals: Array, *, robust: bool, told: float) -> Array:
        """Returns the noise of coordinates and turns, of residuals (n, C) of which so many values fit by themselves."""
        share = max(1 - told / residuals.size, 0.1)
        found = []
        for kind in range(len(self._finest)):
            own = residuals[:, self.kinds == kind]
            found.append(SPREAD * np.median(np.abs(own)) if robust else np.sqrt((own**2).mean()))
        return np.asarray(np.maximum(np.array(found) / np.sqrt(share), self._finest))

    def solve(self, x: Array, noise: Array, kept: NDArray[np.bool_], *, robust: bool) -> Array:
        """Returns the parameters (P,) that fit best the samples kept.

        Raises:
            CannotFit: it comes to no end.
        """
        weights = 1 / noise[self.kinds]

        def missed(x: Array) -> Array:
            try:
                weighted = self.residuals(x)[kept] * weights
            except ValueError:  # no such arm: a shorter step is tried
                weighted = np.full((int(kept.sum()), len(weights)), np.inf)
            return np.concatenate([weighted.ravel(), x])

        def changes(x: Array) -> Array:
            weighted = self.jacobian(x)[kept] * weights[:, None]
            return np.vstack([weighted.reshape(-1, len(x)), np.eye(len(x))])

        loss, enough = ("soft_l1", 1e-3) if robust else ("linear", 1e-8)  # robustly, it is only to begin well
        try:
            found = least_squares(missed, x, changes, loss=loss, max_nfev=STEPS, xtol=1e-8, ftol=enough)
        except (ValueError, np.linalg.LinAlgError) as error:
            raise CannotFit(f"the least squares failed: {error}") from None
        return np.asarray(found.x)

    def information(self, x: Array, noise: Array, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Returns what the samples kept tell of P directions (P,), the file telling 1 of each, and these (P, P)."""
        weighted = (self.jacobian(x)[kept] / noise[self.kinds][:, None]).reshape(-1, len(x))
        values, directions = np.linalg.eigh(weighted.T @ weighted)
        return np.maximum(values, 0.0), directions

    def within(self, x: Array, noise: Array) -> NDArray[np.bool_]:
        """Returns which samples (n,) are not too far off to be noise."""
        residuals = self.residuals(x)
        square = ((residuals / noise[self.kinds]) ** 2).sum(axis=1)
        turned = angles(self.model, self.samples, x * self.priors) > np.pi / 2  # there the sine falls again
        return np.asarray((square <= 2 * gammaincinv(residuals.shape[1] / 2, GATE)) & ~turned)


def fit(model: Model, samples: Samples, length: float) -> Fit:
    """Returns the changes of the parameters that suit the samples best.

    Args:
        model: of the arm.
        samples: what was measured.
        length: of the arm.

    Raises:
        CannotFit: there are too few samples, or the least squares fail.
    """
    problem = Problem(model, samples, length)
    x = np.zeros(len(model.parameters))
    check_enough(problem, x)
    every = np.ones(len(samples.tips), dtype=bool)
    noise, told = problem.scales(problem.residuals(x), robust=True, told=0.0), 0.0
    for _ in range(ROUNDS):  # the noise is first taken far too great, as the file's errors are in it
        x = problem.solve(x, noise, every, robust=True)
        information, _ = problem.information(x, noise, every)
        told = float((information / (information + 1)).sum())
        before, noise = noise, problem.scales(problem.residuals(x), robust=True, told=told)
        if (noise > 0.95 * before).all():
            break
    kept = problem.within(x, noise)
    for _ in range(ROUNDS):
        if 2 * kept.sum() <= len(kept):
            raise CannotFit(f"{(~kept).sum()} of {len(kept)} samples are far off: no arm like the file's suits them")
        x = problem.solve(x, noise, kept, robust=False)
        noise = problem.scales(problem.residuals(x)[kept], robust=False, told=told)
        last, kept = kept, problem.within(x, noise)
        if (kept == last).all():
            break
    information, directions = problem.information(x, noise, last)
    variances = (directions**2 / (information + 1)).sum(axis=1)
    return Fit(
        steps=x * problem.priors,
        deviations=np.sqrt(variances) * problem.priors,
        told=1 - variances,
        loose=int((information < 1).sum()),
        kept=last,
        noise=noise,
    )


def plausible(model: Model, samples: Samples, length: float, found: Fit) -> NDArray[np.bool_]:
    """Returns which samples (n,) a fit to others meets as nearly as its noise allows."""
    problem = Problem(model, samples, length)
    return problem.within(found.steps / problem.priors, found.noise)


def check_enough(problem: Problem, x: Array) -> None:
    """Checks that there are two values measured for each parameter that they tell of.

    Raises:
        CannotFit: there are fewer.
    """
    jacobian = problem.jacobian(x)
    told = int((np.abs(jacobian) > 1e-9 * np.abs(jacobian).max()).any(axis=(0, 1)).sum())
    samples, columns = jacobian.shape[:2]
    if samples * columns < 2 * told:
        raise CannotFit(
            f"{samples} samples of {columns} values each are too few for the {told} numbers that they depend on;"
            f" at least {-(-2 * told // columns)} are needed"
        )


def distances(model: Model, samples: Samples, steps: Array) -> Array:
    """Returns how far computed tips are from measured ones (n,)."""
    tips = model.tips(samples, steps)
    size = 3 if isinstance(model.description["base"]["orientation"], list) else 2
    return np.asarray(np.linalg.norm((tips - samples.tips)[:, :size, 3], axis=1))


def angles(model: Model, samples: Samples, steps: Array) -> Array:
    """Returns the angles (n,) [rad] between computed and measured tips; 0 where only positions were measured."""
    if not samples.oriented:
        return np.zeros(len(samples.tips))
    tips = frames.inverse(samples.tips) @ model.tips(samples, steps)
    skew = tips - np.swapaxes(tips, 1, 2)
    sine = np.sqrt(skew[:, 2, 1] ** 2 + skew[:, 0, 2] ** 2 + skew[:, 1, 0] ** 2)
    return np.asarray(np.arctan2(sine, np.trace(tips[:, :3, :3], axis1=1, axis2=2) - 1))

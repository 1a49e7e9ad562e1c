"""Least squares over the numbers of an arm's file, without outliers.

Each residual is divided by the standard deviation of its noise, which is estimated from the residuals. Each change of a
parameter is divided by its prior standard deviation. The samples leave some parameters open, such as opposite rotations
of a joint and its link. These stay near the file's values.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from hyperbit.controller.calibration.model import Array, Model
from hyperbit.controller.calibration.samples import Samples
from hyperbit.controller.manipulator import frames

GATE = 1 - 1e-6  # share of the samples with normal noise that pass the outlier test
ROUNDS = 8  # most rounds of estimating noise and outliers
STEPS = 100  # most steps of one least-squares fit
FINEST = 1e-6  # least noise relative to the arm's length, and as an angle [rad]: no tracker is better
MAD_SCALE = 1.4826  # standard deviation of normal noise over the median of its absolute value


class CannotFit(ValueError):
    """The samples are too few, or no arm similar to the file's fits them."""


@dataclass(frozen=True, eq=False)
class Fit:
    steps: Array  # changes of the parameters, shape (P,)
    deviations: Array  # standard deviations of the fitted parameters, shape (P,)
    determined: Array  # share of the information on each parameter that is from the samples, 0 to 1, shape (P,)
    # number of directions in parameter space with less information from the samples than from the file
    undetermined: int
    kept: NDArray[np.bool_]  # mask of the samples that are no outliers, shape (n,)
    noise: Array  # standard deviation of a coordinate, and of an angle [rad] if orientations were measured


class LeastSquares:
    """The least squares over one set of samples. Parameters are in units of their prior standard deviations."""

    def __init__(self, model: Model, samples: Samples, length: float) -> None:
        self.model, self.samples = model, samples
        self.priors = np.array([parameter.prior for parameter in model.parameters])
        dimension = 3 if isinstance(model.description["base"]["orientation"], list) else 2
        columns = model.residuals(samples, np.zeros(len(self.priors))).shape[1]
        self.kinds = (np.arange(columns) >= dimension).astype(int)  # 0 coordinates, 1 turns
        self._finest = np.array([FINEST * length, FINEST])[: self.kinds[-1] + 1]

    def residuals(self, x: Array) -> Array:
        """Returns the residuals (n, C), computed minus measured."""
        return self.model.residuals(self.samples, np.asarray(x * self.priors))

    def jacobian(self, x: Array) -> Array:
        """Returns the derivatives (n, C, P) of the residuals."""
        return np.asarray(self.model.jacobian(self.samples, x * self.priors) * self.priors)

    def scales(self, residuals: Array, *, robust: bool, determined: float) -> Array:
        """Returns the noise of coordinates and angles from residuals (n, C), corrected for `determined` parameters."""
        share = max(1 - determined / residuals.size, 0.1)
        found = []
        for kind in range(len(self._finest)):
            own = residuals[:, self.kinds == kind]
            found.append(MAD_SCALE * np.median(np.abs(own)) if robust else np.sqrt((own**2).mean()))
        return np.asarray(np.maximum(np.array(found) / np.sqrt(share), self._finest))

    def solve(self, x: Array, noise: Array, kept: NDArray[np.bool_], *, robust: bool) -> Array:
        """Returns the parameters (P,) that best fit the samples of a mask (n,). Raises CannotFit if this fails."""
        from scipy.optimize import least_squares  # takes half a second to import

        weights = 1 / noise[self.kinds]

        def missed(x: Array) -> Array:
            try:
                weighted = self.residuals(x)[kept] * weights
            except ValueError:  # there is no such arm: try a shorter step
                weighted = np.full((int(kept.sum()), len(weights)), np.inf)
            return np.concatenate([weighted.ravel(), x])

        def changes(x: Array) -> Array:
            weighted = self.jacobian(x)[kept] * weights[:, None]
            return np.vstack([weighted.reshape(-1, len(x)), np.eye(len(x))])

        loss, enough = ("soft_l1", 1e-3) if robust else ("linear", 1e-8)  # the robust fit is only a start
        try:
            found = least_squares(missed, x, changes, loss=loss, max_nfev=STEPS, xtol=1e-8, ftol=enough)
        except (ValueError, np.linalg.LinAlgError) as error:
            raise CannotFit(f"the least squares failed: {error}") from None
        return np.asarray(found.x)

    def information(self, x: Array, noise: Array, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Returns the samples' information (P,) along directions (P, P), where the file has 1; and the directions."""
        weighted = (self.jacobian(x)[kept] / noise[self.kinds][:, None]).reshape(-1, len(x))
        values, directions = np.linalg.eigh(weighted.T @ weighted)
        return np.maximum(values, 0.0), directions

    def within(self, x: Array, noise: Array) -> NDArray[np.bool_]:
        """Returns a mask (n,) of the samples whose residuals may be noise."""
        residuals = self.residuals(x)
        square = ((residuals / noise[self.kinds]) ** 2).sum(axis=1)
        # The residual of a rotation is a sine, and falls beyond a right angle.
        turned = angles(self.model, self.samples, x * self.priors) > np.pi / 2
        return np.asarray((square <= 2 * gammaincinv(residuals.shape[1] / 2, GATE)) & ~turned)


def fit(model: Model, samples: Samples, length: float) -> Fit:
    """Returns the parameters that best fit the samples of an arm of some length, without outliers. Raises CannotFit."""
    problem = LeastSquares(model, samples, length)
    x = np.zeros(len(model.parameters))
    every = np.ones(len(samples.tips), dtype=bool)
    noise, determined = problem.scales(problem.residuals(x), robust=True, determined=0.0), 0.0
    for _ in range(ROUNDS):  # the first estimate is far too great: it contains the errors of the file
        x = problem.solve(x, noise, every, robust=True)
        information, _ = problem.information(x, noise, every)
        determined = float((information / (information + 1)).sum())
        before, noise = noise, problem.scales(problem.residuals(x), robust=True, determined=determined)
        if (noise > 0.95 * before).all():
            break
    kept = problem.within(x, noise)
    for _ in range(ROUNDS):
        if 2 * kept.sum() <= len(kept):
            raise CannotFit(f"{(~kept).sum()} of {len(kept)} samples are outliers: no arm like the file's fits them")
        x = problem.solve(x, noise, kept, robust=False)
        noise = problem.scales(problem.residuals(x)[kept], robust=False, determined=determined)
        last, kept = kept, problem.within(x, noise)
        if (kept == last).all():
            break
    information, directions = problem.information(x, noise, last)
    variances = (directions**2 / (information + 1)).sum(axis=1)
    return Fit(
        steps=x * problem.priors,
        deviations=np.sqrt(variances) * problem.priors,
        determined=1 - variances,
        undetermined=int((information < 1).sum()),
        kept=last,
        noise=noise,
    )


def plausible(model: Model, samples: Samples, length: float, found: Fit) -> NDArray[np.bool_]:
    """Returns a mask (n,) of the samples that a fit to other samples predicts within its noise."""
    problem = LeastSquares(model, samples, length)
    return problem.within(found.steps / problem.priors, found.noise)


def distances(model: Model, samples: Samples, steps: Array) -> Array:
    """Returns the distances (n,) of computed and measured tips."""
    tips = model.tips(samples, steps)
    size = 3 if isinstance(model.description["base"]["orientation"], list) else 2
    return np.asarray(np.linalg.norm((tips - samples.tips)[:, :size, 3], axis=1))


def angles(model: Model, samples: Samples, steps: Array) -> Array:
    """Returns the angles (n,) [rad] between computed and measured tips; 0 if only positions were measured."""
    if not samples.oriented:
        return np.zeros(len(samples.tips))
    tips = frames.inverse(samples.tips) @ model.tips(samples, steps)
    skew = tips - np.swapaxes(tips, 1, 2)
    sine = np.sqrt(skew[:, 2, 1] ** 2 + skew[:, 0, 2] ** 2 + skew[:, 1, 0] ** 2)
    return np.asarray(np.arctan2(sine, np.trace(tips[:, :3, :3], axis1=1, axis2=2) - 1))

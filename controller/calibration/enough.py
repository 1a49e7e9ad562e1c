"""How many samples a calibration needs: two measured values for each number, in each fit of the cross-validation."""

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.calibration.fit import CannotFit
from hyperbit.controller.calibration.model import Model
from hyperbit.controller.calibration.samples import Samples
from hyperbit.controller.manipulator.manipulator import Manipulator

FEWEST = 10  # fewest samples
TRIED = 64  # random configurations that tell on which numbers tips depend


def check_enough(model: Model, samples: Samples, fold: NDArray[np.int64], manipulator: Manipulator) -> None:
    """Checks the number of samples; `fold` (n,) is the fold of each, from 0.

    Raises:
        CannotFit: a fit would have too few. The message names a number of samples that suffices.
    """
    numbers, columns = depending(model, samples)
    fitted = len(fold) - int(np.bincount(fold).max())
    if fitted * columns >= 2 * numbers:
        return
    asked = enough(model, manipulator, int(fold.max()) + 1, oriented=samples.oriented)
    raise CannotFit(
        f"{len(fold)} samples of {columns} values each are too few for the {numbers} numbers that they depend on: each"
        f" fit leaves out a fold, and needs two values for each number; at least {asked} samples of different"
        " configurations are needed"
    )


def enough(model: Model, manipulator: Manipulator, folds: int, *, oriented: bool) -> int:
    """Returns a number of samples of different configurations that suffices, whatever the configurations are."""
    random, states = np.random.default_rng(0), manipulator.states
    each = [np.minimum(k, states - 1) for k in range(int(states.max()))]
    drawn = np.column_stack([random.integers(0, count, TRIED) for count in states])
    numbers, columns = depending(model, model.computed(np.vstack([each, drawn]), oriented=oriented))
    needed = -(-2 * numbers // columns)
    count = max(needed, FEWEST)
    while count - -(-count // folds) < needed:
        count += 1
    return count


def depending(model: Model, samples: Samples) -> tuple[int, int]:
    """Returns the number of numbers on which samples depend, and the number of values of a sample."""
    slopes = np.abs(model.jacobian(samples, np.zeros(len(model.parameters))))
    slopes *= [parameter.prior for parameter in model.parameters]
    return int((slopes > 1e-9 * slopes.max()).any(axis=(0, 1)).sum()), slopes.shape[1]

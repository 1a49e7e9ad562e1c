"""What a switch of each actuator costs: its weight, its place along the arm, and its wear."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hyperbit.controller.arm.arm import Arm


def weights_of(arm: Arm, switches: Mapping[str, int] | None = None) -> NDArray[np.float64]:
    """Returns the cost of a switch of each actuator, shape (A,).

    `switches` is the number of switches of each actuator so far, by label; 0 if absent.
    """
    labels, settings = arm.manipulator.actuators, arm.settings.weights
    place = np.array([int(label.split(".")[0]) - 1 for label in labels])
    along = np.linspace(settings.base, 1.0, len(arm.manipulator.modules))[place]
    own = along * ([entry.weight for entry in arm.wiring] or 1.0)
    worn = np.array([(switches or {}).get(label, 0) for label in labels], dtype=float)
    return np.asarray(own * (1.0 + settings.wear * worn / max(worn.max(), 1.0)))

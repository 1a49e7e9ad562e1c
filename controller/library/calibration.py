"""Calibration: fits an arm's geometry to measured tips."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs

from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.calibration.calibration import Calibration, calibrated
from hyperbit.controller.calibration.fit import CannotFit
from hyperbit.controller.calibration.samples import Samples
from hyperbit.controller.library.arguments import Configurations, Numbers, typed
from hyperbit.controller.library.arm import Arm
from hyperbit.controller.library.errors import CalibrationError
from hyperbit.controller.library.modules import build, checked


class Fitted(NamedTuple):
    """A calibrated arm.

    Attributes:
        arm: the arm with the fitted geometry; obstacles, tolerances and locked actuators are unchanged.
        report: residuals before and after and on held-out samples, and each changed number.
    """

    arm: Arm
    report: Calibration


@typed(CalibrationError)
def calibrate(
    arm: Arm, configurations: Configurations, tips: Numbers, *, each: bool = False, fit: Sequence[str] | None = None
) -> Fitted:
    """Fits modules and base of an arm to measured tips.

    Args:
        arm: the arm before calibration.
        configurations: configurations of the measurements, shape (n, B).
        tips: measured tips in the world: positions, shape (n, dimension), or frames, shape (n, 4, 4).
        each: fit each module, also each repetition of a group, and each leg of a truss, separately.
        fit: parts to fit beside the base, such as "tip", "modules[2]" or "modules[1].link", counted from 1; none: the
            base only; None: all.

    Raises:
        CalibrationError: there are too few samples, the shapes do not match, or no arm of this kind fits the samples.
        ConfigurationError: the arm has no such configuration.
    """
    rows = np.atleast_2d(arm._rows(configurations))
    measured = np.asarray(tips, dtype=float)
    frames = np.tile(np.eye(4), (len(rows), 1, 1))
    oriented = measured.shape == (len(rows), 4, 4)
    if oriented:
        frames = measured.copy()
    elif measured.shape == (len(rows), arm.dimension):
        frames[:, : arm.dimension, 3] = measured
    else:
        raise CalibrationError(
            f"tips of shape ({len(rows)}, {arm.dimension}) or ({len(rows)}, 4, 4) are needed, got {measured.shape}"
        )
    if not np.isfinite(frames).all():
        raise CalibrationError("tips: finite numbers are needed")
    try:
        report = calibrated(arm._arm, Samples(rows, frames, oriented, np.arange(len(rows))), each=each, parts=fit)
    except CannotFit as error:
        raise CalibrationError(str(error)) from None
    fields: dict[str, Any] = {"name": arm.name, "tolerance": {"position": arm.tolerance}, **report.description}
    found = checked(ArmSettings, fields, arm.name)
    settings = structs.replace(arm._arm.settings, base=found.base, modules=found.modules, tip=found.tip)
    return Fitted(Arm._of(build(settings, Path(arm.name)), arm._locked_states), report)

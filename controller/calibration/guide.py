"""A calibration that says what to measure next, and when enough is measured."""

from collections.abc import Sequence

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.calibration.calibration import FOLDS, Calibration, calibrated
from hyperbit.controller.calibration.enough import enough
from hyperbit.controller.calibration.fit import CannotFit
from hyperbit.controller.calibration.model import Model
from hyperbit.controller.calibration.parameters import chosen_parameters, described, parameters
from hyperbit.controller.calibration.proposals import Configurations, Design
from hyperbit.controller.calibration.samples import Samples
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.manipulator import Configuration
from hyperbit.controller.studies.shares import Spread, alone

EVERY = 5  # samples between two fits
FALL = 0.95  # the held-out error falls as long as one of PATIENCE fits is below this share of the best before
PATIENCE = 3


class Guide:
    """Collects samples of an arm, proposes the next one, and fits the arm after every few.

    Attributes:
        enough: number of samples that suffices for the first fit.
        held_out: held-out error of each fit so far, root mean square.
        found: the latest calibration; None before the first.
        design: what the samples tell.

    Args:
        arm: the arm of the file.
        samples: those that were measured before; None: none.
        oriented: whether orientations are measured.
        each, parts: see `calibrated`.
        spread: computes the fits.

    Raises:
        CannotFit: a part has no numbers, or each configuration that was drawn collides.
    """

    def __init__(
        self,
        arm: Arm,
        samples: Samples | None,
        *,
        oriented: bool,
        each: bool,
        parts: Sequence[str] | None = None,
        spread: Spread = alone,
    ) -> None:
        self._arm, self._each, self._parts, self._oriented, self._spread = arm, each, parts, oriented, spread
        in_file = described(arm, each=each)
        every = parameters(in_file, arm.manipulator.length, len(arm.manipulator.modules))
        try:
            model = Model(in_file, chosen_parameters(every, parts))
            self.design = Design(arm, model, oriented=oriented)
        except ValueError as error:
            raise CannotFit(str(error)) from None
        self.enough = enough(model, arm.manipulator, FOLDS, oriented=oriented)
        self._configurations, self._tips = list[Configuration](), list[Frame]()
        self.held_out, self.found = list[float](), None
        if samples is not None:
            self._configurations, self._tips = list(samples.configurations), list(samples.tips)
            self.design.add(samples.configurations)
            self._fit()

    found: Calibration | None

    def __len__(self) -> int:
        return len(self._tips)

    @property
    def done(self) -> bool:
        """Whether the held-out error no longer falls."""
        best, last = self.held_out[:-PATIENCE], self.held_out[-PATIENCE:]
        return bool(best) and min(last) > FALL * min(best)

    def propose(self) -> Configuration | None:
        """Returns the configuration (B,) to measure next; None if there is no other."""
        return self.design.propose()

    def leave_out(self, configurations: Configurations) -> None:
        """Proposes configurations (n, B) no more: the arm cannot go there, or the tip was not seen."""
        self.design.leave_out(configurations)

    def add(self, configuration: Configuration, tip: Frame) -> bool:
        """Adds a sample: a configuration (B,) and the measured tip (4, 4). Returns whether the arm was fitted again."""
        self._configurations.append(configuration)
        self._tips.append(tip)
        self.design.add(configuration[None])
        if len(self) < self.enough or (len(self) - self.enough) % EVERY:
            return False
        return self._fit()

    def _fit(self) -> bool:
        lines = np.arange(len(self)) + 2
        samples = Samples(np.array(self._configurations), np.array(self._tips), self._oriented, lines)
        try:
            self.found = calibrated(self._arm, samples, each=self._each, parts=self._parts, spread=self._spread)
        except CannotFit:  # more samples may do
            return False
        self.held_out.append(self.found.held_out.position.rms)
        return True


def frame_of_tip(position: Sequence[float], orientation: float | Sequence[float] | None) -> Frame:
    """Returns the frame (4, 4) of a measured position, with an angle or a quaternion if it was measured."""
    from hyperbit.controller.manipulator import frames

    x, y, *z = position
    if not z:
        return frames.planar(x, y, orientation if isinstance(orientation, float) else 0.0)
    return frames.spatial((x, y, z[0]), (0, 0, 0, 1) if orientation is None else orientation)

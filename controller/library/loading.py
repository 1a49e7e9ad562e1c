"""Arms from files."""

from __future__ import annotations

from pathlib import Path

from hyperbit.controller.arm import arm as config
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.library.arguments import typed
from hyperbit.controller.library.arm import Arm
from hyperbit.controller.library.errors import ArmError


@typed(ArmError)
def load(path: str | Path) -> Arm:
    """Loads the arm of a YAML file; actuators that the file declares stuck are locked.

    Raises:
        ArmError: the file is missing or wrong.
    """
    try:
        return Arm._of(config.load(Path(path)))
    except InputFaults as error:
        raise ArmError(error.faults, str(path), error.lines) from None
